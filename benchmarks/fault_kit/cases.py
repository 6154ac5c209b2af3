"""The faults: what is injected, what must happen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import math
import os
from pathlib import Path
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

from fault_kit.loop import Loop, ROOT
from std_msgs.msg import Bool

from dz_ros.core.records import Command, State
from dz_ros.recording.reader import read_run
from dz_ros.recording.recover import recover

RIDE, LATCH, EITHER = 'rides through', 'safe, then fault until reset', 'safe; fault if it lasts'
RELAY = {'controller_node': (), 'trajectory_node': (),
         'plant_node': ('-r', 'state:=plant_state', '-r', 'command:=plant_command')}


class SkippedError(Exception):
    """The fault cannot be injected here; the message says why."""


@dataclass(frozen=True)
class Case:
    """One fault.

    Attributes:
        name: What is injected.
        must: What must happen: RIDE, LATCH or EITHER.
        inject: Does it, and undoes it where it can be undone.
        silence: Whether the commands stop, so that the hold is measured.
        settings: Dotted keys that differ.
        network: Faults of the relay between the halves of the loop; empty = no relay.
        tracks: Whether |x̃| must stay within the guaranteed bound meanwhile.
        two_hosts: Whether the halves run in network namespaces of their own.
        clock: Whether the nodes see a wall clock of their own.
    """

    name: str
    must: str
    inject: Callable[[Loop], None]
    silence: bool = False
    settings: dict[str, Any] = field(default_factory=dict)
    network: dict[str, float] = field(default_factory=dict)
    tracks: bool = False
    two_hosts: bool = False
    clock: bool = False


def kill(name: str) -> Callable[[Loop], None]:
    """Kill a node and start it again."""
    def inject(loop: Loop) -> None:
        loop.processes[name].kill()
        loop.processes[name].wait()
        time.sleep(0.8)
        seen = len(loop.heard['state'])
        loop.start(name)
        loop.until(lambda: len(loop.heard['state']) > seen + 5)
        time.sleep(4.0)
    return inject


def freeze(name: str, seconds: float) -> Callable[[Loop], None]:
    """Stop a process for a while."""
    def inject(loop: Loop) -> None:
        os.kill(loop.processes[name].pid, signal.SIGSTOP)
        time.sleep(seconds)
        os.kill(loop.processes[name].pid, signal.SIGCONT)
        time.sleep(1.0)
    return inject


def messages(kind: str) -> Callable[[Loop], None]:
    """Send bad commands and states beside the good ones, 200 of each."""
    def inject(loop: Loop) -> None:
        for _ in range(200):
            for topic in ('command', 'state'):
                row = loop.heard[topic][-1][1]
                labels = Command.labels() if topic == 'command' else State.labels(len(row) - 5)
                numbers = [row[0] + 1.0, *row[1:]]
                if kind in ('nan', 'inf'):
                    numbers[2] = math.nan if kind == 'nan' else math.inf
                elif kind == 'truncated':
                    numbers = numbers[:2]
                else:
                    labels = ('v', *labels[1:])
                loop.send(topic, numbers, labels)
            time.sleep(0.005)
    return inject


def two_controllers(loop: Loop) -> None:
    """Answer every state a second time, from another publisher with its own seq."""
    end, seq = time.monotonic() + 2.0, 0
    while time.monotonic() < end:
        state = loop.heard['state'][-1][1]
        loop.send('command', (seq, state[1], 3.0, state[0], state[1], 0.0))
        seq += 1
        time.sleep(0.005)


def press(loop: Loop) -> None:
    """Press the e-stop at full speed, release it a second later."""
    loop.until(lambda: abs(loop.heard['state'][-1][1][3]) > 1.8, 10.0)
    loop.pressed = time.monotonic()     # type: ignore[attr-defined]
    loop.estop.publish(Bool(data=True))
    time.sleep(1.0)
    loop.estop.publish(Bool(data=False))
    time.sleep(0.2)


def busy(_loop: Loop) -> None:
    """Keep every core busy with as many processes again as there are cores."""
    burners = [subprocess.Popen([sys.executable, '-c', 'while True: pass'])
               for _ in range(os.cpu_count() or 1)]
    time.sleep(6.0)
    for item in burners:
        item.kill()
        item.wait()


def full_disk(loop: Loop) -> None:
    """Let the recorder's file reach the largest size it may have, then read what is there."""
    folder = Path(tempfile.mkdtemp(prefix='dz_ros-fault-'))
    try:
        recorder = loop.start(
            'recorder_node', '-p', f'directory:={folder / "run"}',
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000)))
        loop.until(lambda: recorder.poll() is not None)
        del loop.processes['recorder_node']
        found = subprocess.run([sys.executable, '-m', 'dz_ros', 'bag', 'recover',
                                str(folder / 'run'), str(folder / 'whole')], cwd=ROOT,
                               capture_output=True, text=True, check=False)
        if recorder.returncode != 2 or found.returncode:
            raise AssertionError(f'recorder {recorder.returncode}, recover: {found.stderr}')
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def kill_recorder(loop: Loop) -> None:
    """Kill the recorder, start another; of the first all but its last second can be recovered.

    Raises:
        AssertionError: It is not, or the second recorder lost something.
    """
    folder = Path(tempfile.mkdtemp(prefix='dz_ros-fault-'))
    try:
        first = loop.start('recorder_node', '-p', f'directory:={folder / "first"}')
        loop.until(lambda: any((folder / 'first').glob('*.mcap')))
        loop.pass_time(5.0)
        killed = loop.now()
        first.kill()
        first.wait()
        second = loop.start('recorder_node', '-p', f'directory:={folder / "second"}')
        loop.until(lambda: any((folder / 'second').glob('*.mcap')))
        loop.pass_time(5.0)
        second.send_signal(signal.SIGINT)
        second.wait(30.0)
        del loop.processes['recorder_node']
        recover(folder / 'first', folder / 'whole')
        rows = read_run(folder / 'whole').channels['state']
        after = read_run(folder / 'second').channels['state']
        if rows['stamp'][-1] < killed - 1.0 or not len(after):
            raise AssertionError(f'killed at {killed:g} s, recovered to {rows["stamp"][-1]:g} s')
        for found in (rows['seq'], after['seq']):
            if len(found) != found[-1] - found[0] + 1.0:
                raise AssertionError('samples are missing in a recording')
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def step_clock(loop: Loop) -> None:
    """Set the wall clock that the nodes see an hour ahead, then an hour back, then right.

    Raises:
        AssertionError: A recording made meanwhile has times that are not those of the loop.
    """
    folder = Path(tempfile.mkdtemp(prefix='dz_ros-fault-'))
    try:
        recorder = loop.start('recorder_node', '-p', f'directory:={folder / "run"}')
        loop.until(lambda: any((folder / 'run').glob('*.mcap')))
        loop.pass_time(3.0)
        for shift in ('+1h', '-1h', '+0'):
            loop.clock.write_text(shift)
            time.sleep(3.0)
        recorder.send_signal(signal.SIGINT)
        recorder.wait(30.0)
        del loop.processes['recorder_node']
        states = read_run(folder / 'run').channels['state']
        passed = (states.log_time - states.log_time[0]) * 1e-9
        worst = abs(passed - (states['stamp'] - states['stamp'][0])).max()
        if len(states) < 1000 or worst > 2.0:
            raise AssertionError(f'{len(states)} states, log times off by up to {worst:.1f} s')
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def cut_link(_loop: Loop) -> None:
    """Cut the link between the two hosts for two seconds."""
    def link(state: str) -> None:
        subprocess.run(['ip', 'link', 'set', 'dzA', state], check=True)
    link('down')
    time.sleep(2.0)
    link('up')
    time.sleep(5.0)


def bad_network(loop: Loop) -> None:
    """Let the relay do its worst for a while."""
    relay = loop.processes['relay']
    relay.send_signal(signal.SIGUSR1)
    loop.pass_time(8.0)
    relay.send_signal(signal.SIGUSR2)


NETS = {'loss 1 %': {'loss': 0.01}, 'loss 5 %': {'loss': 0.05}, 'loss 20 %': {'loss': 0.2},
        'delay 5 ms': {'delay': 0.005}, 'delay 20 ms': {'delay': 0.02},
        'jitter 0 to 8 ms': {'jitter': 0.008}, 'reordering 10 %': {'reorder': 0.1},
        'duplication 30 %': {'duplicate': 0.3}}
# Designed for a delay of 5 ms each way: two samples more than the transport's own.
SLOW = {'controller.design_delay': 3}

CASES = (
    Case('nothing', RIDE, lambda loop: loop.pass_time(2.0)),
    *(Case(f'kill -9 {name}, restart', LATCH, kill(name), silence=name == 'controller_node')
      for name in ('plant_node', 'controller_node', 'trajectory_node')),
    *(Case(f'SIGSTOP {name} {round(seconds * 1000)} ms', EITHER if seconds < 1.0 else LATCH,
           freeze(name, seconds), silence=name == 'controller_node')
      for name in ('plant_node', 'controller_node', 'trajectory_node')
      for seconds in (0.05, 0.5, 5.0)),
    *(Case(f'{kind} messages', RIDE, messages(kind))
      for kind in ('nan', 'inf', 'truncated', 'mislabelled')),
    Case('two controllers', LATCH, two_controllers),
    Case('wall clock ±1 h', RIDE, step_clock, clock=True),
    *(Case(f'{name} for 8 s', EITHER, bad_network, network=net,
           settings=SLOW if net.get('delay') == 0.005 else {}, tracks=net.get('delay') == 0.005)
      for name, net in NETS.items()),
    Case('loss 5 % and delay 5 ms for 8 s', RIDE, bad_network, tracks=True, settings=SLOW,
         network={'loss': 0.05, 'delay': 0.005}),
    Case('link cut 2 s between two hosts', LATCH, cut_link, silence=True, two_hosts=True),
    Case('every core busy', EITHER, busy),
    Case("recorder's disk full", RIDE, full_disk),
    Case('kill -9 recorder_node, restart', RIDE, kill_recorder),
    Case('e-stop at full speed', LATCH, press),
)
