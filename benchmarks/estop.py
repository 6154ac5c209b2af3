# SPDX-License-Identifier: Apache-2.0
"""Presses of the e-stop that were not received, of many, at either end of a loop.

    python benchmarks/estop.py                   1000 presses; five to ten minutes
    python benchmarks/estop.py --presses 100     fewer; --seed N: others
    python benchmarks/estop.py --lockstep        the same in lockstep
    python benchmarks/estop.py --flood           beside a process that publishes releases
    python benchmarks/estop.py --write           write the table into docs/safety.md as well

Plant, controller and trajectory are processes. Each press has a publisher of a random kind and a
random length, is followed by releases of its own and of other publishers, and happens while
nothing else does, while a process is stopped (SIGSTOP), or during a transition. It counts as
received at an end that publishes that it is in mode `estop`. Then both ends are reset; where an
earlier press comes after that, because it had been lost and was repeated, they are reset again
before the next one.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
import json
import os
from pathlib import Path
import statistics
import sys
import tempfile

from machine import describe

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / 'benchmarks'))

from fault_kit.loop import Loop  # noqa: E402
from fault_kit.presses import ENDS, FLOOD, Press, Presser  # noqa: E402

from dz_ros.files.configurations import load_configuration, write_parameters  # noqa: E402

SETTINGS = ['loop.duration=0', 'safety.fault_after=2000']
ONCE = 0.03
"""Share of the presses that are made by a process that ends at once."""
BEGIN, END = '<!-- e-stop table: benchmarks/estop.py writes it -->', '<!-- end of e-stop table -->'


def table(presses: list[Press]) -> str:
    """Return what came of the presses as a Markdown table."""
    lines = ['| presses | of them | missed by the plant | missed by the controller | delay, '
             'median [ms] | longest [ms] |', '|---|---|---|---|---|---|']

    def row(name: str, chosen: Iterable[Press]) -> None:
        found = list(chosen)
        if not found:
            return
        delays = [1e3 * delay for item in found for delay in item.delays.values()]
        missed = [sum(end not in item.delays for item in found) for end in ENDS]
        times = ' | '.join(f'{value:.1f}' for value in (statistics.median(delays), max(delays))
                           ) if delays else '- | -'
        lines.append(f'| {name} | {len(found)} | {missed[0]} | {missed[1]} | {times} |')

    row('all', presses)
    for attribute, words in (('publisher', 'publisher: '), ('after', 'then '),
                             ('beside', 'meanwhile ')):
        for value in dict.fromkeys(sorted(getattr(item, attribute) for item in presses)):
            row(words + value, (item for item in presses if getattr(item, attribute) == value))
    return '\n'.join(lines)


def write(text: str) -> None:
    """Put the table into the document."""
    path = ROOT / 'docs' / 'safety.md'
    head, _, rest = path.read_text(encoding='utf-8').partition(BEGIN)
    _, _, tail = rest.partition(END)
    path.write_text(f'{head}{BEGIN}\n{text}\n{END}{tail}', encoding='utf-8')


def main() -> int:
    """Press; return 1 where a press was missed or the loop did not start again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--presses', type=int, default=1000, metavar='N')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--lockstep', action='store_true')
    parser.add_argument('--flood', action='store_true')
    parser.add_argument('--write', action='store_true')
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    configuration = load_configuration(
        ROOT / 'config' / 'servo.yaml',
        [*SETTINGS, *(['loop.timing=lockstep'] if arguments.lockstep else [])])
    presses: list[Press] = []
    with tempfile.TemporaryDirectory(prefix='dz_ros-estop-') as folder:
        parameters = Path(folder) / 'parameters.yaml'
        write_parameters(configuration, parameters)
        with Loop(configuration, parameters) as loop:
            if not loop.until(loop.running):
                print('the loop never started')
                return 1
            if arguments.flood:
                loop.run_beside('flood', [sys.executable, '-c', FLOOD])
            presser = Presser(loop, arguments.seed)
            for number in range(arguments.presses):
                presses.append(presser.press(int((number + 1) * ONCE) > int(number * ONCE)))
                wrong = presses[-1]
                if wrong.error or len(wrong.delays) < len(ENDS):
                    print(json.dumps({'press': number, **vars(wrong),
                                      'modes': presser.history()}), flush=True)
                    if wrong.error:
                        break
    text = f'Measured on {describe("ros-rclpy")}.\n\n{table(presses)}'
    print(text)
    if arguments.write:
        write(text)
    if presser.late:
        print(f'{presser.late} times an earlier press came once more after the reset')
    good = sum(len(item.delays) == len(ENDS) and not item.error for item in presses)
    print(f'{good} of {arguments.presses} presses stopped both ends')
    return int(good < arguments.presses)


if __name__ == '__main__':
    sys.exit(main())
