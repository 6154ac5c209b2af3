# SPDX-License-Identifier: Apache-2.0
"""The loop's channels for Foxglove and Lichtblick, by foxglove-sdk, as they are on the topics.

The received bytes go on unchanged, with the schema and the time they were published, so that one
layout serves this server, a foxglove_bridge and the recorded MCAP file. What the live page would
refuse (`dz_ros.live.columns.usable`, texts that are no events) is counted and not passed on. Like
the live page it subscribes BEST_EFFORT and is a process of its own; clients cannot publish.
"""

from __future__ import annotations

from collections.abc import Callable
import gc
import os
import sys
import time

from rclpy.executors import SingleThreadedExecutor

from dz_ros.errors import ConfigurationError, LoopError, MessageError, MissingDependencyError
from dz_ros.live.columns import usable
from dz_ros.nodes.live_node import NICENESS
from dz_ros.nodes.parts.live_loop import WATCH_QOS
from dz_ros.nodes.ros import topics
from dz_ros.nodes.ros.base import LoopNode, NOT_READABLE
from dz_ros.nodes.ros.polling import Store
from dz_ros.recording.axes_cdr import codec_for, decode_axes
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import CHANNELS, EVENTS

NO_SDK = "Foxglove's server needs foxglove-sdk: pip install 'dz_ros[foxglove]'"
FRAME_PERIOD = 1.0 / 30.0
"""Messages are passed on after each of these [s]."""


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

        host = self.given('foxglove_host', '127.0.0.1', 'address to serve on; any client that '
                          'reaches it sees everything, there is no token')
        port = self.given('foxglove_port', 8765, 'port; 0 = any that is free')
        if not 0 <= port < 65536:
            raise ConfigurationError('foxglove_port', port, 'must be 0 to 65535')
        self._sinks = foxglove.Context()
        try:
            self._server = foxglove.start_server(name=f'dz_ros {self.get_namespace()}', host=host,
                                                 port=port, context=self._sinks)
        except (RuntimeError, OSError, ValueError) as error:
            raise LoopError(f'{host}, port {port}: cannot be listened on ({error}): choose '
                            'another by foxglove_host, foxglove_port') from None
        for name, channel in CHANNELS.items():
            topic = self.resolve_topic_name(name)
            made = foxglove.Channel(topic, message_encoding='cdr', context=self._sinks,
                                    schema=foxglove.Schema(
                                        name=channel.type.name, encoding=channel.type.encoding,
                                        data=channel.type.definition.encode()))
            if name == EVENTS:
                self.polled.subscribe(topics.TYPES[name], name, topics.everything(name),
                                      self._event_store(made.log))
            else:
                self.polled.subscribe(topics.TYPES[name], name, WATCH_QOS,
                                      self._record_store(name, made.log))
        self._address = f'ws://{host}:{self._server.port}'

    def _event_store(self, log: Callable[..., None]) -> Store:
        """Return the function that passes events on; other texts are counted."""
        def store(payload: bytes, source_ns: int, _taken_ns: int) -> None:
            if self.parse_event(payload) is not None:
                log(payload, log_time=source_ns)

        return store

    def _record_store(self, name: str, log: Callable[..., None]) -> Store:
        """Return the function that passes a topic's records on; unusable ones are counted."""
        known: list[ArrayCodec] = []

        def store(payload: bytes, source_ns: int, _taken_ns: int) -> None:
            if not (known and known[0].matches(payload)):
                try:
                    axes, labels, _ = decode_axes(payload)
                    problem, detail = usable(labels), ''
                except MessageError as error:
                    problem, detail = error.cause or NOT_READABLE, str(error)
                if problem:
                    self.refuse(name, problem, detail)
                    return
                known[:] = [codec_for(labels, axes)]
            log(payload, log_time=source_ns)

        return store

    def run(self) -> None:
        """Pass messages on until it is to end."""
        gc.enable()
        try:
            os.nice(NICENESS)
        except OSError:
            self.get_logger().info('the server runs at the priority of the loop')
        sys.stdout.write(f'foxglove: {self._address}\n')
        sys.stdout.flush()
        while not self.stopping:
            self.polled.poll(0.0)
            time.sleep(FRAME_PERIOD)
        self._server.stop()
