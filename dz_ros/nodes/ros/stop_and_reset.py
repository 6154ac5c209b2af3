# SPDX-License-Identifier: Apache-2.0
"""E-stop, reset and change of mode at an end of the loop, by topics and services."""

from __future__ import annotations

from typing import Any

from std_msgs.msg import String
from std_srvs.srv import Trigger

from dz_ros.core.events import StoppedEvent
from dz_ros.core.safety.modes import LATCHED, Mode
from dz_ros.core.safety.supervisor import Change
from dz_ros.nodes.ros.estop_topic import EstopTopic
from dz_ros.runtime.privileges import usable_cores

MAX_END_EVENT = 1 << 14
"""Longest event that an end of the loop parses [characters]; that takes less than a sample."""
EAGER = 200e-6 if len(usable_cores()) > 1 else 0.0
"""In lockstep, for how long an end polls without sleeping [s]; the one to answer needs a core."""


class EndSafety:
    """Stops and resets a node that drives an actuator, or commands one.

    Args:
        node: A `ManagedNode` with `supervisor`, `on_estop(pressed, reason)`, `on_partner_end()`
            and `reset()`, which returns why a latched mode cannot be left, '' where it was.
        partner: Topic whose end is an orderly stop of the other end.
    """

    def __init__(self, node: Any, partner: str) -> None:
        self._node = node
        self._partner = partner
        self._estop = EstopTopic(node)
        node.unspun += self._estop.subscriptions
        node.urgent = self.receive_estop
        node.eager = EAGER
        node.create_subscription(String, 'events', self._on_event, 20, raw=True)
        node.create_service(Trigger, '~/estop', self._serve_estop)
        node.create_service(Trigger, '~/reset', self._serve_reset)

    def receive_estop(self) -> None:
        """Stop at once where the e-stop was pressed since the last call."""
        self._estop.receive(self._stop)

    def _stop(self) -> None:
        """Stop this end, unless it is."""
        if self._node.supervisor.mode is not Mode.ESTOP:
            self._node.on_estop(True, 'e-stop by topic')

    def changed(self, change: Change) -> None:
        """Publish a change of mode; repeat an e-stop, which the other end may have missed."""
        node, log = self._node, self._node.get_logger()
        if Mode.ESTOP in (change.mode, change.earlier):
            self._estop.publish(change.mode is Mode.ESTOP)
        node.event('mode', mode=change.mode.value, earlier=change.earlier.value,
                   cause=change.event.value, reason=change.reason)
        if change.mode in (Mode.FAULT, Mode.ESTOP):
            log.error(f'{change.mode.value}: {change.reason}; the safe command is out until '
                      f'{node.get_fully_qualified_name()}/reset is called')
        elif change.earlier in LATCHED:
            log.info(f'reset: {change.mode.value}')
        elif change.mode is Mode.LOST:
            node.count(f'{change.reason}: safe command')

    def _on_event(self, payload: bytes) -> None:
        """Receive orderly ends; nothing else of the events matters here."""
        if b'"ends"' not in payload:
            return
        event = self._node.parse_event(payload, MAX_END_EVENT)
        if isinstance(event, StoppedEvent) and self._partner in event.ends:
            self._node.on_partner_end()

    def _serve_estop(self, _request: Any, response: Any) -> Any:
        """Stop this end at once, and the others by the topic."""
        self._node.on_estop(True, 'e-stop by service')
        response.success, response.message = True, 'stopped; leave it by the reset services'
        return response

    def _serve_reset(self, _request: Any, response: Any) -> Any:
        """Leave the latched mode if nothing presses the e-stop and all is well."""
        self.receive_estop()
        held_by = self._estop.held_by() if self._node.supervisor.latched else []
        if held_by:
            refused = (f'the e-stop is still pressed by {", ".join(held_by)}: release it there, '
                       'or end that node')
        else:
            self._node.on_estop(False, '')
            refused = self._node.reset()
        response.success, response.message = not refused, refused or 'reset'
        return response
