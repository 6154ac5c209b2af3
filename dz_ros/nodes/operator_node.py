"""What the command line asks of a running loop: watch it, stop it, reset it.

Writes JSON lines on standard output for ``dz status``, ``dz estop`` and ``dz reset``, so that all
three work where the ``ros2`` command, which can do the same, is not installed. ``listen`` says
when the e-stop is pressed, for what drives a device without a loop.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.nodes.guarded import LATCHED
from dz_ros.nodes.topics import STANDS_FOR

ENDS = ('plant_node', 'controller_node')
"""Nodes with a reset service, the one at the actuator first: the law must not start before the
actuator listens. Where another node stands for one of them, it is that one."""
TASKS = ('status', 'estop', 'reset', 'listen')


class OperatorNode(Node):
    """Does one task: `status` or `listen` until told to end, `estop` or `reset` once.

    Attributes:
        stopping: True once a signal asked the node to end.
    """

    def __init__(self) -> None:
        super().__init__('dz_operator', start_parameter_services=False)
        self.stopping = False
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

        def given(name: str, default: Any, description: str) -> Any:
            return self.declare_parameter(name, default, ParameterDescriptor(
                read_only=True, description=description)).value

        self._task = given('task', 'status', ' or '.join((', '.join(TASKS[:-1]), TASKS[-1])))
        self._patience = given('patience', 5.0, 'how long to wait for the loop [s]')
        self._nodes = [name for name in given('nodes', list(ENDS), 'nodes to stop or reset')
                       if name]
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
        if self._task == 'listen':
            self.create_subscription(Bool, 'estop', self._on_estop, LATCHED)
            self._write({'listening': True})
            while not self.stopping:
                self._executor.spin_once(timeout_sec=0.1)
            return
        estop = self.create_publisher(Bool, 'estop', LATCHED)
        estop.publish(Bool(data=self._task == 'estop'))
        refused = self._call()
        # A fault needs both ends: what the first round has reset may let the other one be reset.
        if self._task == 'reset' and refused:
            refused = self._call()
        if refused:
            raise LoopError('; '.join(f'{name}: {why}' for name, why in refused.items()))

    def close(self) -> None:
        """Release everything."""
        self._executor.remove_node(self)
        self.destroy_node()

    def _call(self) -> dict[str, str]:
        """Call the service of each node in order; return which refused, and why."""
        refused = {}
        for name in self._nodes:
            client, name = self._find(name)
            future = client.call_async(Trigger.Request())
            self._executor.spin_until_future_complete(future, self._patience)
            if not future.done():
                raise LoopError(f'{client.srv_name} does not answer within {self._patience:g} s')
            answer = future.result()
            self.destroy_client(client)
            if not answer.success and answer.message != 'nothing is latched':
                refused[name] = answer.message
            self._write({'node': name, 'done': answer.success, 'message': answer.message})
        return refused

    def _find(self, name: str) -> tuple[Any, str]:
        """Return the client of a node's service, or of one that stands for it, and its name.

        Raises:
            LoopError: There is none.
        """
        names = (name, *(other for other, place in STANDS_FOR.items() if place == name))
        clients = [self.create_client(Trigger, f'{item}/{self._task}') for item in names]
        give_up = time.monotonic() + self._patience
        found = None
        while found is None and time.monotonic() < give_up and not self.stopping:
            self._executor.spin_once(timeout_sec=0.02)
            found = next((index for index, client in enumerate(clients)
                          if client.service_is_ready()), None)
        for index, client in enumerate(clients):
            if index != (found or 0):
                self.destroy_client(client)
        if found is None:
            raise LoopError(f'no {clients[0].srv_name} within {self._patience:g} s: is the loop '
                            'running in this ROS_DOMAIN_ID and namespace?')
        return clients[found], names[found]

    def _on_estop(self, message: Any) -> None:
        self._write({'pressed': bool(message.data)})

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self._write({'node': status.name, 'level': status.level[0],
                         'message': status.message, 'hardware': status.hardware_id,
                         'values': {item.key: item.value for item in status.values},
                         'heard': time.time()})

    def _write(self, line: dict[str, Any]) -> None:
        """Write a line; end where nobody reads it any more."""
        try:
            sys.stdout.write(json.dumps(line) + '\n')
            sys.stdout.flush()
        except BrokenPipeError:
            self.stopping = True
