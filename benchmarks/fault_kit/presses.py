# SPDX-License-Identifier: Apache-2.0
"""Presses of the e-stop: publishers of every kind, beside stalls, transitions and floods."""

from __future__ import annotations

from dataclasses import dataclass
import os
import random
import signal
import subprocess
import sys
import time
from typing import Any

from fault_kit.loop import Loop, ROOT
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

ENDS = ('plant_node', 'controller_node')
QOS = {
    'default': QoSProfile(depth=10),        # of `ros2 topic pub` and of most nodes
    'sensor data': QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT),
    'latched': QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    'keep all': QoSProfile(history=HistoryPolicy.KEEP_ALL)}
FORGETS = ('sensor data', 'latched')
"""Those that do not keep a press behind its release: what the transport drops is gone."""
AFTER = ('its release', "another's release", 'both', 'a burst of releases', 'repeated presses')
"""What follows the press on the topic."""
BESIDE = ('nothing', 'plant_node stops', 'controller_node stops', 'both stop', 'a transition')
"""What happens meanwhile."""
SHARES = (4, 2, 2, 1, 1)
BURST = 400
TIME_OUT = 30.0
"""A press that has not stopped an end by then was missed [s]; a slow machine needs far less."""
INTRODUCTION = 180.0
"""Longest wait until both ends have received something of each publisher [s]."""
TRANSITIONS = {'deactivate': 4, 'activate': 3}
ONCE = """
import rclpy, sys, time
from std_msgs.msg import Bool
rclpy.init()
node = rclpy.create_node('button_once')
publisher = node.create_publisher(Bool, 'estop', 10)
while publisher.get_subscription_count() < 1:
    time.sleep(0.01)
print(time.monotonic())
publisher.publish(Bool(data=True))
time.sleep(0.1)
rclpy.shutdown()
"""
"""`ros2 topic pub --once`: it presses as soon as one subscription is there, and ends."""
FLOOD = """
import os
import time
import rclpy
from std_msgs.msg import Bool
rclpy.init()
node = rclpy.create_node('flood')
publisher = node.create_publisher(Bool, 'estop', 10)
due = time.monotonic()
while os.getppid() != 1:
    for _ in range(10):
        publisher.publish(Bool(data=False))
    due = max(due + 0.002, time.monotonic() - 0.1)
    time.sleep(max(due - time.monotonic(), 0.0))
"""
"""5000 releases a second."""


@dataclass
class Press:
    """One press and what came of it.

    Attributes:
        publisher: Kind of publisher.
        after: What followed on the topic.
        beside: What happened meanwhile.
        length: Time to the release [s].
        delays: End → time until it published that it is stopped [s]; not there = missed.
        error: What went wrong besides.
    """

    publisher: str
    after: str
    beside: str
    length: float
    delays: dict[str, float]
    error: str = ''


class Presser:
    """Presses the e-stop of a loop again and again.

    Args:
        loop: The loop.
        seed: Of everything random.

    Attributes:
        late: Times that an earlier press stopped the loop once more after its reset: what was lost
            of it had been repeated. The next press is made when the loop runs again.
    """

    def __init__(self, loop: Loop, seed: int) -> None:
        self._loop = loop
        self._random = random.Random(seed)
        self._began = 0.0
        self.late = 0
        self._buttons = [(kind, loop.node.create_publisher(Bool, 'estop', qos))
                         for kind, qos in QOS.items() for _ in range(2)]
        self._reset = {name: loop.node.create_client(Trigger, f'{name}/reset') for name in ENDS}
        self._change = {name: loop.node.create_client(ChangeState, f'{name}/change_state')
                        for name in ENDS}
        for client in (*self._reset.values(), *self._change.values()):
            if not client.wait_for_service(TIME_OUT):
                raise RuntimeError(f'no {client.srv_name}')
        # Each end has a subscription that is for this kind of publisher alone.
        if not loop.until(lambda: all(button.get_subscription_count() >= 2
                                      for _, button in self._buttons)):
            raise RuntimeError('the ends do not subscribe to the e-stop')
        for _, button in self._buttons:
            self._introduce(button)

    def history(self) -> dict[str, list[tuple[float, str, str]]]:
        """Return the newest modes of the ends: time from the last press on [s], mode, reason."""
        return {name: [(round(when - self._began, 4), mode, reason)
                       for when, mode, reason in self._loop.modes[name][-6:]] for name in ENDS}

    def _introduce(self, button: Any) -> None:
        """Press until both ends know the publisher: it knows them before they know it.

        An end shows it by refusing a reset for what this publisher holds; that it is stopped
        alone may be the other end's doing.

        Raises:
            RuntimeError: One does not.
        """
        name = self._loop.node.get_fully_qualified_name()
        unknown, give_up = list(ENDS), time.monotonic() + INTRODUCTION
        while unknown:
            if time.monotonic() > give_up:
                raise RuntimeError(f'{", ".join(unknown)} receive nothing of a publisher')
            button.publish(Bool(data=True))
            unknown = [end for end in unknown if name not in self._refusal(end)]
        error = self._start_again(button)
        if error:
            raise RuntimeError(error)

    def _refusal(self, end: str) -> str:
        """Ask an end to reset; return why it refuses, '' = it does not, or gives no answer."""
        future = self._reset[end].call_async(Trigger.Request())
        self._loop.until(future.done, TIME_OUT)
        answer = future.result() if future.done() else None
        return '' if answer is None or answer.success else str(answer.message)

    def press(self, once: bool = False) -> Press:
        """Press, release, see whether both ends have stopped, start the loop again."""
        draw = self._random
        kind, button = draw.choice(self._buttons)
        other = draw.choice([item for _, item in self._buttons if item is not button])
        made = Press('process that ends' if once else kind, draw.choice(AFTER),
                     draw.choices(BESIDE, SHARES)[0], draw.choice((0.0, 0.001, 0.02, 0.2))
                     * draw.random(), {})
        if once:
            made.after, made.beside, made.length = 'its end', 'nothing', 0.0
        time.sleep(0.1 * draw.random())
        while not self._loop.running():         # an earlier press came late, repaired: it counts
            self.late += 1
            error = self._start_again(button)
            if error:
                raise RuntimeError(error)
            time.sleep(0.1 * draw.random())
        seen = {name: len(self._loop.modes[name]) for name in ENDS}
        end = self._begin(made.beside)
        self._began = began = time.monotonic()
        if once:
            done = subprocess.run([sys.executable, '-c', ONCE], cwd=ROOT, check=True,
                                  timeout=TIME_OUT, stdout=subprocess.PIPE, text=True)
            self._began = began = float(done.stdout)
        else:
            self._publish(made, button, other)
        time.sleep(draw.choice((0.0, 0.05, 0.3)) * draw.random())
        end()
        if made.publisher in FORGETS and made.beside == 'both stop':
            button.publish(Bool(data=True))     # as a button does for which nothing repeats it

        def stopped(name: str) -> float | None:
            return next((when - began for when, mode, _ in self._loop.modes[name][seen[name]:]
                         if mode == 'estop'), None)

        self._loop.until(lambda: all(stopped(name) is not None for name in ENDS), TIME_OUT)
        made.delays = {name: found for name in ENDS if (found := stopped(name)) is not None}
        made.error = self._start_again(button)
        return made

    def _publish(self, made: Press, button: Any, other: Any) -> None:
        button.publish(Bool(data=True))
        time.sleep(made.length)
        if made.after == 'repeated presses':
            for _ in range(5):
                button.publish(Bool(data=True))
                time.sleep(0.002)
        if made.after == 'a burst of releases':
            for _ in range(BURST):
                other.publish(Bool(data=False))
        if made.after in ("another's release", 'both'):
            other.publish(Bool(data=False))
        if made.after in ('its release', 'both'):
            button.publish(Bool(data=False))

    def _begin(self, beside: str) -> Any:
        """Begin what happens meanwhile; return the function that ends it."""
        if beside == 'a transition':
            name = self._random.choice(ENDS)
            futures = [self._transition(name, 'deactivate')]
            time.sleep(0.01 * self._random.random())

            def activate() -> None:
                self._loop.until(futures[0].done, TIME_OUT)
                futures.append(self._transition(name, 'activate'))
                self._loop.until(futures[1].done, TIME_OUT)
            return activate
        names = {'both stop': ENDS, 'nothing': ()}.get(beside, (beside.split()[0],))
        for name in names:
            os.kill(self._loop.processes[name].pid, signal.SIGSTOP)

        def go_on() -> None:
            for name in names:
                os.kill(self._loop.processes[name].pid, signal.SIGCONT)
        return go_on

    def _transition(self, name: str, what: str) -> Any:
        request = ChangeState.Request()
        request.transition.id = TRANSITIONS[what]
        return self._change[name].call_async(request)

    def _start_again(self, button: Any) -> str:
        """Release and reset until the loop runs; return what refused last where it does not.

        A release is sent again like a press: that of a BEST_EFFORT publisher may get lost.
        """
        refused, give_up = '', time.monotonic() + TIME_OUT
        while time.monotonic() < give_up:
            button.publish(Bool(data=False))
            for name in self._reset:
                found = self._refusal(name)
                refused = f'{name}: {found}' if found else refused
            if self._loop.until(self._loop.running, 1.0):
                return ''
        return refused or 'not running again'
