"""A real loop of processes, and everything that is heard of it, for injecting faults."""

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

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool, Float64MultiArray, MultiArrayDimension, String
from std_srvs.srv import Trigger

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Command, State

ROOT = Path(__file__).resolve().parents[2]
NODES = ('plant_node', 'controller_node', 'trajectory_node')
PATIENCE = 40.0
FAKETIME = Path('/usr/lib') / f'{os.uname().machine}-linux-gnu/faketime/libfaketimeMT.so.1'
"""Of Debian's package faketime."""
Row = tuple[float, ...]


class Loop:
    """Processes of a loop and a node that listens to them; a context manager that ends them.

    Attributes:
        heard: Topic → (time of arrival [s], numbers) of each message.
        modes: Node → (time [s], mode, reason), in order.
        clock: File that shifts the wall clock of the nodes, if they see one of their own.
    """

    def __init__(self, configuration: Configuration, parameters: Path,
                 prefix: dict[str, Sequence[str]] | None = None,
                 remap: dict[str, Sequence[str]] | None = None, clock: bool = False) -> None:
        self.configuration = configuration
        self.period = configuration.loop.period
        self.heard: dict[str, list[tuple[float, Row]]] = {
            topic: [] for topic in ('state', 'command', 'truth')}
        self.modes: dict[str, list[tuple[float, str, str]]] = {name: [] for name in NODES}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._parameters = parameters
        self._environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
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
            self.node.create_subscription(Float64MultiArray, name, self._keeper(kept), 1000)
        latched = QoSProfile(depth=200, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(String, 'events', self._event, latched)
        self.estop = self.node.create_publisher(Bool, 'estop', QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._going = True
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def __enter__(self) -> Loop:
        for name in NODES:
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
        command = [*self._prefix.get(name, ()), sys.executable, '-m', 'dz_ros.nodes.main', name,
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
            time.sleep(0.02)
        return done()

    def running(self) -> bool:
        """Whether both ends let the law's command through."""
        return self.mode('plant_node') == self.mode('controller_node') == 'running'

    def pass_time(self, seconds: float) -> None:
        """Let loop time go on; give up where the plant has ended."""
        end = self.now() + seconds
        self.until(lambda: self.now() >= end or self.processes['plant_node'].poll() is not None,
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
        """Reset the actuator's end, then the controller's; return what refused."""
        refused = ''
        for name in NODES[:2]:
            client = self.node.create_client(Trigger, f'{name}/reset')
            if not client.wait_for_service(PATIENCE):
                return f'{name} has no reset service'
            future = client.call_async(Trigger.Request())
            if self.until(future.done) and not future.result().success:
                answer = future.result().message
                refused = refused if answer == 'nothing is latched' else f'{name}: {answer}'
            self.node.destroy_client(client)
        return refused

    def send(self, topic: str, numbers: Sequence[float], labels: Sequence[str] | None = None
             ) -> None:
        """Publish a message of one's own making on a topic of the loop."""
        if not hasattr(self, '_senders'):
            self._senders = {name: self.node.create_publisher(Float64MultiArray, name, 10)
                             for name in ('command', 'state')}
            self.until(lambda: all(item.get_subscription_count() > 1
                                   for item in self._senders.values()), 5.0)
        labels = labels or (Command.labels() if topic == 'command' else State.labels(
            self.configuration.plant.order))
        message = Float64MultiArray(data=[float(item) for item in numbers])
        message.layout.dim.append(MultiArrayDimension(label=','.join(labels), size=len(numbers),
                                                      stride=len(numbers)))
        self._senders[topic].publish(message)

    def _keeper(self, kept: list[tuple[float, Row]]) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            row = tuple(message.data)
            if len(row) > 3 and all(map(math.isfinite, row)) and row[0] < 1e6:
                kept.append((time.monotonic(), row))
        return keep

    def _event(self, message: Any) -> None:
        event = json.loads(message.data)
        name = event['node'].rpartition('/')[2]
        if event['event'] == 'mode' and name in self.modes:
            self.modes[name].append((time.monotonic(), event['mode'], event['reason']))
        if event['event'] == 'configuration' and name in self.modes and event.get('seq') == 0:
            self.modes[name].append((time.monotonic(), 'waiting', ''))

    def _spin(self) -> None:
        while self._going:
            self._executor.spin_once(timeout_sec=0.05)
