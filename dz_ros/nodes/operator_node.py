# SPDX-License-Identifier: Apache-2.0
"""Tasks of the command line on a running loop: watch it, stop it, reset it.

Writes JSON lines on standard output for ``dz status``, ``dz estop`` and ``dz reset``, so that they
work where the ``ros2`` command, which can do the same, is not installed. The task
``receive_estop`` reports presses of the e-stop, for verbs that drive a device without a loop.
"""

from __future__ import annotations

from collections.abc import Sequence
import json
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from dz_ros.core.axes import diagnostic_values, MAX_AXES
from dz_ros.core.text import LONGEST
from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.nodes.ros.base import deliver, fixed_parameter
from dz_ros.nodes.ros.estop_topic import EstopTopic, OFFERED, TOPIC
from dz_ros.nodes.ros.graph import publishers, subscribers
from dz_ros.nodes.ros.topics import PUBLISHED_BY, STANDS_FOR

ENDS = ('plant_node', 'controller_node')
"""Nodes with a reset service, the one at the actuator first: the law must not start before the
actuator subscribes. Where another node stands for one of them, it is that one."""
NOTHING = 'nothing is latched'
"""Answer of a reset service that had nothing to do."""
TASKS = ('status', 'estop', 'reset', 'receive_estop')


class OperatorNode(Node):
    """Does one task: `status` or `receive_estop` until it is to end, `estop` or `reset` once.

    Attributes:
        stopping: True once a signal asked the node to end.
    """

    def __init__(self) -> None:
        super().__init__('dz_operator', start_parameter_services=False)
        self.stopping = False
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

        self._task = fixed_parameter(self, 'task', TASKS[0], f'one of {", ".join(TASKS)}')
        self._patience = fixed_parameter(self, 'patience', 5.0, 'longest wait for the loop [s]')
        nodes = fixed_parameter(self, 'nodes', list(ENDS), 'nodes to stop or reset')
        self._nodes = [name for name in nodes if name]
        if self._task not in TASKS:
            raise ConfigurationError('task', self._task, f'must be one of {", ".join(TASKS)}')

    def run(self) -> None:
        """Do the task.

        Raises:
            LoopError: The loop is not there, or refuses.
        """
        if self._task == 'status':
            self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)
            while not self.stopping:
                self._executor.spin_once(timeout_sec=0.1)
            return
        if self._task == 'receive_estop':
            estop = EstopTopic(self)
            self._write({'subscribed': True})
            while not self.stopping:
                estop.wait(0.1)
                if estop.receive():
                    self._write({'pressed': True})
            return
        if self._task == 'estop':
            self._stop()
            return
        refused = self._call(self._nodes)
        # A fault needs both ends: what the first round has reset may let the other one be reset.
        if refused:
            refused = self._call(list(refused))
        if refused:
            raise LoopError('; '.join(f'{name}: {why}' for name, why in refused.items()))

    def close(self) -> None:
        """Release everything."""
        self._executor.remove_node(self)
        self._executor.shutdown()
        self.destroy_node()

    def _stop(self) -> None:
        """Press the e-stop on the topic and at each node; release it when all have confirmed."""
        estop = self.create_publisher(Bool, TOPIC, OFFERED)
        estop.publish(Bool(data=True))
        clients = {name: self._candidates(name) for name in self._nodes}
        calls: dict[str, tuple[str, Any]] = {}
        give_up = time.monotonic() + self._patience
        confirmed: set[str] = set()
        # All at once: an end that hangs must not keep the others from being stopped.
        while len(confirmed) < len(clients) and time.monotonic() < give_up and not self.stopping:
            for place, offered in clients.items():
                self._add_renamed(place, offered)
                ready = next((name for name in offered if offered[name].service_is_ready()), None)
                if ready is not None and place not in calls:
                    calls[place] = ready, offered[ready].call_async(Trigger.Request())
            self._executor.spin_once(timeout_sec=0.02)
            for place, (name, future) in calls.items():
                if future.done() and place not in confirmed:
                    confirmed.add(place)
                    self._write({'node': name, 'message': future.result().message})
        receivers = len(subscribers(self, TOPIC))
        if len(confirmed) == len(clients):
            estop.publish(Bool(data=False))
        deliver(estop)
        if len(confirmed) < len(clients):
            wrong = [f'{calls[place][0]}/estop does not answer' if place in calls
                     else f'no {next(iter(offered.values())).service_name}'
                     for place, offered in clients.items() if place not in confirmed]
            raise LoopError(f'{", ".join(wrong)} within {self._patience:g} s; pressed on '
                            f'{estop.topic_name}, to which {receivers} nodes subscribe')

    def _call(self, places: Sequence[str]) -> dict[str, str]:
        """Reset each node in order; return which refused, and why."""
        refused = {}
        for place in places:
            client, name = self._find(place)
            future = client.call_async(Trigger.Request())
            self._executor.spin_until_future_complete(future, self._patience)
            if not future.done():
                raise LoopError(f'{client.service_name} does not answer within '
                                f'{self._patience:g} s: it may be reset or not, see dz status')
            answer = future.result()
            self.destroy_client(client)
            if not answer.success and answer.message != NOTHING:
                refused[name] = answer.message
            else:
                self._write({'node': name, 'message': answer.message})
        return refused

    def _candidates(self, name: str) -> dict[str, Any]:
        """Return the clients of a node's service, and of those that stand for it, by name."""
        names = (name, *(other for other, place in STANDS_FOR.items() if place == name))
        return {item: self.create_client(Trigger, f'{item}/{self._task}') for item in names}

    def _add_renamed(self, name: str, clients: dict[str, Any]) -> None:
        """Add the clients of nodes in this place under names of their own."""
        for topic, place in PUBLISHED_BY.items():
            for other in publishers(self, topic) if place == name else ():
                if other not in clients:
                    clients[other] = self.create_client(Trigger, f'{other}/{self._task}')

    def _find(self, name: str) -> tuple[Any, str]:
        """Return the client of a node's service, or of one that stands for it, and its name."""
        clients = self._candidates(name)
        give_up = time.monotonic() + self._patience
        found = None
        while found is None and time.monotonic() < give_up and not self.stopping:
            self._executor.spin_once(timeout_sec=0.02)
            self._add_renamed(name, clients)
            found = next((item for item in clients if clients[item].service_is_ready()), None)
        if found is None:
            raise LoopError(f'no {clients[name].service_name} within {self._patience:g} s: is the '
                            'loop running in this ROS_DOMAIN_ID and namespace?')
        for item in clients.keys() - {found}:
            self.destroy_client(clients[item])
        return clients[found], found

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self._write({'node': status.name[:LONGEST], 'level': status.level[0],
                         'message': status.message[:LONGEST],
                         'hardware': status.hardware_id[:LONGEST],
                         'values': {item.key[:LONGEST]: item.value[:LONGEST]
                                    for item in status.values[:diagnostic_values(MAX_AXES)]},
                         'received': time.time()})

    def _write(self, line: dict[str, Any]) -> None:
        """Write a line; end where it is not read any more."""
        try:
            sys.stdout.write(json.dumps(line) + '\n')
            sys.stdout.flush()
        except BrokenPipeError:
            self.stopping = True
