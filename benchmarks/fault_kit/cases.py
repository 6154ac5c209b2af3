# SPDX-License-Identifier: Apache-2.0
"""The faults: what is injected, what must happen.

Over 300 lines: one function for each fault, and the table of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
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

from diagnostic_msgs.msg import DiagnosticArray
from fault_kit import drive
from fault_kit.loop import Loop, ROOT
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

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
        device: Fault of an emulated device on a serial line, which is then the actuator, as
            NAME, DURATION[=VALUE]; None = the simulated plant.
        drive: Whether the actuator is a simulated drive on a CAN bus.
        joint: Whether the actuator is a joint of ros2_control.
        coasts: Whether it may move far before it rests: nothing takes commands meanwhile, or
            nothing shows where it is.
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
    device: tuple[str, str] | None = None
    drive: bool = False
    joint: bool = False
    coasts: bool = False


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
        for count in range(200):
            for topic in ('command', 'state'):
                row = loop.heard[topic][-1][1]
                labels = Command.labels() if topic == 'command' else State.labels(len(row) - 5)
                numbers = [row[0] + 1.0, *row[1:]]
                if kind in ('nan', 'inf'):
                    numbers[2] = math.nan if kind == 'nan' else math.inf
                elif kind == 'truncated':
                    numbers = numbers[:2]
                elif kind == 'out-of-range':    # seq, stamp, echo_seq by turns
                    echo = labels.index('echo_seq')
                    place = (0, 1, echo)[count % 3]
                    numbers[place] = (1e308, 2.0 ** 53, -1e12 if place == 1 else
                                      numbers[0] + 0.5)[count // 3 % 3]
                else:
                    labels = ('v', *labels[1:])
                loop.send(topic, numbers, labels)
            time.sleep(0.005)
    return inject


def early_references(loop: Loop) -> None:
    """Send references of a later time, 200 of them."""
    for count in range(200):
        seq, stamp = loop.heard['state'][-1][1][:2]
        loop.send('reference', (seq + 2.0, stamp + 10.0 ** (1 + count % 8), 50.0, 0.0, 0.0))
        time.sleep(0.005)


def hostile_text(loop: Loop) -> None:
    """Send events that are no events, and terms of 20 000 names."""
    names = tuple(f'n{k}' for k in range(20_000))
    loop.send('terms', (0.0,) * len(names), names)
    for text in ('[' * 100_000, '{"ends": ' + '[' * 100_000, '{"event": "stopped", "ends": 7}',
                 '{"event": "mode", "node": [], "mode": {}}', '{"ends": "state", "event": 1e999}',
                 '\x00"ends"', 'x' * 1_000_000):
        for _ in range(20):
            loop.send_event(text)
            time.sleep(0.01)
        loop.send('terms', (0.0,) * len(names), names)


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
    loop.pressed = time.monotonic()
    loop.estop.publish(Bool(data=True))
    time.sleep(1.0)
    loop.estop.publish(Bool(data=False))
    time.sleep(0.2)


def touch(kind: str, beside: str = '') -> Callable[[Loop], None]:
    """Press the e-stop at full speed and release it at once, by a publisher of a kind.

    Args:
        kind: Of `fault_kit.presses.QOS`.
        beside: Node that is frozen for half a second around it; 'flood' = 5000 releases/s.
    """
    def inject(loop: Loop) -> None:
        from fault_kit.presses import FLOOD, QOS
        button = loop.node.create_publisher(Bool, 'estop', QOS[kind])
        loop.until(lambda: button.get_subscription_count() >= 2)
        if beside == 'flood':
            loop.run_beside('flood', [sys.executable, '-c', FLOOD])
            loop.until(lambda: loop.node.count_publishers('estop') > 4)
            time.sleep(1.0)
        loop.until(lambda: abs(loop.heard['state'][-1][1][3]) > 1.8, 10.0)
        if beside in loop.processes and beside != 'flood':
            os.kill(loop.processes[beside].pid, signal.SIGSTOP)
            time.sleep(0.25)
        loop.pressed = time.monotonic()
        button.publish(Bool(data=True))
        button.publish(Bool(data=False))
        if beside in loop.processes and beside != 'flood':
            time.sleep(0.25)
            os.kill(loop.processes[beside].pid, signal.SIGCONT)
        time.sleep(1.0)
        if beside == 'flood':
            loop.processes['flood'].kill()
            loop.processes['flood'].wait()
            del loop.processes['flood']
    return inject


def press_and_end(loop: Loop) -> None:
    """Press the e-stop at full speed by a process that ends at once and never releases it."""
    from fault_kit.presses import ONCE
    loop.until(lambda: abs(loop.heard['state'][-1][1][3]) > 1.8, 10.0)
    done = subprocess.run([sys.executable, '-c', ONCE], cwd=ROOT, check=True, timeout=30.0,
                          stdout=subprocess.PIPE, text=True)
    loop.pressed = float(done.stdout)
    time.sleep(1.0)


def busy(_loop: Loop) -> None:
    """Keep every core busy with as many processes again as there are cores."""
    burners = [subprocess.Popen([sys.executable, '-c', 'while True: pass'])
               for _ in range(os.cpu_count() or 1)]
    time.sleep(6.0)
    for item in burners:
        item.kill()
        item.wait()


@contextmanager
def recorder(loop: Loop, limit: int = resource.RLIM_INFINITY
             ) -> Iterator[tuple[subprocess.Popen[bytes], Path, Callable[[str], float]]]:
    """Start a recorder; yield it, its directory, and what waits for an error in its diagnostics.

    The function returns how long that took [s]. At the end the recorder must still be there and
    end by SIGINT.

    Args:
        loop: The loop.
        limit: Largest size of a file, as of a disk that is full then [bytes].
    """
    folder = Path(tempfile.mkdtemp(prefix='dz_ros-fault-'))
    said: list[str] = []

    def hear(message: DiagnosticArray) -> None:
        said.extend(item.message for item in message.status if item.level == item.ERROR
                    and item.name.endswith('recorder_node'))

    def wait_for(part: str) -> float:
        began = time.monotonic()
        if not loop.until(lambda: any(part in item for item in said)):
            raise AssertionError(f'no error {part!r} in the diagnostics of the recorder: {said}')
        return time.monotonic() - began

    subscription = loop.node.create_subscription(DiagnosticArray, '/diagnostics', hear, 100)
    try:
        process = loop.start(
            'recorder_node', '-p', f'directory:={folder / "run"}',
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE,
                                                  (limit, resource.RLIM_INFINITY)))
        loop.until(lambda: any((folder / 'run').glob('*.mcap')))
        loop.pass_time(2.0)
        yield process, folder / 'run', wait_for
        process.send_signal(signal.SIGINT)
        process.wait(30.0)
        del loop.processes['recorder_node']
    finally:
        loop.node.destroy_subscription(subscription)


def whole(run: Path) -> None:
    """Check that a recording was closed and that no state is missing in it; remove it.

    Raises:
        AssertionError: It was not, or one is.
    """
    data = read_run(run)
    seq = data.channels['state']['seq']
    shutil.rmtree(run.parent)
    if 'cut' in data.info or len(seq) != seq[-1] - seq[0] + 1.0:
        raise AssertionError(f'{len(seq)} states of {seq[0]:g} to {seq[-1]:g}; {data.info}')


def full_disk(loop: Loop) -> None:
    """Let the recorder's file reach the largest size it may have, then read what is there.

    Raises:
        AssertionError: The recorder ended by itself, or what it held cannot be recovered.
    """
    with recorder(loop, 200_000) as (process, run, wait_for):
        wait_for('cannot be written')
        loop.pass_time(3.0)
        ended = process.poll()
    kept = recover(run, run.with_name('whole')).messages
    shutil.rmtree(run.parent)
    if ended is not None or process.returncode != 2 or not kept:
        raise AssertionError(f'recorder {ended}, {process.returncode}; recovered {kept}')
    loop.noted = f'{kept} messages recovered'


def freed_disk(loop: Loop) -> None:
    """Let the disk be full for five seconds; nothing may be missing then.

    Raises:
        AssertionError: Something is, or the recorder reports an error at the end.
    """
    with recorder(loop, 200_000) as (process, run, wait_for):
        wait_for('cannot be written')
        loop.pass_time(5.0)
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE,
                         (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        loop.pass_time(2.0)
    whole(run)
    if process.returncode:
        raise AssertionError(f'recorder: exit code {process.returncode}')
    loop.noted = 'nothing lost'


def removed_run(loop: Loop) -> None:
    """Remove the run under the recorder.

    Raises:
        AssertionError: It was not noticed within a second, or the recorder ended.
    """
    with recorder(loop) as (process, run, wait_for):
        shutil.rmtree(run)
        after = wait_for('was removed')
        loop.pass_time(2.0)
        ended = process.poll()
    shutil.rmtree(run.parent)
    if ended is not None or process.returncode != 2 or after > 1.0:
        raise AssertionError(f'recorder {ended}, {process.returncode}; noticed after {after:g} s')
    loop.noted = f'reported after {after:.2f} s'


def moved_run(loop: Loop) -> None:
    """Rename the run's directory under the recorder; nothing may be missing in it."""
    with recorder(loop) as (_, run, _wait):
        moved = run.rename(run.with_name('moved'))
        loop.pass_time(3.0)
    whole(moved)
    loop.noted = 'nothing lost'


def stopped_recorder(loop: Loop) -> None:
    """Stop the recorder's process for five seconds."""
    with recorder(loop) as (process, run, _):
        process.send_signal(signal.SIGSTOP)
        loop.pass_time(5.0)
        process.send_signal(signal.SIGCONT)
        loop.pass_time(2.0)
    states = read_run(run).channels['state']['seq']
    missing = int(states[-1] - states[0] + 1 - len(states))
    shutil.rmtree(run.parent)
    loop.noted = f'{missing} states missing in the recording'


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


def device_fault(loop: Loop) -> None:
    """Wait for the fault of the serial device to begin and end; it must not run meanwhile."""
    def said() -> list[str]:
        return loop.device.read_text().splitlines()

    def place(words: str) -> int:
        return next((at for at, line in enumerate(said()) if words in line), -1)

    loop.until(lambda: place(' begins at') >= 0, 120.0)
    began, start = time.monotonic(), place(' begins at')
    while time.monotonic() < began + 5.0:
        if any(line.startswith('mode ') for line in said()[start:]):
            loop.device_safe = time.monotonic() - began
            break
        time.sleep(0.002)
    loop.until(lambda: place(' ends') >= 0, 30.0)
    loop.until(lambda: loop.mode(loop.nodes[0]) == 'fault', 5.0)
    time.sleep(2.0)
    if 'mode run' in said()[start:]:
        loop.wrong.append('the device ran again without a reset')


def joint(word: str, back: str, seconds: float) -> Callable[[Loop], None]:
    """Have the joint or its controllers do something at speed, and stop it after a while."""
    def inject(loop: Loop) -> None:
        loop.until(lambda: abs(loop.heard['state'][-1][1][3]) > 1.0, 10.0)
        loop.began = time.monotonic()
        loop.do(word)
        time.sleep(seconds)
        loop.do(back)
        time.sleep(0.5)
    return inject


def another_joint_state_publisher(loop: Loop) -> None:
    """Have a second publisher say that the joint is at 0."""
    publisher = loop.node.create_publisher(JointState, '/joint_states', 10)
    loop.began = time.monotonic()
    end = loop.began + 3.0
    while time.monotonic() < end:
        message = JointState(name=['joint1'], position=[0.0])
        message.header.stamp = loop.node.get_clock().now().to_msg()
        publisher.publish(message)
        time.sleep(0.1)
    loop.node.destroy_publisher(publisher)
    time.sleep(loop.configuration.driver_parameters.patience + 1.0)


def two_numbers(loop: Loop) -> None:
    """Command the controller of one joint with an array of two; activate it again."""
    publisher = loop.node.create_publisher(Float64MultiArray, '/effort_controller/commands', 10)
    loop.until(lambda: publisher.get_subscription_count() > 0, 5.0)
    loop.began = time.monotonic()
    publisher.publish(Float64MultiArray(data=[1.0, 1.0]))
    time.sleep(1.0)
    loop.node.destroy_publisher(publisher)
    loop.do('activate')
    time.sleep(0.5)


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
      for kind in ('nan', 'inf', 'truncated', 'mislabelled', 'out-of-range')),
    Case('references of a later time', RIDE, early_references),
    Case('events of 100 000 levels, terms of 20 000 names', RIDE, hostile_text),
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
    Case("recorder's disk full for 5 s", RIDE, freed_disk),
    Case("recorder's run removed", RIDE, removed_run),
    Case("recorder's run moved", RIDE, moved_run),
    Case('SIGSTOP recorder_node 5000 ms', RIDE, stopped_recorder),
    Case('kill -9 recorder_node, restart', RIDE, kill_recorder),
    Case('e-stop at full speed', LATCH, press),
    *(Case(f'e-stop released at once, {kind} publisher', LATCH, touch(kind))
      for kind in ('default', 'sensor data', 'latched')),
    Case('e-stop released at once, beside 5000 releases a second', LATCH,
         touch('default', 'flood')),
    *(Case(f'e-stop released at once, {name} frozen for 0.5 s', LATCH, touch('default', name))
      for name in ('plant_node', 'controller_node')),
    Case('e-stop by a process that ends', LATCH, press_and_end),
    *(Case(f'serial: {words}', LATCH, device_fault, device=device) for words, device in (
        ('one state repeated for 4 s', ('repeat', '4')),
        ('old states replayed for 4 s', ('replay', '4')),
        ('host to device cut for 3 s', ('deaf', '3')),
        ('device to host cut for 3 s', ('mute', '3')),
        ('bad contact for 3 s', ('intermittent', '3')),
        ('echo of a command never sent', ('unsent', '1')),
        ('reports another mode', ('mode', '1')),
        ('another device at the port for 3 s', ('swap', '3')),
        ('device restarts', ('restart', '0')))),
    Case('serial: each state twice for 4 s', RIDE, device_fault, device=('double', '4')),
    *(Case(f'cia402: {name}', LATCH, inject, drive=True) for name, inject in (
        ('another master stops it (NMT)', drive.nmt(0x02)),
        ('another master takes it to pre-operational', drive.nmt(0x80)),
        ('another master resets it', drive.nmt(0x81)),
        ('it goes to pre-operational by itself', drive.fault('pre-operational')),
        ('it goes into another mode', drive.fault('mode', 8)),
        ('its answers stand still for 4 s', drive.fault('frozen', duration=4.0)),
        ('it is off the bus for 3 s', drive.fault('bus-off', duration=3.0)),
        ('it obeys no controlword for 2 s', drive.fault('local', duration=2.0)),
        ('kill -9 actuator_node, restart', drive.kill_host))),
    Case('joint: controller deactivated 1 s', LATCH, joint('deactivate', 'activate', 1.0),
         joint=True, coasts=True),
    Case('joint: values frozen, stamps running, 2 s', LATCH, joint('stuck', 'moving', 2.0),
         joint=True, coasts=True),
    Case('joint: position nan 1 s', LATCH, joint('nan', 'number', 1.0), joint=True),
    Case('joint: a second publisher of its state', LATCH, another_joint_state_publisher,
         joint=True),
    Case('joint: an array of two numbers', LATCH, two_numbers, joint=True, coasts=True),
)
