# SPDX-License-Identifier: Apache-2.0
"""Steps per second of the loop in lockstep over DDS, recorded, beside bare two-process echoes.

The bare echoes are two processes, the same bytes by the same client library and quality of
service, served by its quickest executor, no number computed, nobody recording.

    echo of all messages    one side sends state, truth and the clock's time, the other answers
                            with command, terms and reference: all that a step of the loop sends;
                            also set up as our nodes are (what is asked of the middleware,
                            messages taken by hand without sleeping, cores), which is the least a
                            step can be, and that recorded by our recorder, as the loop is
    echo of state, command  the two that have to wait for each other

Loop and echoes take turns, so that they meet the same machine. On a busy machine the ratio says
more than the speed.

    python benchmarks/lockstep.py [--repetitions N] [--duration S]

Over 300 lines: the loop and each echo it is compared with take turns in one measurement.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.rows import Row, say, show  # noqa: E402
from benchmarks.speed_kit.running import environment  # noqa: E402
from dz_ros.core.records import Command, Reference, State, Terms, Truth  # noqa: E402
from dz_ros.recording.cdr import ArrayCodec  # noqa: E402
from dz_ros.runtime.privileges import usable_cores, use_cores  # noqa: E402

RATE = 200.0
"""Samples per second of loop time in the configuration measured."""
TARGET_STEPS, TARGET_RATIO = 5.0 * RATE, 0.6


def payload(labels: tuple[str, ...]) -> bytes:
    """Return the bytes of a record with these labels."""
    return ArrayCodec(labels).encode([0.0] * len(labels))


FORTH = {'state': payload(State.labels(2)), 'truth': payload(Truth.labels()),
         'time': payload(('sec', 'nanosec'))}
BACK = {'command': payload(Command.labels()),
        'terms': payload(Terms.labels(('theta1', 'theta2', 'phi'))),
        'reference': payload(Reference.labels(2))}
"""Topic → bytes, the one that the other side waits for first."""
RECORDED = ('state', 'truth', 'command', 'terms', 'reference')
"""Topics of an echo that the recorder knows; it takes no note of the clock."""
TIME_OUT = 180.0


def loop(duration: float, record: bool) -> float:
    """Return steps per second of one run, as its plant measured them."""
    with tempfile.TemporaryDirectory() as folder:
        words = ['--record', str(Path(folder) / 'run')] if record else []
        done = subprocess.run(
            [sys.executable, '-m', 'dz_ros', 'run', '--lockstep', '--duration', str(duration),
             '--quiet', *words], cwd=ROOT, env=environment(), capture_output=True, text=True,
            check=False, timeout=TIME_OUT)
        found = re.search(r'(\d+) per second', done.stdout)
        if done.returncode or found is None:
            sys.exit(done.stdout + done.stderr)
        if record and 'none missing' not in done.stdout:
            sys.exit(f'the recording is not whole: {done.stdout}')
        return float(found[1])


def echo(count: int, whole: bool, profile: bool = False, listeners: int = 1) -> float:
    """Return round trips per second of a bare echo, of all messages or of two.

    Both sides are processes of their own: a second life of rclpy in one process is slower.

    Args:
        count: Round trips.
        whole: All messages, or state and command only.
        profile: Set up as our nodes are, or with what rclpy and the middleware do by themselves.
        listeners: Of each topic that a recorder knows; waited for.
    """
    size = len(FORTH) if whole else 1
    side = [sys.executable, __file__, '--side', str(size), *(['--alike'] if profile else [])]
    env = environment(profile=profile)
    answering = subprocess.Popen(side, cwd=ROOT, env=env)
    try:
        done = subprocess.run(
            [*side, '--count', str(count), '--listeners', str(listeners)], cwd=ROOT, env=env,
            capture_output=True, text=True, check=False, timeout=2.0 * TIME_OUT)
    finally:
        answering.terminate()
        answering.wait(TIME_OUT)
    if done.returncode:
        sys.exit(done.stderr)
    return float(done.stdout)


def recorded_echo(count: int) -> float:
    """Return round trips per second of an echo of all messages, set up alike, our recorder."""
    with tempfile.TemporaryDirectory() as folder:
        recorder = subprocess.Popen(
            [sys.executable, '-m', 'dz_ros.nodes.main', 'recorder_node', '--ros-args', '-r',
             '__ns:=/echo', '-p', 'loop.timing:=lockstep', '-p', f'directory:={folder}/run'],
            cwd=ROOT, env=environment(), stderr=subprocess.PIPE, text=True)
        try:
            speed = echo(count, True, True, 2)
        finally:
            recorder.terminate()
            _, said = recorder.communicate(timeout=TIME_OUT)
    found = re.search(r'(\d+) messages', said)
    if found is None or int(found[1]) < count * len(RECORDED):
        sys.exit(f'the echo was not recorded whole: {said}')
    return speed


class Side:
    """One of the two: what it sends, what it hears, whether it is set up as our nodes are."""

    def __init__(self, sends: Sequence[tuple[str, bytes]], hears: Sequence[str],
                 alike: bool) -> None:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
        from std_msgs.msg import Float64MultiArray

        from dz_ros.nodes.ros.base import quickest_executor
        from dz_ros.nodes.ros.polling import PolledSubscriptions
        from dz_ros.nodes.ros.stop_and_reset import EAGER
        from dz_ros.nodes.ros.topics import LOCKSTEP

        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.told = False
        signal.signal(signal.SIGTERM, self.tell)
        self.node = rclpy.create_node(f'echo_{sends[0][0]}')
        self.executor = quickest_executor()
        self.executor.add_node(self.node)
        self.publishers = [self.node.create_publisher(Float64MultiArray, f'echo/{name}', LOCKSTEP)
                           for name, _ in sends]
        self.outputs = [(publisher.publish, data) for publisher, (_, data)
                        in zip(self.publishers, sends, strict=True)]
        self.heard = self.others = 0
        self.answering = False
        self.eager = EAGER
        self.polled = PolledSubscriptions(self.node) if alike else None
        for i, name in enumerate(hears):
            hear = self.other if i else self.first
            if self.polled is not None:
                self.polled.subscribe(Float64MultiArray, f'echo/{name}', LOCKSTEP, hear)
            else:
                self.node.create_subscription(Float64MultiArray, f'echo/{name}', hear, LOCKSTEP,
                                              raw=True)
        if alike:
            use_cores(usable_cores()[sends[0][0] == 'command'::2] or usable_cores())

    def tell(self, *_: object) -> None:
        """End."""
        self.told = True

    def send(self) -> None:
        """Send one of each."""
        for publish, data in self.outputs:
            publish(data)

    def spin(self, limit: float = 0.05) -> None:
        """Hear what comes."""
        if self.polled is not None:
            self.polled.poll_soon(self.eager, limit)
        else:
            self.executor.spin_once(timeout_sec=limit)

    def first(self, _data: bytes, *_times: int) -> None:
        """Hear what is waited for."""
        self.heard += 1
        if self.answering:
            self.send()

    def other(self, _data: bytes, *_times: int) -> None:
        """Hear anything else."""
        self.others += 1

    def ask(self, count: int, listeners: int) -> float:
        """Send, wait for the answer, and so on; return how often per second."""
        give_up = time.monotonic() + TIME_OUT
        while listeners > 1 and any(self.node.count_subscribers(f'echo/{name}') < listeners
                                    for name in RECORDED):
            self.spin()
            if time.monotonic() > give_up:
                sys.exit('no recorder')
        while not self.heard:       # until both hear each other
            self.send()
            self.spin(0.5)
            if time.monotonic() > give_up:
                sys.exit('nobody answers')
        quiet = time.monotonic() + 1.0
        while time.monotonic() < quiet:
            self.spin()
        self.heard, self.answering = 0, True
        begin = time.perf_counter()
        self.send()                 # from here on one step is under way, never two
        while self.heard < count:
            self.spin()
            if time.monotonic() > give_up:
                sys.exit('the echo was lost')
        return self.heard / (time.perf_counter() - begin)

    def answer(self) -> None:
        """Answer until told to end."""
        self.answering = True
        while not self.told:
            self.spin()

    def __enter__(self) -> Side:
        return self

    def __exit__(self, *_: object) -> None:
        import rclpy

        from dz_ros.nodes.ros.base import deliver

        deliver(*self.publishers)
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        rclpy.try_shutdown()


def measure(quick: bool, repetitions: int = 5, duration: float = 15.0) -> list[Row]:
    """Return the speed of the loop in lockstep against real time and the echoes, in turns."""
    repetitions = 2 if quick else repetitions
    count = round(duration * RATE)
    ways: dict[str, Callable[[], float]] = {
        'echo': lambda: echo(count, True),
        'recorded': lambda: loop(duration, True),
        'recorded echo': lambda: recorded_echo(count),
        'unrecorded': lambda: loop(duration, False),
        'echo set up alike': lambda: echo(count, True, True),
        'echo of two': lambda: echo(count, False)}
    speeds: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(repetitions):
        for name, way in ways.items():
            speeds[name].append(way())
        say(f'turn {turn + 1} of {repetitions}, steps per second: ' + ', '.join(
            f'{name} {found[-1]:.0f}' for name, found in speeds.items()))

    def words(name: str) -> str:
        found = speeds[name]
        return (f'{statistics.median(found):.0f} steps/s '
                f'({min(found):.0f} to {max(found):.0f})')

    def over(what: str, name: str, other: str, target: float | None = None) -> Row:
        ratio = statistics.median(a / b for a, b in zip(speeds[name], speeds[other], strict=True))
        return Row(what, ratio, target, least=True, detail=f'{words(name)} beside {words(other)}')

    return [
        Row('lockstep, recorded, over real time at 200 Hz',
            statistics.median(speeds['recorded']) / RATE, TARGET_STEPS / RATE, least=True,
            detail=words('recorded')),
        over('lockstep, recorded, over a bare echo of all its messages', 'recorded', 'echo',
             TARGET_RATIO),
        over('lockstep, not recorded, over a bare echo of all its messages', 'unrecorded', 'echo'),
        over('that echo set up as our nodes are, recorded over not', 'recorded echo',
             'echo set up alike'),
        over('lockstep over that echo, set up alike, recorded', 'recorded', 'recorded echo'),
        over('lockstep over that echo, set up alike, not recorded', 'unrecorded',
             'echo set up alike'),
        over('lockstep, recorded, over a bare echo of state and command', 'recorded',
             'echo of two')]


def main() -> int:
    """Measure in turns; print; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--repetitions', type=int, default=5)
    parser.add_argument('--duration', type=float, default=15.0, help='of a run [s of loop time]')
    parser.add_argument('--side', type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument('--alike', action='store_true', help=argparse.SUPPRESS)
    parser.add_argument('--count', type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument('--listeners', type=int, default=1, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.side:
        size = arguments.side
        if arguments.count:
            with Side(list(FORTH.items())[:size], list(BACK)[:size], arguments.alike) as side:
                print(side.ask(arguments.count, arguments.listeners))
            return 0
        with Side(list(BACK.items())[:size], list(FORTH)[:size], arguments.alike) as side:
            side.answer()
        return 0
    print(describe('ros-rclpy', 'ros-rmw-fastrtps-cpp'))
    return show(measure(False, arguments.repetitions, arguments.duration))


if __name__ == '__main__':
    sys.exit(main())
