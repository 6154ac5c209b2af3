# SPDX-License-Identifier: Apache-2.0
"""The driver `joint`: error of the published state and of the joint itself, by the age of states.

    python benchmarks/joint.py                 print the table; about two minutes
    python benchmarks/joint.py --write         and put it into docs/ros2_control.md

config/joint.yaml against the process of the tests that behaves as ros2_control's controllers do.
The actuator's node runs in this process, so that loop time and the joint's own log have one clock.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / 'benchmarks'))

from machine import describe  # noqa: E402

from dz_ros.files.configurations import load_configuration, write_parameters  # noqa: E402

EMULATOR = ROOT / 'test' / 'nodes' / 'ros2_control_emulator.py'
OVERRIDES = ['safety.state_hold=40', 'safety.command_hold=40', 'safety.echo_limit=40',
             'driver.fresh=4', 'safety.error_limit=0']
"""A shared machine stalls; what is measured here is the age of states, not that."""
CASES = ((500, 0.0), (200, 0.0), (200, 0.003))
"""Rate of the controller manager [Hz], what a state waits besides [s]."""
BEGIN, END = '<!-- joint table: benchmarks/joint.py writes it -->', '<!-- end of joint -->'


def actuator(parameters: str, found: str) -> int:
    """Run the actuator's node in this process; write what it published, by the steady clock."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from dz_ros.nodes.actuator_node import ActuatorNode

    class Measured(ActuatorNode):
        """Keeps what it publishes, and when loop time began."""

        def set_up(self) -> None:
            """Offer states, keep them as well."""
            super().set_up()
            self.rows: list[tuple[float, float]] = []
            publish = self._publish_state

            def keep(numbers: Any) -> None:
                self.rows.append((numbers[1], numbers[2]))
                publish(numbers)

            self._publish_state = keep

        def finish(self, **details: int) -> None:
            """Keep when loop time began."""
            self.began = (self.clock.start_ns or 0) * 1e-9
            super().finish(**details)

    rclpy.init(args=['--ros-args', '--params-file', parameters],
               signal_handler_options=SignalHandlerOptions.NO)
    node = Measured()
    node.run()
    node.close()
    rclpy.try_shutdown()
    Path(found).write_text(json.dumps({'began': node.began, 'rows': node.rows}), encoding='utf-8')
    return 0


def measure(rate: int, delay: float, extrapolate: bool, seconds: float) -> list[str]:
    """Return a row of the table."""
    configuration = load_configuration('joint', [
        *OVERRIDES, f'loop.duration={seconds}', f'driver.extrapolate={str(extrapolate).lower()}'])
    with tempfile.TemporaryDirectory(prefix='dz_ros-joint-') as folder:
        parameters, log, found = (Path(folder) / name for name in ('p.yaml', 'log', 'found'))
        write_parameters(configuration, parameters)
        environment = {**os.environ, 'PYTHONPATH': str(ROOT)}

        def start(*words: str) -> subprocess.Popen[bytes]:
            return subprocess.Popen([sys.executable, *words], env=environment,
                                    stdout=subprocess.DEVNULL, start_new_session=True)

        emulator = start(str(EMULATOR), str(parameters), 'forward', f'rate={rate}',
                         f'delay={delay}', f'log={log}', 'active=1')
        others = [start('-m', 'dz_ros.nodes.main', name, '--ros-args', '--params-file',
                        str(parameters)) for name in ('controller_node', 'trajectory_node')]
        try:
            start(__file__, '--actuator', str(parameters), str(found)).wait(seconds + 90.0)
        finally:
            for process in (*others, emulator):
                process.send_signal(signal.SIGINT)
            for process in (*others, emulator):
                process.wait(30.0)
        said = json.loads(found.read_text(encoding='utf-8'))
        own = np.loadtxt(log)
    t, x = np.array(said['rows']).T
    window = t > seconds / 2.0
    x_d = np.array([configuration.trajectory(instant)[0] for instant in t])
    truth = np.interp(t + said['began'], own[:, 0], own[:, 1])
    errors = [np.abs(values[window]) * 1e3 for values in (x - x_d, truth - x_d, x - truth)]
    return [f'{rate}', f'{delay * 1e3:g}', 'yes' if extrapolate else 'no',
            *(f'{np.median(item):.2f}, {np.percentile(item, 99):.2f}' for item in errors)]


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--seconds', type=float, default=14.0, help='length of each run')
    parser.add_argument('--write', action='store_true')
    parser.add_argument('--actuator', nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.actuator:
        return actuator(*arguments.actuator)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    busy = f'load average {os.getloadavg()[0]:.1f} before'
    rows = [measure(rate, delay, extrapolate, arguments.seconds)
            for rate, delay in CASES for extrapolate in (False, True)]
    head = ['update_rate [Hz]', 'wait besides [ms]', 'extrapolate',
            'published error [mrad] p50, p99', "the joint's own p50, p99",
            'published − own p50, p99']
    lines = ['', f'Measured on {describe("ros-rclpy", "numpy")}, {busy}; second half of '
             f'{arguments.seconds:g} s each.', '',
             *(f'| {" | ".join(line)} |' for line in (head, ['---'] * len(head), *rows)), '']
    print('\n'.join(lines))
    if arguments.write:
        path = ROOT / 'docs' / 'ros2_control.md'
        before, _, rest = path.read_text(encoding='utf-8').partition(BEGIN)
        path.write_text(before + BEGIN + '\n'.join(lines) + '\n' + END + rest.partition(END)[2],
                        encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
