# SPDX-License-Identifier: Apache-2.0
"""The e-stop topic: presses are received from every publisher, however it publishes.

Three subscriptions, because no single one receives all there is: BEST_EFFORT matches every
publisher; RELIABLE has lost messages repeated, by those that can; TRANSIENT_LOCAL also receives
what a latched publisher sent before. The first keeps the newest messages and the second the oldest
that were not taken, so a press is found before and behind a burst of releases while the node is
stalled. Executors leave them alone: `receive` takes all that has come at once, so messages
without end hold up nothing, and a press waits for no other callback.

rclpy does not name the publisher of a message; the middleware does. So messages are taken
by rcl's own function where its structures are those of ROS 2 Jazzy, which is verified at each
message, and anywhere else by rclpy's, without the publisher (``core/safety/estop.py``).
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

from dz_ros.core.safety.estop import Presses
from dz_ros.nodes.ros import graph
from dz_ros.nodes.ros.polling import WaitSet

TOPIC = 'estop'
END_TOPICS = ('state', 'command')
"""Topics of which an end of a loop publishes one."""
END_SERVICES = (TOPIC, 'reset', 'change_state')
"""Services of an end of this package, by which it is known while it publishes neither."""
NAMELESS = '_NODE_NAME_UNKNOWN_'
"""What ROS calls the node of a publisher that does not belong to one: any number of them."""
MAX_TAKEN = 5000
"""Messages of one subscription that `receive` takes at once: as many as it can keep."""
OFFERED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS of this package's publishers: a subscription that comes late receives the newest message."""
REQUESTED = (
    QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT,
               durability=DurabilityPolicy.VOLATILE),
    QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE,
               durability=DurabilityPolicy.VOLATILE),
    QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE,
               durability=DurabilityPolicy.TRANSIENT_LOCAL))
"""QoS of the subscriptions."""
Message = tuple[bytes | None, int, bool]
"""Publisher, number, content."""


class _Gid(ctypes.Structure):
    """rmw_gid_t."""

    _fields_ = (('implementation', ctypes.c_void_p), ('data', ctypes.c_ubyte * 16))


class _MessageInfo(ctypes.Structure):
    """rmw_message_info_t, with room for one that is longer."""

    _fields_ = (('source_timestamp', ctypes.c_int64), ('received_timestamp', ctypes.c_int64),
                ('publication_number', ctypes.c_uint64), ('reception_number', ctypes.c_uint64),
                ('publisher', _Gid), ('spare', ctypes.c_ubyte * 128))


class _Rcl:
    """The functions of rcl that rclpy does not offer.

    Raises:
        OSError: There is no such library.
        AttributeError: It has no such function.
    """

    def __init__(self) -> None:
        library = ctypes.CDLL('librcl.so')
        pointer = ctypes.c_void_p
        implementation = library.rmw_get_implementation_identifier
        implementation.restype = pointer
        self.implementation = implementation()
        self._handle = library.rcl_publisher_get_rmw_handle
        self._handle.argtypes, self._handle.restype = (pointer,), pointer
        self._gid = library.rmw_get_gid_for_publisher
        self._gid.argtypes = (pointer, pointer)
        self.take = library.rcl_take
        self.take.argtypes = (pointer,) * 4
        self._value, self._info = ctypes.c_uint8(), _MessageInfo()
        self._where = ctypes.addressof(self._value), ctypes.addressof(self._info), None

    def taker(self, subscription: Subscription) -> Callable[[], Message | None]:
        """Return the function that takes a message of a subscription, None if there is none."""
        take, handle, where = self.take, subscription.handle.pointer, self._where
        value, info, implementation = self._value, self._info, self.implementation

        def taken() -> Message | None:
            if take(handle, *where):
                return None
            gid = info.publisher
            known = gid.implementation == implementation
            return (bytes(gid.data) if known else None, info.publication_number, value.value != 0)

        return taken

    def gid(self, publisher: Any) -> bytes | None:
        """Return the identity of a publisher of this process, None = not known."""
        found = _Gid()
        failed = self._gid(self._handle(publisher.handle.pointer), ctypes.addressof(found))
        return None if failed or found.implementation != self.implementation else bytes(found.data)


class EstopTopic:
    """Publisher and subscriptions of the e-stop of a node.

    Args:
        node: The node; its executor must not be given `subscriptions`.

    Attributes:
        subscriptions: The subscriptions, whose messages `receive` takes.
        publisher: Publishes this node's own presses and releases, which it does not receive.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._presses = Presses()
        self.publisher = node.create_publisher(Bool, TOPIC, OFFERED)
        # A subscription that does not match one publisher is not an error: another one does.
        self.subscriptions = tuple(node.create_subscription(
            Bool, TOPIC, _never, qos, event_callbacks=SubscriptionEventCallbacks(
                use_default_callbacks=False)) for qos in REQUESTED)
        try:
            rcl = _Rcl()
            self._own = rcl.gid(self.publisher)
            self._takers = [rcl.taker(item) for item in self.subscriptions]
        except (OSError, AttributeError):
            self._own = None
            self._takers = [_taker(item) for item in self.subscriptions]
        self._wait_set: WaitSet | None = None

    def publish(self, pressed: bool) -> None:
        """Press or release the e-stop as this node."""
        self.publisher.publish(Bool(data=pressed))

    def receive(self, act: Callable[[], None] | None = None) -> set[bytes | None]:
        """Take all that has come; return the publishers of a press, None = not known.

        Args:
            act: Called as soon as the first press is found: what else has come may be thousands
                of messages, which take longer than a sample.
        """
        pressed: set[bytes | None] = set()
        for take in self._takers:
            for _ in range(MAX_TAKEN):
                message = take()
                if message is None:
                    break
                own = message[0] is not None and message[0] == self._own
                if not own and self._presses.receive(*message):
                    if act is not None and not pressed:
                        act()
                    pressed.add(message[0])
        return pressed

    def wait(self, timeout: float) -> None:
        """Sleep until there is a message, or for a time [s]."""
        if self._wait_set is None:
            self._wait_set = WaitSet(self._node, self.subscriptions)
        self._wait_set.wait(timeout)

    def held_by(self) -> list[str]:
        """Return the nodes that still press it, or may; forget those that are gone.

        An end of a loop repeats the e-stop for as long as it is stopped itself. That stops others,
        but does not keep them from being reset.
        """
        if not (self._presses.holders or self._presses.unknown):
            return []
        own = self._node.get_fully_qualified_name()
        ends = self.ends()
        present = {gid: name for gid, name in self._publishers().items()
                   if gid not in ends and name != own}
        return sorted({present[item] for item in self._presses.held_by(present)})

    def ends(self) -> set[bytes]:
        """Return the publishers of the nodes that are an end of a loop.

        Services alone do not show it: a panel may offer some of them, an end under other names.
        """
        offered = {name for name, _ in self._node.get_service_names_and_types()}
        at_work = {name for topic in END_TOPICS for name in graph.publishers(self._node, topic)
                   if not name.endswith(f'/{NAMELESS}')}
        return {gid for gid, name in self._publishers().items() if name in at_work
                or offered.issuperset(f'{name}/{service}' for service in END_SERVICES)}

    def held_by_an_end(self) -> bool:
        """Return whether an end is stopped, as far as was received."""
        return bool(self._presses.holders and self._presses.holders & self.ends())

    def _publishers(self) -> dict[bytes, str]:
        """Return the publishers of the topic: identity → node."""
        return {bytes(info.endpoint_gid)[:16]:
                f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                for info in self._node.get_publishers_info_by_topic(TOPIC)}


def _taker(subscription: Subscription) -> Callable[[], Message | None]:
    """Return the function that takes a message by rclpy, which does not name the publisher."""
    def taken() -> Message | None:
        found = subscription.handle.take_message(Bool, False)
        return None if found is None else (None, 0, bool(found[0].data))

    return taken


def _never(_message: Any) -> None:
    """Do nothing: no executor calls this."""
