# SPDX-License-Identifier: Apache-2.0
"""The live page as a node: subscribes to a loop, serves it to browsers, passes requests on.

A process of its own. It subscribes without any promise (BEST_EFFORT, also in lockstep, so that no
publisher ever waits for it) and polls `FRAME_RATE` times a second, which costs far less than
being woken by each message. The loop does not know that it is there.
"""

from __future__ import annotations

import asyncio
import gc
import os
import sys
import time

from rclpy.executors import SingleThreadedExecutor

from dz_ros.core.configuration import allow_named, SECTIONS
from dz_ros.core.registry import allow_import
from dz_ros.errors import ConfigurationError
from dz_ros.live.access import Access, LOOPBACK
from dz_ros.live.server import Server
from dz_ros.nodes.parts.live_commissioning import Commissioning
from dz_ros.nodes.parts.live_loop import LiveLoop
from dz_ros.nodes.parts.live_operator import LiveOperator
from dz_ros.nodes.ros.base import LoopNode
from dz_ros.nodes.ros.parameters import overrides

FRAME_RATE = 30.0
"""Polls, and frames to each viewer, a second."""
STATUS_RATE = 5.0
"""Reports on the state of nodes a second."""
SERVICE_PERIOD = 0.1
"""Services and diagnostics are served this often [s]."""
MAX_MINUTES = 120.0
"""Most minutes kept."""
NICENESS = 5
"""Niceness of the page behind the loop on a busy machine."""


class LiveNode(LoopNode):
    """Server of the live page.

    Raises:
        ConfigurationError: A parameter that is not allowed.
        MissingDependencyError: aiohttp is not installed.
    """

    def __init__(self) -> None:
        super().__init__('live_node', SingleThreadedExecutor())

        host = self.given('host', LOOPBACK, 'address to serve on; another than the loopback '
                          'makes the page ask every viewer for the token')
        self._port = self.given('port', 0, 'port; 0 = the first free one from 8420 on')
        read_only = self.given('read_only', False, 'no viewer may act')
        minutes = self.given('minutes', 10.0, 'duration of what is kept [min]')
        allow_named(overrides(self, SECTIONS))      # parameters name modules of the user's own
        allow_import(*filter(None, self.given(
            'allow_import', [''], 'modules that may be imported where a received configuration '
            'names a class of them; to import a module is to run it')))
        if not 0 <= self._port < 65536:
            raise ConfigurationError('port', self._port, 'must be 0 to 65535')
        if not 0.0 < minutes <= MAX_MINUTES:
            raise ConfigurationError('minutes', minutes, f'must be > 0 and <= {MAX_MINUTES:g}')
        descriptor = self.given('commissioning', -1, 'socket of dz driver commission --live, '
                                'which starts this node; -1 = none')
        access = Access(host, read_only)
        self._loop = LiveLoop(self, minutes)
        if descriptor >= 0:
            self._loop.commissioning = Commissioning(descriptor)
        self._operator = LiveOperator(self, self._loop, self._executor)
        self._loop.operator = self._operator
        self._server = Server(self._loop, access)

    def run(self) -> None:
        """Serve until it is to end.

        Raises:
            LoopError: The port is taken.
        """
        gc.enable()         # unlike a node of the loop, a server makes cycles
        try:
            os.nice(NICENESS)
        except OSError:
            self.get_logger().info('the page runs at the priority of the loop')
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        address = await self._server.start(self._port)
        # Not by the logger: it would write the token into a file.
        sys.stdout.write(f'live page: {address}\n')
        sys.stdout.flush()
        try:
            await self._watch()
        finally:
            await self._server.close()

    async def _watch(self) -> None:
        """Poll, send to the viewers, serve services, at their rates."""
        due = served = reported = time.monotonic()
        while not self.stopping:
            now = time.monotonic()
            if self._loop.look(now):
                self._server.renew()
            for message in self._loop.news():
                self._server.broadcast(message)
            if now - reported >= 1.0 / STATUS_RATE:
                reported = now
                self._server.broadcast(self._loop.status(now))
            self._server.publish()
            if now - served >= SERVICE_PERIOD and not self._operator.calling:
                served = now
                self._operator.spin()
            due = max(due + 1.0 / FRAME_RATE, now)
            await asyncio.sleep(max(due - time.monotonic(), 0.001))
