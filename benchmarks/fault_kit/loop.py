# SPDX-License-Identifier: Apache-2.0
"""A real loop of processes, and everything that is heard of it, for injecting faults.

Over 300 lines: starting, observing and ending the loop share its processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool, Float64MultiArray, MultiArrayDimension, String
from std_srvs.srv import Trigger

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Command, Reference, State
from dz_ros.core.safety.message_guards import plausible, STATE_ECHO

ROOT = Path(__file__).resolve().parents[2]
EMULATOR = ROOT / 'test' / 'nodes' / 'ros2_control_emulator.py'
PATIENCE = 40.0
NEAR, NEAR_WAIT = 0.1, 4.0
"""A reset waits until the reference is so near [rad], for at most longer than its period [s]."""
STEP = 0.2
"""By which a reference that was moved is moved back, once a second [rad]."""
FAKETIME = Path('/usr/lib') / f'{os.uname().machine}-linux-gnu/faketime/libfaketimeMT.so.1'
"""Of Debian's package faketime."""
Row = tuple[float, ...]


class Loop:
    """Processes of a loop and a node that listens to them; a context manager that ends them.

    Attributes:
        heard: Topic → (time of arrival [s], numbers) of each message.
        modes: Node → (time [s], mode, reason), in order.
        clock: File that shifts the wall clock of the nodes, if they see one of their own.
        actuator: Node that hosts the actuator.
        nodes: All of them, the actuator's first.
        drive: The simulated drive, where there is one.
        began: When the fault began, where it waited for its moment [s].
        device: File with what an emulated device has said.
        device_safe: Time from the begin of a fault of that device to its leaving RUN [s].
        wrong: What an injected fault found wrong, as text.
        pressed: When the e-stop was pressed, where it was [s].
        noted: What else is to be shown of the fault, as text.
        joint: Whether the actuator is a joint of ros2_control, which `do` tells what to do.
    """

    def __init__(self, configuration: Configuration, parameters: Path,
                 prefix: dict[str, Sequence[str]] | None = None,
                 remap: dict[str, Sequence[str]] | None = None, clock: bool = False,
                 joint: bool = False) -> None:
        self.configuration = configuration
        self.joint = joint
        self.period = configuration.loop.period
        simulated = configuration.driver_settings.name == 'simulated'
        self.actuator = 'plant_node' if simulated else 'actuator_node'
        self.nodes = (self.actuator, 'controller_node', 'trajectory_node')
        self.drive: Any = None
        self.began: float | None = None
        self.heard: dict[str, list[tuple[float, Row]]] = {
            topic: [] for topic in ('state', 'command', 'truth')}
        self.modes: dict[str, list[tuple[float, str, str]]] = {name: [] for name in self.nodes}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._parameters = parameters
        self._environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
        self.device = parameters.with_name('device')
        self.device_safe = math.nan
        self.wrong: list[str] = []
        self.pressed: float | None = None
        self.noted = ''
        self._offset = 0.0
        self.clock = parameters.with_name('clock')
        self.clock.write_text('+0')
        if clock:       # CLOCK_REALTIME alone, of these processes alone
            # The library fails the clock_nanosleep() on which CPython's time.sleep() stands.
            parameters.with_name('sitecustomize.py').write_text(
                'import select, time\ntime.sleep = lambda s: select.select((), (), (), s)\n')
            self._environment |= {
                'PYTHONPATH': f'{ROOT}:{parameters.parent}', 'LD_PRELOAD': str(FAKETIME),
                'FAKETIME_TIMESTAMP_FILE': str(self.clock), 'FAKETIME_CACHE_DURATION': '1',
                'FAKETIME_DONT_FAKE_MONOTONIC': '1'}
        self._prefix, self._remap = prefix or {}, remap or {}
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('fault_bench')
        for topic, kept in self.heard.items():
            name = 'plant_state' if topic == 'state' and remap else topic
            echo = {'state': STATE_ECHO, 'command': Command.labels().index('echo_seq')}.get(topic)
            self.node.create_subscription(Float64MultiArray, name, self._keeper(kept, echo), 1000)
        latched = QoSProfile(depth=200, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(String, 'events', self._event, latched)
        self.estop = self.node.create_publisher(Bool, 'estop', QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        if joint:
            self._do = self.node.create_publisher(String, '/emulator/do', 10)
            self.node.create_subscription(String, '/emulator/interface', self._on_interface, 1000)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._going = True
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def __enter__(self) -> Loop:
        if self.joint:
            self.run_beside('emulator', [sys.executable, str(EMULATOR), str(self._parameters),
                                         'forward', 'active=1'])
        for name in self.nodes:
            self.start(name)
        return self

    def __exit__(self, *exception: object) -> None:
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._going = False
        self._thread.join()
        self.node.destroy_node()
        rclpy.shutdown()

    def start(self, name: str, *words: str, **options: Any) -> subprocess.Popen[bytes]:
        """Start a node."""
        command = [*self._prefix.get(name, ()), sys.executable, '-m', 'dz_ros.nodes.main',
                   name,
                   '--ros-args', '--params-file', str(self._parameters), '--log-level', 'fatal',
                   *self._remap.get(name, ()), *words]
        process = subprocess.Popen(command, env=self._environment, stdin=subprocess.DEVNULL,
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                                   start_new_session=True, **options)
        self.processes[name] = process
        return process

    def run_beside(self, name: str, command: Sequence[str]) -> None:
        """Start another process that ends with the loop."""
        self.processes[name] = subprocess.Popen(
            command, env=self._environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True)

    def mode(self, name: str) -> str:
        """Return a node's present mode."""
        return self.modes[name][-1][1] if self.modes[name] else 'waiting'

    def until(self, done: Callable[[], bool], timeout: float = PATIENCE) -> bool:
        """Wait for something; return whether it came."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if done():
                return True
            time.sleep(0.005)
        return done()

    def running(self) -> bool:
        """Whether both ends let the law's command through."""
        return self.mode(self.actuator) == self.mode('controller_node') == 'running'

    def why(self) -> str:
        """Return in which mode each end is, and why, as text."""
        return '; '.join(f'{name} {mode} ({reason})' for name in self.nodes[:2]
                         for _, mode, reason in self.modes[name][-1:])

    def pass_time(self, seconds: float) -> None:
        """Let loop time go on; give up where the plant has ended."""
        end = self.now() + seconds
        self.until(lambda: self.now() >= end or self.processes[self.actuator].poll() is not None,
                   seconds * 2.0 + 10.0)

    def now(self) -> float:
        """Return the stamp of the newest state [s]."""
        return self.heard['state'][-1][1][1] if self.heard['state'] else 0.0

    def error(self, seconds: float) -> float:
        """Return max |x − x_d| over the last seconds of loop time."""
        now = self.now()
        rows = [row for _, row in self.heard['state'][-round(2 * seconds / self.period):]
                if row[1] > now - seconds]
        return max((abs(row[2] - self.configuration.trajectory(row[1])[0]) for row in rows),
                   default=math.nan)

    def meanwhile(self, since: int) -> float:
        """Return max |x − x_d| of the states heard after so many."""
        return max((abs(row[2] - self.configuration.trajectory(row[1])[0])
                    for _, row in self.heard['state'][since:]), default=math.nan)

    def largest(self, since: int) -> float:
        """Return max |x| of the states heard after so many."""
        return max((abs(row[2]) for _, row in self.heard['state'][since:]), default=math.nan)

    def held(self, row: Row) -> float:
        """Return the command an actuator of slope 1 holds, by what the plant says."""
        return row[2] - row[3]

    def reset(self) -> str:
        """Reset the actuator's end, then the controller's; return what refused.

        The controller's waits for the reference to come by: an error beyond `safety.error_limit`
        is a fault again at once.
        """
        refused = ''
        for name in self.nodes[:2]:
            client = self.node.create_client(Trigger, f'{name}/reset')
            if not client.wait_for_service(PATIENCE):
                return f'{name} has no reset service'
            if name == 'controller_node' and self.mode(name) != 'running':
                self.bring_near()
            future = client.call_async(Trigger.Request())
            if self.until(future.done) and not future.result().success:
                answer = future.result().message
                refused = refused if answer == 'nothing is latched' else f'{name}: {answer}'
            self.node.destroy_client(client)
        self.move_back()
        return refused

    def bring_near(self) -> None:
        """Wait until the reference comes by; where it never does, bring them together.

        A joint is brought back to 0; for any other device the reference is moved to where it
        is, by its offset.
        """
        if self.until(self.near, NEAR_WAIT):
            return
        x = self.heard['state'][-1][1][2]
        self.noted = f'brought together manually at {x:.1f} rad'
        if self.joint:
            self.do('home')
        else:
            self._move_reference(x)
        self.until(self.near, NEAR_WAIT)

    def move_back(self) -> None:
        """Move the reference back to where it belongs, in steps that are no fault."""
        while self._offset:
            if not self.until(self.running, 3.0):
                return
            self._move_reference(math.copysign(max(abs(self._offset) - STEP, 0.0), self._offset))
            self.pass_time(1.0)

    def _move_reference(self, offset: float) -> None:
        client = self.node.create_client(SetParameters, 'trajectory_node/set_parameters')
        if client.wait_for_service(PATIENCE):
            future = client.call_async(SetParameters.Request(parameters=[
                Parameter('trajectory.offset', value=offset).to_parameter_msg()]))
            if self.until(future.done) and future.result().results[0].successful:
                self._offset = offset
        self.node.destroy_client(client)

    def near(self) -> bool:
        """Whether the reference is near the newest position now."""
        when, row = self.heard['state'][-1]
        x_d = self.configuration.trajectory(row[1] + time.monotonic() - when)[0] + self._offset
        return abs(row[2] - x_d) < NEAR

    def do(self, word: str) -> None:
        """Tell the joint and its controllers what to do."""
        self._do.publish(String(data=word))

    def _on_interface(self, message: Any) -> None:
        """Keep what the hardware holds, as the simulated plant tells it."""
        _, held, _, instant = json.loads(message.data)
        self.heard['truth'].append((instant, (0.0, self.now(), held, 0.0)))

    def send(self, topic: str, numbers: Sequence[float], labels: Sequence[str] | None = None
             ) -> None:
        """Publish a message of one's own making on a topic of the loop."""
        if not hasattr(self, '_senders'):
            self._senders = {name: self.node.create_publisher(Float64MultiArray, name, 10)
                             for name in ('command', 'state', 'reference', 'terms')}
            self._texts = self.node.create_publisher(String, 'events', 10)
            # This node itself subscribes to all of them but the reference.
            own = {name: int(name != 'reference') for name in ('command', 'state', 'reference')}
            self.until(lambda: self._texts.get_subscription_count() > 1 and all(
                self._senders[name].get_subscription_count() > count
                for name, count in own.items()), 5.0)
        order = self.configuration.plant.order
        labels = labels or {'command': Command.labels(), 'state': State.labels(order),
                            'reference': Reference.labels(order)}[topic]
        message = Float64MultiArray(data=[float(item) for item in numbers])
        message.layout.dim.append(MultiArrayDimension(label=','.join(labels), size=len(numbers),
                                                      stride=len(numbers)))
        self._senders[topic].publish(message)

    def send_event(self, text: str) -> None:
        """Publish any text as an event."""
        self._texts.publish(String(data=text))

    def _keeper(self, kept: list[tuple[float, Row]], echo: int | None
                ) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            row = tuple(message.data)
            if len(row) > 3 and row[1] >= 0.0 and plausible(row, echo):
                kept.append((time.monotonic(), row))
        return keep

    def _event(self, message: Any) -> None:
        try:
            event = json.loads(message.data)
            name = event['node'].rpartition('/')[2]
        except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
            return      # one that a fault sends
        if event['event'] == 'mode' and name in self.modes:
            self.modes[name].append((time.monotonic(), event['mode'], event['reason']))
        if event['event'] == 'configuration' and name in self.modes and event.get('seq') == 0:
            self.modes[name].append((time.monotonic(), 'waiting', ''))

    def _spin(self) -> None:
        while self._going:
            self._executor.spin_once(timeout_sec=0.05)
