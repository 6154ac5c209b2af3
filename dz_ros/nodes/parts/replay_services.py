# SPDX-License-Identifier: Apache-2.0
"""Services that control a replay while it plays: rosbag2's names, with standard messages.

rosbag2's player has services of types that only rosbag2 brings. Those without arguments are
``std_srvs/Trigger`` here, which answer `success` and, as `message`, where the player is; the
others are a topic or a parameter (the table: docs/replay.md).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, UInt64
from std_srvs.srv import Trigger

from dz_ros.errors import ConfigurationError
from dz_ros.recording.messages import Message
from dz_ros.recording.player import Player

_MAX_OFFSET = 1e10
"""Offsets beyond this are no seconds of a recording [s]."""


class ReplayServices:
    """Services, topics and the parameter `rate` of a node that plays.

    Args:
        node: The node, with `stopping`; the parameter is declared.
        player: What it plays.
        publish: Publishes a message of it.
    """

    def __init__(self, node: Any, player: Player, publish: Callable[[Message], None]) -> None:
        self._node = node
        self._player = player
        self._publish = publish
        services: dict[str, Callable[[], bool]] = {
            'pause': self._pause, 'resume': self._resume, 'toggle_paused': self._toggle,
            'is_paused': lambda: player.paused, 'play_next': self._play_next, 'stop': self._stop}
        for name, action in services.items():
            node.create_service(Trigger, f'~/{name}', self._answer(action))
        node.create_subscription(Time, '~/seek', lambda message: self._seek(
            message.sec * 1_000_000_000 + message.nanosec), 10)
        node.create_subscription(Float64, '~/seek_offset', self._on_offset, 10)
        node.create_subscription(UInt64, '~/burst', self._on_burst, 10)
        node.add_on_set_parameters_callback(self._on_parameters)

    def _answer(self, action: Callable[[], bool]) -> Callable[[Any, Any], Any]:
        """Return the callback of a service: result of the action, position of the player."""
        def called(_request: Any, response: Any) -> Any:
            response.success = action()
            response.message = (f'{"paused" if self._player.paused else "playing"} at '
                                f'{self._player.offset:.6f} s')
            return response
        return called

    def _pause(self) -> bool:
        self._player.pause()
        return True

    def _resume(self) -> bool:
        self._player.resume()
        return True

    def _toggle(self) -> bool:
        return self._resume() if self._player.paused else self._pause()

    def _play_next(self) -> bool:
        """Publish the next message; return False where not paused or nothing is left."""
        message = self._player.step()
        if message is not None:
            self._publish(message)
        return message is not None

    def _stop(self) -> bool:
        self._node.stopping = True
        return True

    def _on_burst(self, message: Any) -> None:
        """Publish a number of messages at once while paused; 0 = all that are left."""
        left = message.data or -1
        while left and not self._node.stopping and self._play_next():
            left -= 1

    def _on_offset(self, message: Any) -> None:
        """Seek an offset from the run's first message [s]; what is no such offset is ignored."""
        if abs(message.data) < _MAX_OFFSET:
            self._seek(self._player.first_ns + round(message.data * 1e9))

    def _seek(self, time_ns: int) -> None:
        self._player.seek(time_ns)
        self._node.get_logger().info(f'seek to {self._player.offset:.6f} s')

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Use a new rate, or refuse it."""
        for parameter in parameters:
            if parameter.name == 'rate':
                try:
                    self._player.set_rate(parameter.value)
                except (ConfigurationError, TypeError) as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)
