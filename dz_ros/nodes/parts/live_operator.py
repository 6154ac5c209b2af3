# SPDX-License-Identifier: Apache-2.0
"""Actions of viewers of the live page on a loop, by the topics and services of its nodes.

Each action is an event as well, so it is in the recording, with the address of the viewer, the
result, and the seq of the newest state at that time: of an e-stop when it was pressed, of anything
else when the services had answered. An e-stop, from this page or elsewhere, cancels every action
that was accepted before it.
"""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from dz_ros.core.axes_keys import axis_key, is_machines
from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.live.describe import checked, PULSE
from dz_ros.live.requests import finite
from dz_ros.nodes.operator_node import NOTHING
from dz_ros.nodes.ros.estop_topic import EstopTopic
from dz_ros.nodes.ros.parameters import PARAMETER_TYPES

SERVICE_TIMEOUT = 5.0
"""Longest wait for a service [s]."""
RELEASE_TIMEOUT = 1.0
"""Longest wait until all have received a release; a node that has died never will [s]."""
PULSE_LEAD = 0.1
"""A disturbance pulse begins this long after the request, so that the plant has it by then [s]."""
MAX_PULSE_DURATION = 10.0
"""[s]"""
TRANSITIONS = {'activate': 3, 'deactivate': 4}
"""Numbers of lifecycle_msgs/Transition."""


class LiveOperator:
    """Stops, resets, activates and tunes a loop.

    Args:
        node: Calls the services.
        loop: The `LiveLoop`.
        executor: Serves the node.

    Attributes:
        calling: Whether a service is being called.
        stops: E-stops so far, from here and elsewhere.
    """

    def __init__(self, node: Any, loop: Any, executor: Any) -> None:
        self.calling = False
        self.stops = 0
        self._stopped = False       # by a press that was counted
        self._repeated = False      # by an end
        self._mine = False          # pressed here, not yet by all ends confirmed
        self._node = node
        self._loop = loop
        self._executor = executor
        self._namespace = node.get_namespace().rstrip('/')
        self._estop = EstopTopic(node)
        node.unspun += self._estop.subscriptions

    @property
    def pressed(self) -> bool:
        """Whether the e-stop was pressed, here or elsewhere, and no end has been reset since."""
        commissioning = self._loop.commissioning
        return (self._stopped or bool(self._estop.held_by())
                or (commissioning is not None and commissioning.stopped))

    def spin(self) -> None:
        """Serve what has come."""
        self.receive_estop()
        for _ in range(4):
            self._executor.spin_once(timeout_sec=0.0)

    def receive_estop(self) -> None:
        """Count the presses that have come; release this page's when all ends are stopped."""
        pressers = self._estop.receive()
        # An end that is stopped repeats the e-stop: a repetition is no new one.
        if pressers and not (self._stopped and pressers <= self._estop.ends()):
            self.stops += 1
            self._stopped = True
        repeated, self._repeated = self._repeated, self._estop.held_by_an_end()
        if repeated and not self._repeated:
            self._stopped = False
        if self._mine:
            ends = self._serving('estop', 'std_srvs/srv/Trigger')
            if ends and all(self._loop.mode(name) == 'estop' for name in ends):
                self._release()

    def _release(self) -> None:
        if self._mine:
            self._mine = False
            self._estop.publish(False)

    async def _released(self, stops: int) -> None:
        """Release this page's press; wait until the ends have that, which would refuse a reset."""
        self._release()
        until, publisher = time.monotonic() + RELEASE_TIMEOUT, self._estop.publisher
        while not publisher.wait_for_all_acked(Duration()) and time.monotonic() < until:
            await asyncio.sleep(0.004)
            self.receive_estop()
            self._loop.still(stops)

    def estop(self, viewer: str) -> dict[str, Any]:
        """Press the e-stop."""
        self.stops += 1
        self._estop.publish(True)
        self._mine = self._stopped = True
        refused = ''
        if self._loop.commissioning is not None:
            try:
                self._loop.commissioning.estop()
            except LoopError as error:
                refused = f'; {error}'
        self._loop.look(time.monotonic())
        self._publish('estop', viewer, True, '')
        stays = ('the device has its safe command, no step begins until reset'
                 if self._loop.commissioning is not None and self._loop.seq < 0
                 else 'both ends stay at the safe command until reset')
        return {'message': f'e-stop pressed; {stays}{refused}', 'seq': self._loop.seq}

    async def act(self, viewer: str, request: dict[str, Any], stops: int) -> dict[str, Any]:
        """Do anything else, unless an e-stop has come since their number was `stops`.

        Raises:
            DzRosError: It is refused, by which node and why, or cancelled.
        """
        what = request['do']
        details: dict[str, Any] = {}
        try:
            self._loop.still(stops)
            if what == 'reset':
                message = await self._reset(stops)
            elif what in TRANSITIONS:
                details = {'target': str(request.get('node') or 'all')[:100]}
                message = await self._change(what, request.get('node'), stops)
            elif what == 'commission':
                details = {'target': str(request.get('step') or request.get('what'))[:100]}
                if self._loop.commissioning is None:
                    raise LoopError('nothing is commissioned here')
                message = self._loop.commissioning.ask(request, self.pressed)
            elif what == 'disturbance_pulse':
                details = {'values': self._pulse(request)}
                message = await self._set(details['values'], stops)
            else:
                values = request.get('values')
                details = {'values': values if isinstance(values, dict) else {}}
                message = await self._set(values, stops)
        except (ConfigurationError, LoopError) as error:
            self._publish(what, viewer, False, str(error), **details)
            raise
        self._publish(what, viewer, True, message, **details)
        return {'message': message}

    def _publish(self, what: str, by: str, done: bool, message: str, **details: Any) -> None:
        self._node.event('action', action=what, by=by, done=done, message=message,
                         seq=self._loop.seq, **details)

    async def _reset(self, stops: int) -> str:
        """Release e-stop and faults, the actuator's end first; ask nodes that refuse twice."""
        await self._released(stops)
        nodes = self._serving('reset', 'std_srvs/srv/Trigger')
        controller = self._loop.owners.get('controller')
        nodes.sort(key=lambda name: name == controller)
        if not nodes and self._loop.commissioning is None:
            raise LoopError('no node of this loop can be reset: is it running?')
        refused: dict[str, str] = {}
        for _ in range(2):      # what the first round has reset may let the other end be reset
            refused = {}
            for name in nodes:
                try:
                    answer = await self._call(Trigger, f'{name}/reset', Trigger.Request(), stops)
                except LoopError:
                    if self.stops != stops:     # the node may have been reset after this press
                        self._estop.publish(True)
                        self._mine = self._stopped = True
                    raise
                if not answer.success and answer.message != NOTHING:
                    refused[name] = answer.message
            if not refused:
                self._stopped = False
                if self._loop.commissioning is not None:
                    self._loop.commissioning.stopped = False
                return 'reset'
        raise LoopError('; '.join(f'{name}: {why}' for name, why in refused.items()))

    async def _change(self, what: str, wanted: Any, stops: int) -> str:
        """Activate or deactivate one node, or all in the order that keeps the actuator safe."""
        nodes = self._serving('change_state', 'lifecycle_msgs/srv/ChangeState')
        plant = self._loop.owners.get('loop')
        # The actuator's end is to receive that the controller ends; it is the first to start.
        nodes.sort(key=lambda name: name == plant)
        if what == 'activate':
            nodes.reverse()
        if wanted is not None:
            nodes = [name for name in nodes if name == f'{self._namespace}/{wanted}']
        if not nodes:
            raise LoopError(f'no node {wanted if wanted is not None else ""} of this loop has a '
                            'lifecycle: is it running?')
        refused = []
        for name in nodes:
            request = ChangeState.Request()
            request.transition.id = TRANSITIONS[what]
            answer = await self._call(ChangeState, f'{name}/change_state', request, stops)
            if not answer.success:
                refused.append(name.rpartition('/')[2])
        if refused and len(refused) == len(nodes):
            raise LoopError(f'{", ".join(refused)}: {what} is not possible now')
        done = f'{what}d {len(nodes) - len(refused)} of {len(nodes)} nodes'
        return f'{done}; not possible for {", ".join(refused)}' if refused else done

    async def _set(self, values: Any, stops: int) -> str:
        """Set parameters of one section, all or none, at the node that owns it."""
        c = self._loop.configuration
        if c is None:
            raise LoopError('the loop has not published what it runs')
        section, found = checked(c, values)
        axis = self._loop.axis
        owner = self._loop.owners.get(section, f'{self._namespace}/{section}_node')
        request = SetParametersAtomically.Request(parameters=[
            Parameter(axis_key(axis, key) if axis and not is_machines(key) else key,
                      PARAMETER_TYPES[kind],
                      list(value) if isinstance(value, tuple) else value).to_parameter_msg()
            for key, (kind, value) in found.items()])
        answer = await self._call(SetParametersAtomically,
                                  f'{owner}/set_parameters_atomically', request,
                                  stops)
        if not answer.result.successful:
            raise LoopError(answer.result.reason or f'{owner} refuses')
        return f'{owner.rpartition("/")[2]} has taken {", ".join(found)}'

    def _pulse(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return the parameter of a disturbance pulse that begins in a moment."""
        c = self._loop.configuration
        numbers = []
        for name, largest in (('acceleration', math.inf), ('duration', MAX_PULSE_DURATION)):
            value = finite(request.get(name))
            if value is None or abs(value) > largest or (name == 'duration' and value <= 0.0):
                allowed = 'a number' if name == 'acceleration' else (
                    f'> 0 and <= {MAX_PULSE_DURATION:g} s')
                raise ConfigurationError(f'pulse {name}', request.get(name),
                                         f'must be {allowed}')
            numbers.append(value)
        if c is None or c.loop.timing != 'realtime':
            raise LoopError('a pulse needs a loop in real time')
        since = time.monotonic() - self._loop.received
        if since > 1.0:
            raise LoopError('the loop stands still: nothing to disturb')
        sample = math.ceil((self._loop.stamp + since + PULSE_LEAD) * c.loop.rate)
        return {PULSE: [sample / c.loop.rate, *numbers]}

    def _serving(self, service: str, kind: str) -> list[str]:
        """Return the nodes of the loop that have a service."""
        there = {name for name, kinds in self._node.get_service_names_and_types() if kind in kinds}
        found = {node for node, _, last in (name.rpartition('/') for name in there)
                 if last == service and node.rpartition('/')[0] == self._namespace}
        # Services or nodes that were given other names: by this node's own rules.
        found.update(node for node in self._loop.owners.values()
                     if self._node.resolve_service_name(f'{node}/{service}') in there)
        return sorted(found)

    async def _call(self, kind: Any, name: str, request: Any, stops: int) -> Any:
        """Return a service's answer, serving everything else meanwhile."""
        client = self._node.create_client(kind, name)
        until = time.monotonic() + SERVICE_TIMEOUT
        self.calling = True
        try:
            while not client.service_is_ready():
                if time.monotonic() > until:
                    raise LoopError(f'no {name} within {SERVICE_TIMEOUT:g} s')
                await asyncio.sleep(0.01)
                self.receive_estop()
                self._loop.still(stops)
            self._loop.still(stops)
            future = client.call_async(request)
            while not future.done():
                if time.monotonic() > until:
                    raise LoopError(f'{name} does not answer within {SERVICE_TIMEOUT:g} s')
                self.spin()
                await asyncio.sleep(0.004)
            self._loop.still(stops)
            return future.result()
        finally:
            self.calling = False
            self._node.destroy_client(client)
