"""The live page as a node: listens to a loop, serves it to browsers, passes on what they ask.

A process of its own. It subscribes without any promise (BEST_EFFORT, also in lockstep, so that no
publisher ever waits for it) and looks at what has come `FRAMES` times a second, which costs far
less than being woken by each message. The loop does not know that it is there.
"""

from __future__ import annotations

import asyncio
import gc
import os
import sys
import time

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import SingleThreadedExecutor

from dz_ros.errors import ConfigurationError
from dz_ros.live.access import Access, LOOPBACK
from dz_ros.live.server import Server
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.live_loop import LiveLoop
from dz_ros.nodes.live_operator import LiveOperator

FRAMES = 30.0
"""Looks at what has come, and frames to each viewer, a second."""
STATUS = 5.0
"""Words on the state of nodes a second."""
SERVE = 0.1
"""Services and diagnostics are served this often [s]."""
LONGEST = 120.0
"""Most minutes kept."""
NICE = 5
"""By how much the page stands back behind the loop on a busy machine."""


class LiveNode(LoopNode):
    """Server of the live page.

    Raises:
        ConfigurationError: A parameter that is not allowed.
        MissingDependencyError: aiohttp is not installed.
    """

    def __init__(self) -> None:
        super().__init__('live_node', SingleThreadedExecutor())

        def given(name: str, default: object, description: str) -> object:
            return self.declare_parameter(name, default, ParameterDescriptor(
                read_only=True, description=description)).value

        host = str(given('host', LOOPBACK, 'address to listen on; another than the loopback '
                         'makes the page ask everybody for the token'))
        self._port = int(str(given('port', 0, 'port; 0 = the first free one from 8420 on')))
        read_only = bool(given('read_only', False, 'nobody may act'))
        minutes = float(str(given('minutes', 10.0, 'what is kept [min]')))
        if not 0 <= self._port < 65536:
            raise ConfigurationError('port', self._port, 'must be 0 to 65535')
        if not 0.0 < minutes <= LONGEST:
            raise ConfigurationError('minutes', minutes, f'must be > 0 and <= {LONGEST:g}')
        access = Access(host, read_only)
        self._loop = LiveLoop(self, minutes)
        self._operator = LiveOperator(self, self._loop, self._executor)
        self._loop.operator = self._operator
        self._server = Server(self._loop, access)

    def run(self) -> None:
        """Serve until told to end.

        Raises:
            LoopError: The port is taken.
        """
        gc.enable()         # unlike a node of the loop, a server makes cycles
        try:
            os.nice(NICE)
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
        """Look at what has come, tell the viewers, serve services, at their rates."""
        due = served = told = time.monotonic()
        while not self.stopping:
            now = time.monotonic()
            if self._loop.look(now):
                self._server.renew()
            for message in self._loop.news():
                self._server.say(message)
            if now - told >= 1.0 / STATUS:
                told = now
                self._server.say(self._loop.status(now))
            self._server.publish()
            if now - served >= SERVE and not self._operator.calling:
                served = now
                self._operator.spin()
            due = max(due + 1.0 / FRAMES, now)
            await asyncio.sleep(max(due - time.monotonic(), 0.001))
