"""The loop's channels for Foxglove and Lichtblick, by foxglove-sdk, as they are on the topics.

The received bytes go on unchanged, with the schema and the time they were published, so that one
layout serves this server, a foxglove_bridge and the recorded MCAP file. Like the live page it
subscribes without any promise and is a process of its own; nobody can send anything through it.
"""

from __future__ import annotations

import gc
import os
import sys
import time
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import SingleThreadedExecutor

from dz_ros.errors import ConfigurationError, LoopError, MissingDependencyError
from dz_ros.nodes import topics
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.live_loop import LISTEN
from dz_ros.nodes.live_node import NICE
from dz_ros.nodes.taking import Store, Taker
from dz_ros.recording.channels import CHANNELS, EVENTS

NO_SDK = "Foxglove's server needs foxglove-sdk: pip install 'dz_ros[foxglove]'"
EVERY = 1.0 / 30.0
"""What has come is passed on after each of these [s]."""


class FoxgloveNode(LoopNode):
    """Server for Foxglove and Lichtblick.

    Raises:
        ConfigurationError: Not a port.
        MissingDependencyError: foxglove-sdk is not installed.
        LoopError: The address cannot be listened on.
    """

    def __init__(self) -> None:
        super().__init__('foxglove_node', SingleThreadedExecutor())
        try:
            import foxglove
        except ImportError:
            raise MissingDependencyError(NO_SDK) from None

        def given(name: str, default: Any, description: str) -> Any:
            return self.declare_parameter(name, default, ParameterDescriptor(
                read_only=True, description=description)).value

        host = given('foxglove_host', '127.0.0.1', 'address to listen on; whoever reaches it sees '
                     'everything, there is no token')
        port = given('foxglove_port', 8765, 'port; 0 = any that is free')
        if not 0 <= port < 65536:
            raise ConfigurationError('foxglove_port', port, 'must be 0 to 65535')
        self._sinks = foxglove.Context()
        try:
            self._server = foxglove.start_server(name=f'dz_ros {self.get_namespace()}', host=host,
                                                 port=port, context=self._sinks)
        except (RuntimeError, OSError, ValueError) as error:
            raise LoopError(f'{host}, port {port}: cannot be listened on ({error}): choose '
                            'another by foxglove_host, foxglove_port') from None
        self._taker = Taker(self)
        for name, channel in CHANNELS.items():
            topic = self.resolve_topic_name(name)
            made = foxglove.Channel(topic, message_encoding='cdr', context=self._sinks,
                                    schema=foxglove.Schema(
                                        name=channel.type.name, encoding=channel.type.encoding,
                                        data=channel.type.definition.encode()))
            self._taker.subscribe(topics.TYPES[name], topic, topics.everything(name)
                                  if name == EVENTS else LISTEN, _pass_on(made))
        self._address = f'ws://{host}:{self._server.port}'

    def run(self) -> None:
        """Pass messages on until told to end."""
        gc.enable()
        try:
            os.nice(NICE)
        except OSError:
            self.get_logger().info('the server runs at the priority of the loop')
        sys.stdout.write(f'foxglove: {self._address}\n')
        sys.stdout.flush()
        while not self.stopping:
            self._taker.take_all(0.0)
            time.sleep(EVERY)
        self._server.stop()


def _pass_on(channel: Any) -> Store:
    """Return what takes a topic's messages to a channel."""
    log = channel.log

    def store(payload: bytes, source_ns: int, _taken_ns: int) -> None:
        log(payload, log_time=source_ns)

    return store
