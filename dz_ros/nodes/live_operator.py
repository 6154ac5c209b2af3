"""What viewers of the live page may do to a loop, by the services everybody else uses.

Nothing here reaches the loop by a way of its own: e-stop by the topic, reset, life cycle and
parameters by the nodes' services. Each action is an event as well, so it is in the recording, with
who asked, what came of it, and the seq of the newest state when that was known: of an e-stop when
it was pressed, of anything else when the services had answered.

An e-stop, from this page or elsewhere, cancels every action that was accepted before it.
"""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.live.describe import checked, KICK
from dz_ros.live.requests import finite
from dz_ros.nodes.guarded import LATCHED

PATIENCE = 5.0
"""Longest wait for a service [s]."""
LEAD = 0.1
"""A kick begins so long after it was asked for, so that the plant has heard of it [s]."""
LONGEST_KICK = 10.0
"""[s]"""
TRANSITIONS = {'activate': 3, 'deactivate': 4}
"""Numbers of lifecycle_msgs/Transition."""
NOTHING = 'nothing is latched'
_TYPES = {'float': Parameter.Type.DOUBLE, 'int': Parameter.Type.INTEGER,
          'bool': Parameter.Type.BOOL, 'str': Parameter.Type.STRING,
          'floats': Parameter.Type.DOUBLE_ARRAY, 'strings': Parameter.Type.STRING_ARRAY}


class LiveOperator:
    """Stops, resets, steers and tunes a loop.

    Args:
        node: Calls the services.
        loop: What is known of the loop.
        executor: Serves the node.

    Attributes:
        pressed: Whether the e-stop is pressed, here or elsewhere, as far as heard.
        calling: Whether a service is being called.
        stops: E-stops so far, from here and elsewhere.
    """

    def __init__(self, node: Any, loop: Any, executor: Any) -> None:
        self.pressed = False
        self.calling = False
        self.stops = 0
        self._mine = False
        self._pressed_ns = 0        # since the epoch: a press not later than this is its own
        self._node = node
        self._loop = loop
        self._executor = executor
        self._namespace = node.get_namespace().rstrip('/')
        self._estop = node.create_publisher(Bool, 'estop', LATCHED)
        node.create_subscription(Bool, 'estop', self._on_estop, LATCHED)

    def spin(self) -> None:
        """Serve what has come."""
        for _ in range(4):
            self._executor.spin_once(timeout_sec=0.0)

    def estop(self, who: str) -> dict[str, Any]:
        """Press the e-stop."""
        self.stops += 1
        self._estop.publish(Bool(data=True))
        self._pressed_ns = time.time_ns()
        self._mine = self.pressed = True
        self._loop.look(time.monotonic())
        self._tell('estop', who, True, '')
        return {'message': 'e-stop pressed; both ends stay at the safe command until reset',
                'seq': self._loop.seq}

    async def act(self, who: str, request: dict[str, Any], stops: int) -> dict[str, Any]:
        """Do anything else, unless an e-stop has come since there had been so many.

        Raises:
            DzRosError: It is refused, by whom and why, or cancelled.
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
            elif what == 'kick':
                details = {'values': self._kick(request)}
                message = await self._set(details['values'], stops)
            else:
                values = request.get('values')
                details = {'values': values if isinstance(values, dict) else {}}
                message = await self._set(values, stops)
        except (ConfigurationError, LoopError) as error:
            self._tell(what, who, False, str(error), **details)
            raise
        self._tell(what, who, True, message, **details)
        return {'message': message}

    def _tell(self, what: str, who: str, done: bool, message: str, **details: Any) -> None:
        """Publish an action as an event."""
        self._node.event('action', action=what, by=who, done=done, message=message,
                         seq=self._loop.seq, **details)

    def _on_estop(self, message: Any, info: Any) -> None:
        """Hear the e-stop; a release elsewhere releases this page's as well."""
        self.pressed = bool(message.data)
        if self.pressed and info['source_timestamp'] > self._pressed_ns:
            self.stops += 1
        if self._mine and not self.pressed:
            self._mine = False
            self._estop.publish(Bool(data=False))

    async def _reset(self, stops: int) -> str:
        """Release e-stop and faults, the actuator's end first; what refuses is asked twice."""
        self._mine = self.pressed = False
        self._estop.publish(Bool(data=False))
        nodes = self._serving('reset', 'std_srvs/srv/Trigger')
        controller = self._loop.owners.get('controller')
        nodes.sort(key=lambda name: name == controller)
        if not nodes:
            raise LoopError('no node of this loop can be reset: is it running?')
        refused: dict[str, str] = {}
        for _ in range(2):      # what the first round has reset may let the other end be reset
            refused = {}
            for name in nodes:
                answer = await self._call(Trigger, f'{name}/reset', Trigger.Request(), stops)
                if not answer.success and answer.message != NOTHING:
                    refused[name] = answer.message
            if not refused:
                return 'reset'
        raise LoopError('; '.join(f'{name}: {why}' for name, why in refused.items()))

    async def _change(self, what: str, wanted: Any, stops: int) -> str:
        """Activate or deactivate one node, or all in the order that keeps the actuator safe."""
        nodes = self._serving('change_state', 'lifecycle_msgs/srv/ChangeState')
        plant = self._loop.owners.get('loop')
        # The actuator's end hears the controller end and stays ready; it is the first to start.
        nodes.sort(key=lambda name: name == plant)
        if what == 'activate':
            nodes.reverse()
        if wanted is not None:
            nodes = [name for name in nodes if name == f'{self._namespace}/{wanted}']
        if not nodes:
            raise LoopError(f'no node {wanted if wanted is not None else ""} of this loop has a '
                            'life cycle: is it running?')
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
            raise LoopError('the loop has not said what it runs')
        section, found = checked(c, values)
        owner = self._loop.owners.get(section, f'{self._namespace}/{section}_node')
        request = SetParametersAtomically.Request(parameters=[
            Parameter(key, _TYPES[kind], list(value) if isinstance(value, tuple) else value)
            .to_parameter_msg() for key, (kind, value) in found.items()])
        answer = await self._call(SetParametersAtomically,
                                  f'{owner}/set_parameters_atomically', request,
                                  stops)
        if not answer.result.successful:
            raise LoopError(answer.result.reason or f'{owner} refuses')
        return f'{owner.rpartition("/")[2]} has taken {", ".join(found)}'

    def _kick(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return the parameter that pushes the plant in a moment.

        Raises:
            ConfigurationError: Not a push.
            LoopError: The loop's clock is not the wall's, or stands still.
        """
        c = self._loop.configuration
        numbers = []
        for name, largest in (('acceleration', math.inf), ('duration', LONGEST_KICK)):
            value = finite(request.get(name))
            if value is None or abs(value) > largest or (name == 'duration' and value <= 0.0):
                allowed = 'a number' if name == 'acceleration' else (
                    f'> 0 and <= {LONGEST_KICK:g} s')
                raise ConfigurationError(f'kick {name}', request.get(name),
                                         f'must be {allowed}')
            numbers.append(value)
        if c is None or c.loop.timing != 'realtime':
            raise LoopError('a kick needs a loop in real time')
        since = time.monotonic() - self._loop.heard
        if since > 1.0:
            raise LoopError('the loop stands still: nothing to kick')
        sample = math.ceil((self._loop.stamp + since + LEAD) * c.loop.rate)
        return {KICK: [sample / c.loop.rate, *numbers]}

    def _serving(self, service: str, kind: str) -> list[str]:
        """Return the nodes of the loop's namespace that have a service."""
        found = []
        for name, kinds in self._node.get_service_names_and_types():
            node, _, last = name.rpartition('/')
            if last == service and kind in kinds and node.rpartition('/')[0] == self._namespace:
                found.append(node)
        return sorted(found)

    async def _call(self, kind: Any, name: str, request: Any, stops: int) -> Any:
        """Return a service's answer, serving everything else meanwhile.

        Raises:
            LoopError: It is not there, does not answer, or an e-stop has come.
        """
        client = self._node.create_client(kind, name)
        until = time.monotonic() + PATIENCE
        self.calling = True
        try:
            while not client.service_is_ready():
                if time.monotonic() > until:
                    raise LoopError(f'no {name} within {PATIENCE:g} s')
                await asyncio.sleep(0.01)
                self._loop.still(stops)
            self._loop.still(stops)
            future = client.call_async(request)
            while not future.done():
                if time.monotonic() > until:
                    raise LoopError(f'{name} does not answer within {PATIENCE:g} s')
                self.spin()
                await asyncio.sleep(0.004)
            self._loop.still(stops)
            return future.result()
        finally:
            self.calling = False
            self._node.destroy_client(client)
