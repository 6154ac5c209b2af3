# SPDX-License-Identifier: Apache-2.0
"""Faults injected into a real loop: what must happen, what did, how soon the actuator was safe.

    python benchmarks/faults.py                  all of them; about twelve minutes
    python benchmarks/faults.py --only kill      those whose name contains a word, or another
    python benchmarks/faults.py --write          write the table into docs/safety.md as well

Each fault has a loop of its own: plant, controller and trajectory as processes over DDS, the
servo of config/servo.yaml on a sinusoid. Before the fault max|x̃| is taken, then the fault, then
the reset services where something is latched, then max|x̃| again.

Over 300 lines: injection, timing and the table of docs/safety.md are one measurement.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
from contextlib import contextmanager
from dataclasses import dataclass
import json
import math
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from machine import describe

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / 'benchmarks'))

from fault_kit.cases import Case, CASES, LATCH, RELAY, RIDE, SkippedError  # noqa: E402
from fault_kit.drive import drive_for, DRIVE_SETTINGS  # noqa: E402
from fault_kit.loop import FAKETIME, Loop  # noqa: E402

from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.tracking import guaranteed_bounds  # noqa: E402
from dz_ros.files.configurations import load_configuration, write_parameters  # noqa: E402

SETTINGS = ['loop.duration=0', 'controller.law=robust', 'controller.k_star=1.45',
            'controller.rho_0=0.25', 'trajectory.kind=sinusoid', 'trajectory.amplitude=1.0',
            'trajectory.frequency=2.0', 'plant.x0=[0.0, 2.0]',
            'safety.command_limit=30', 'controller.v_max=30']
# The same motion; a reset may have to wait until the reference comes by (safety.error_limit).
JOINT = ['loop.duration=0', 'trajectory.kind=sinusoid', 'trajectory.amplitude=1.0',
         'trajectory.frequency=2.0', 'plant.x0=[0.0, 2.0]']
SETTLE = 3.0
BOUND = 5.0
"""A servo that stays within this is bounded [rad]; its reference has an amplitude of 1."""
SLACK, FLOOR, DEVICE_FLOOR = 1.1, 0.0001, 0.003
"""Tracking as before: within 10 %, or within what the jitter of a busy machine adds [rad]; more of
it where the actuator is a process of its own: a serial line, a CAN bus, a joint."""
STEADY, DEVICE_STEADY = 0.001, 0.006
"""The loop has settled when its error is below this [rad]."""
ATTEMPTS = 4
"""Windows in which the loop may come back to tracking as before."""
WINDOWS = 2
"""Windows before the fault of an emulated device, which comes by its own script: all are
measured, the largest error counts."""
LINE_HOLDS = {'safety.state_hold': 20, 'safety.command_hold': 10}
"""Holds that outlast the stalls of a busy machine, where a device has a process of its own."""
NICE = -15
NETWORK = 'dz_fault'
RULE = '|---|---|---|---|---|---|---|---|'
BEGIN, END = '<!-- fault table: benchmarks/faults.py writes it -->', '<!-- end of fault table -->'


@dataclass
class Outcome:
    """What a fault did, as cells of the table."""

    name: str
    must: str
    safe: str = ''
    modes: str = ''
    largest: str = ''
    error: str = ''
    load: str = ''
    verdict: str = ''


def run_case(case: Case, window: float) -> Outcome:
    """Inject one fault into a loop of its own."""
    outcome = Outcome(case.name, case.must)
    settings = {**case.settings, **({'loop.peers': []} if case.network else {})}
    with tempfile.TemporaryDirectory(prefix='dz_ros-fault-') as folder:
        parameters, port = Path(folder) / 'parameters.yaml', Path(folder) / 'port'
        if case.device or case.joint:
            settings = {**LINE_HOLDS, **settings}
        if case.device:
            settings |= {'driver.name': 'serial', 'driver.port': str(port)}
        file, given = (('cia402.yaml', DRIVE_SETTINGS) if case.drive else
                       ('joint.yaml', JOINT) if case.joint else ('servo.yaml', SETTINGS))
        configuration = load_configuration(
            ROOT / 'config' / file,
            [*given, *(f'{key}={json.dumps(value)}' for key, value in settings.items())])
        write_parameters(configuration, parameters)
        try:
            with (serial_device(case, window, Path(folder)), two_hosts(case) as prefix,
                  drive_for(case.drive) as drive,
                  Loop(configuration, parameters, prefix, RELAY if case.network else None,
                       case.clock, case.joint) as loop):
                loop.drive = drive
                if case.network:
                    loop.run_beside('relay', [sys.executable, str(
                        ROOT / 'benchmarks' / 'fault_kit' / 'relay.py'),
                        json.dumps(case.network)])
                observe(case, loop, window, outcome)
        except SkippedError as error:
            outcome.verdict = f'skipped: {error}'
    return outcome


def observe(case: Case, loop: Loop, window: float, outcome: Outcome) -> None:
    """Let the loop run, inject the fault, reset, and fill in the outcome."""
    if not loop.until(loop.running):
        outcome.verdict = 'FAILED: the loop never started'
        return
    floor, steady = ((DEVICE_FLOOR, DEVICE_STEADY) if case.drive or case.device or case.joint
                     else (FLOOR, STEADY))
    errors: list[float] = []
    while len(errors) < (WINDOWS if case.device else ATTEMPTS):
        loop.pass_time(SETTLE + window)
        errors.append(loop.error(window))
        if not loop.running() or errors[-1] >= steady:
            loop.reset()            # a busy machine may itself be a fault
        elif not case.device:
            break
    if not loop.until(loop.running, 10.0):
        outcome.verdict = f'FAILED: not running before the fault; {loop.why()}'
        return
    loop.noted = ''
    before = max(errors) if case.device else min(errors)
    states, truths, began = len(loop.heard['state']), len(loop.heard['truth']), time.monotonic()
    case.inject(loop)
    began = loop.began or began
    worst = loop.meanwhile(states)
    loop.until(lambda: len(loop.heard['state']) > states + 100, 10.0)
    seen = stops(loop, began)
    latched = any(' fault' in item or ' estop' in item for item in seen)
    refused = ''
    for _ in range(10):
        if not latched or loop.running():
            break
        refused = loop.reset()
        loop.until(loop.running, 3.0)
    outcome.safe = how_soon(case, loop, truths, began)
    shown = dict.fromkeys(seen)
    outcome.modes = '; '.join(list(shown)[:4]) + (' …' if len(shown) > 4 else '') or '-'
    if loop.noted:
        outcome.modes = '; '.join([outcome.modes, loop.noted][outcome.modes == '-':])
    if not loop.until(loop.running, 10.0):
        outcome.verdict = f'FAILED: not running again; {refused or loop.why()}'
        return
    since, resumed = loop.now(), time.monotonic()
    for _ in range(ATTEMPTS):
        loop.pass_time(SETTLE + window)
        after = loop.error(window)
        if after <= max(SLACK * before, before + floor):
            break
        loop.reset()        # the law's own latch, if a stall of the machine has fired it
    outcome.largest = f'{loop.largest(states):.2f}'
    shown_worst = f' ({worst * 1e3:.2f})' if case.network else ''
    outcome.error = (f'{before * 1e3:.2f}{shown_worst} → {after * 1e3:.2f} in '
                     f'{loop.now() - since:.0f} s')
    wrong = [*loop.wrong]
    if case.tracks and not worst <= bound(loop.configuration):
        wrong.append(f'beyond the guaranteed {bound(loop.configuration) * 1e3:.2f} mrad meanwhile')
    if not (case.coasts or loop.largest(states) < BOUND):
        wrong.append('not bounded')
    if any(process.poll() is not None for process in loop.processes.values()):
        wrong.append('a node ended')
    if not after <= max(SLACK * before, before + floor):
        wrong.append('tracks worse')
    if case.must == RIDE and latched:
        wrong.append('latched')
    if case.must == LATCH and not latched:
        wrong.append('did not latch')
    if case.silence and 'samples' in outcome.safe and float(outcome.safe.split()[0]) > 3.0:
        wrong.append('safe command late')
    later = stops(loop, resumed) if wrong else []
    if later:
        wrong.append(f'stopped again: {"; ".join(later[:4])}')
    outcome.verdict = 'FAILED: ' + ', '.join(wrong) if wrong else 'as it must'


def stops(loop: Loop, since: float) -> list[str]:
    """Return which ends stopped after a time of the steady clock [s], and why."""
    return [f'{name.removesuffix("_node")} {mode}' + (f' ({why})' if why else '')
            for name in loop.nodes for when, mode, why in loop.modes[name]
            if when > since and mode in ('lost', 'fault', 'estop')]


def bound(configuration: Configuration) -> float:
    """Return the largest |x̃| that the law's own layer allows [rad]."""
    design = configuration.law.design
    return guaranteed_bounds(design.lambda_, design.epsilon, configuration.plant.order)[0]


def how_soon(case: Case, loop: Loop, truths: int, began: float) -> str:
    """Return how soon the actuator held the safe command, in words; '-' if it never did."""
    if case.device:
        return '-' if math.isnan(loop.device_safe) else f'{loop.device_safe * 1e3:.0f} ms'
    if loop.drive is not None:
        stopped = loop.drive.stopped_after(began)
        return '-' if stopped is None else f'{stopped * 1e3:.0f} ms'
    rows = [(when, row) for when, row in loop.heard['truth'][truths:]
            if abs(loop.held(row)) < 1e-12 and when > began]
    if not rows or case.must == RIDE:
        return '-'
    pressed = loop.pressed
    when, row = next((item for item in rows if item[0] > (pressed or 0.0)), rows[0])
    if pressed is not None:
        command = next((at for at, item in loop.heard['command'] if at > pressed
                        and item[2] == 0.0), when)
        return f'{(when - pressed) * 1e3:.0f} ms, command {(command - pressed) * 1e3:.0f} ms'
    last = [item for _, item in loop.heard['command'] if item[2] != 0.0 and item[1] <= row[1]]
    if case.silence and last:
        return f'{round((row[1] - last[-1][1]) / loop.period)} samples'
    return f'{(when - began) * 1e3:.0f} ms'


@contextmanager
def serial_device(case: Case, window: float, folder: Path) -> Iterator[None]:
    """Give the loop an emulated device on a serial line, with a fault after the first windows."""
    if case.device is None:
        yield
        return
    name, lasting = case.device
    start = WINDOWS * (SETTLE + window) + 8.0
    with (folder / 'device').open('w') as said:
        process = subprocess.Popen(
            [sys.executable, '-m', 'dz_ros', 'driver', 'emulate', 'serial',
             str(ROOT / 'config' / 'servo.yaml'), *(word for item in SETTINGS
                                                    for word in ('--set', item)),
             '-o', f'link={folder / "port"}', '--fault', f'{name}@{start:g}+{lasting}'],
            env={**os.environ, 'PYTHONPATH': str(ROOT)}, stdout=said, stderr=said)
    try:
        end = time.monotonic() + 20.0
        while not (folder / 'port').is_symlink() and time.monotonic() < end:
            time.sleep(0.02)
        yield
    finally:
        process.terminate()
        process.wait(10.0)


@contextmanager
def two_hosts(case: Case) -> Iterator[dict[str, list[str]]]:
    """Give controller and trajectory a host of their own; this process is the other one."""
    if not case.two_hosts:
        yield {}
        return
    if os.environ.get('DZ_FAULT_HOST') != 'A':
        raise SkippedError('network namespaces are not permitted here')
    hosted = ['ip', 'netns', 'exec', f'{NETWORK}B']
    yield dict.fromkeys(('controller_node', 'trajectory_node'), hosted)


def in_two_hosts(case: Case, window: float) -> Outcome:
    """Run this program again inside a network namespace that is linked to another one."""
    steps = ([f'ip netns add {NETWORK}{side}' for side in 'AB']
             + [f'ip link add dzA netns {NETWORK}A type veth peer name dzB netns {NETWORK}B']
             + [line for side, number in (('A', 1), ('B', 2)) for line in (
                 f'ip -n {NETWORK}{side} addr add 10.77.0.{number}/24 dev dz{side}',
                 f'ip -n {NETWORK}{side} link set dz{side} up',
                 f'ip -n {NETWORK}{side} link set lo up',
                 f'ip -n {NETWORK}{side} route add 224.0.0.0/4 dev dz{side}')])
    try:
        for step in steps:
            try:
                subprocess.run(step.split(), check=True, capture_output=True, text=True)
            except (OSError, subprocess.CalledProcessError) as error:
                why = getattr(error, 'stderr', '') or str(error)
                return Outcome(case.name, case.must, verdict=f'skipped: {step}: {why.strip()}')
        environment = {**os.environ, 'DZ_FAULT_HOST': 'A', 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4',
                       'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}
        done = subprocess.run(['ip', 'netns', 'exec', f'{NETWORK}A', sys.executable, __file__,
                               '--only', case.name, '--json', '--window', str(window)],
                              env=environment, capture_output=True, text=True, check=False)
        try:
            return Outcome(**json.loads(done.stdout.splitlines()[-1]))
        except (IndexError, ValueError, TypeError):
            return Outcome(case.name, case.must,
                           verdict='FAILED: ' + (done.stderr.splitlines() or ['?'])[-1])
    finally:
        for side in 'AB':
            subprocess.run(['ip', 'netns', 'del', f'{NETWORK}{side}'], capture_output=True,
                           check=False)


def table(outcomes: list[Outcome]) -> str:
    """Return the outcomes as a Markdown table."""
    lines = ['| fault | must | actuator safe after | modes on the way | max\\|x\\| [rad] | '
             'max\\|x̃\\| before (meanwhile) → after [mrad] | load | verdict |', RULE]
    lines += [f'| {item.name} | {item.must} | {item.safe} | {item.modes} | {item.largest} | '
              f'{item.error} | {item.load} | {item.verdict} |' for item in outcomes]
    return '\n'.join(lines)


def summary(outcomes: list[Outcome], window: float) -> str:
    """Return the table below a line that says what it was measured on."""
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    return (f'Measured on {describe("ros-rclpy", "numpy")}, nice {nice}; windows of {window:g} s.'
            f'\n\n{table(outcomes)}')


def write(text: str) -> None:
    """Put the table into the document; rows that were not measured now stay."""
    path = ROOT / 'docs' / 'safety.md'
    head, _, rest = path.read_text(encoding='utf-8').partition(BEGIN)
    old, _, tail = rest.partition(END)
    rows = {line.split('|')[1].strip(): line for line in old.splitlines() if line.startswith('| ')}
    rows.update({line.split('|')[1].strip(): line for line in text.splitlines()
                 if line.startswith('| ')})
    names = ['fault', *(case.name for case in CASES)]
    lines = [rows[name] for name in names if name in rows]
    lines.insert(1, RULE)
    about = next(line for line in text.splitlines() if line.startswith('Measured'))
    body = '\n'.join([about, '', *lines])
    path.write_text(f'{head}{BEGIN}\n{body}\n{END}{tail}', encoding='utf-8')


def main() -> int:
    """Inject the faults asked for; return how many did not end as they must."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--only', nargs='+', default=[''], metavar='WORD')
    parser.add_argument('--window', type=float, default=10.0, metavar='S',
                        help='max|x̃| is taken over so long (default: %(default)s)')
    parser.add_argument('--write', action='store_true')
    parser.add_argument('--json', action='store_true', help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with contextlib.suppress(OSError):      # other programs are not the faults meant here
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    outcomes = []
    for case in CASES:
        if not any(word in case.name for word in arguments.only):
            continue
        if case.clock and not FAKETIME.exists():
            outcome = Outcome(case.name, case.must, verdict='skipped: needs the package faketime')
        elif case.two_hosts and os.environ.get('DZ_FAULT_HOST') != 'A':
            outcome = in_two_hosts(case, arguments.window)
        else:
            outcome = run_case(case, arguments.window)
        outcome.load = f'{os.getloadavg()[0]:.1f}'
        outcomes.append(outcome)
        print(json.dumps(vars(outcome)) if arguments.json else
              f'{outcome.name}: {outcome.verdict}   [safe after {outcome.safe or "-"}; '
              f'{outcome.modes}; {outcome.error} mrad]', flush=True)
        if arguments.write:
            # One by one: what was measured stays if this is ended.
            write(summary(outcomes, arguments.window))
    if not arguments.json:
        print('\n' + summary(outcomes, arguments.window))
    return sum(item.verdict.startswith('FAILED') for item in outcomes)


if __name__ == '__main__':
    sys.exit(main())
