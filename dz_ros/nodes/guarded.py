"""Nodes at the two ends of the loop: e-stop, reset, and word of what changed and why."""

from __future__ import annotations

from abc import abstractmethod
import json
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from dz_ros.core.safety.supervisor import Change, Supervisor
from dz_ros.core.safety.table import Mode
from dz_ros.nodes.managed import ManagedNode
from dz_ros.recording.cdr import decode_string
from dz_ros.runtime.privileges import usable_cores

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The e-stop topic: whoever comes late hears what was said last."""


class GuardedNode(ManagedNode):
    """A node that drives an actuator, or commands one.

    Attributes:
        partner: Topic whose end is an orderly stop of the other end.
    """

    partner: str
    eager = 200e-6 if len(usable_cores()) > 1 else 0.0     # who is to answer needs a core

    def __init__(self, name: str, *sections: str) -> None:
        super().__init__(name, *sections)
        self._pressed_here = False
        self._estop = self.create_publisher(Bool, 'estop', LATCHED)
        self.create_subscription(Bool, 'estop', self._on_estop, LATCHED)
        self.create_subscription(String, 'events', self._on_event, 20, raw=True)
        self.create_service(Trigger, '~/estop', self._serve_estop)
        self.create_service(Trigger, '~/reset', self._serve_reset)

    # What subclasses do.

    @property
    @abstractmethod
    def supervisor(self) -> Supervisor:
        """Life and mode of this end."""

    @abstractmethod
    def stop_now(self, pressed: bool, reason: str) -> None:
        """Hear the e-stop pressed or released."""

    @abstractmethod
    def partner_ended(self) -> None:
        """Hear that the other end stops in order."""

    @abstractmethod
    def reset(self) -> str:
        """Leave a latched mode; return why not."""

    def changed(self, change: Change) -> None:
        """Tell everybody of a change of mode."""
        self.event('mode', mode=change.mode.value, earlier=change.earlier.value,
                   cause=change.event.value, reason=change.reason)
        if change.mode in (Mode.FAULT, Mode.ESTOP):
            self.get_logger().error(f'{change.mode.value}: {change.reason}; the safe command is '
                                    f'out until {self.get_fully_qualified_name()}/reset is called')
        elif change.mode is Mode.LOST:
            self.count(f'{change.reason}: safe command')

    # Callbacks.

    def _on_estop(self, message: Any) -> None:
        self.stop_now(bool(message.data), 'e-stop by topic')

    def _on_event(self, payload: bytes) -> None:
        """Hear of orderly ends; nothing else of the events matters here."""
        if b'"ends"' not in payload:
            return
        try:
            event = json.loads(decode_string(payload))
            ended = self.partner in event['ends']
        except (ValueError, TypeError, KeyError):
            self.count('an event that cannot be read')
            return
        if ended:
            self.partner_ended()

    def _serve_estop(self, _request: Any, response: Any) -> Any:
        """Stop this end at once, and the others by the topic."""
        self._pressed_here = True
        self.stop_now(True, 'e-stop by service')
        self._estop.publish(Bool(data=True))
        response.success, response.message = True, 'stopped; leave it by the reset services'
        return response

    def _serve_reset(self, _request: Any, response: Any) -> Any:
        """Release one's own e-stop, then leave the latched mode if all is well."""
        if self._pressed_here:
            self._pressed_here = False
            self._estop.publish(Bool(data=False))
            self.stop_now(False, '')
        refused = self.reset()
        response.success, response.message = not refused, refused or 'reset'
        return response
