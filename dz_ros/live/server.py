# SPDX-License-Identifier: Apache-2.0
"""The page's server: static files from memory, and one WebSocket a viewer.

A viewer's first text is ``{"hello": 1, "token": …, "seconds": …, "axis": …}``; it gets a text of
kind ``hello``, then rows as frames (`dz_ros.live.history`) and texts of kinds ``status``,
``event`` and ``result``. What it asks has an ``id`` and a ``do`` (`dz_ros.live.answers`). Whatever
is not that ends its connection, and its alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
import time
from typing import Any

from dz_ros.errors import LoopError, MissingDependencyError
from dz_ros.live.access import Access
from dz_ros.live.answers import Answers
from dz_ros.live.assets import ASSETS, read_assets
from dz_ros.live.clock import clock
from dz_ros.live.connections import Connections
from dz_ros.live.requests import finite, HEADERS, parse, POLICY, ProtocolError, text_of
from dz_ros.live.source import Source
from dz_ros.live.viewer import Viewer

NO_AIOHTTP = "the page needs aiohttp: pip install 'dz_ros[live]'"
PORTS = range(8420, 8440)
"""Ports tried where none is given."""
MOST_VIEWERS = 16
TOKEN_PLACES = 4
"""Places that only those with the token get."""
MESSAGE = 16384
"""Largest text a viewer may send [bytes]."""
HELLO_LIMIT = 5.0
"""Longest wait for a viewer's hello [s]."""


class Server:
    """Serves one source.

    Args:
        source: What is shown.
        access: Permissions.

    Raises:
        MissingDependencyError: aiohttp is not installed.
    """

    def __init__(self, source: Source, access: Access) -> None:
        try:
            import aiohttp.web
        except ImportError:
            raise MissingDependencyError(NO_AIOHTTP) from None
        self._web = aiohttp.web
        self._kinds = aiohttp.WSMsgType
        self._source = source
        self._access = access
        self._assets = read_assets()
        self.viewers: set[Viewer] = set()
        self.port = 0
        self._runner: Any = None
        self._connections: Connections | None = None
        self._listener: asyncio.AbstractServer | None = None
        self._answers = Answers(access, self._kinds)

    async def start(self, port: int = 0) -> str:
        """Listen; return the address to open.

        Args:
            port: Port; 0 = the first free one of `PORTS`.

        Raises:
            LoopError: The port is taken, or the address is not this machine's.
        """
        web = self._web

        @web.middleware     # type: ignore[untyped-decorator]
        async def guarded(request: Any, handler: Callable[[Any], Awaitable[Any]]) -> Any:
            return await self._guarded(request, handler)

        app = web.Application(middlewares=[guarded], client_max_size=1024)
        app.router.add_get('/ws', self._serve_viewer)
        for path in ASSETS:
            app.router.add_get(path, self._serve_asset)
        self._runner = web.AppRunner(app, access_log=None, handle_signals=False,
                                     keepalive_timeout=5.0, max_line_size=2048,
                                     max_field_size=2048)
        await self._runner.setup()
        self._connections = Connections(self._runner.server)
        loop = asyncio.get_running_loop()
        problem: OSError | None = None
        for candidate in (port,) if port else PORTS:
            try:
                self._listener = await loop.create_server(
                    self._connections, self._access.host, candidate, backlog=32)
            except OSError as error:
                problem = error
                continue
            self.port = candidate
            return self._access.address(candidate)
        await self._runner.cleanup()
        what = f'port {port}' if port else f'ports {PORTS.start} to {PORTS.stop - 1}'
        reason = problem.strerror if problem is not None else ''
        raise LoopError(f'{self._access.host}, {what}: cannot be listened on ({reason}): choose '
                        'another port or host')

    async def close(self) -> None:
        """Part with every viewer and stop listening."""
        if self._listener is not None:
            self._listener.close()
        for viewer in list(self.viewers):
            viewer.drop()
        self._answers.close()
        if self._runner is not None:
            await self._runner.cleanup()

    def publish(self) -> None:
        """Wake every viewer that has rows to get; drop those that do not read."""
        now = time.monotonic()
        for viewer in list(self.viewers):
            if viewer.stalled(now):
                viewer.drop()
            else:
                viewer.wake.set()

    def broadcast(self, message: dict[str, Any]) -> None:
        """Send a text to every viewer."""
        if self.viewers:
            text = text_of(message)
            for viewer in list(self.viewers):
                viewer.send(text)

    def renew(self) -> None:
        """Introduce the source again, whose columns have changed."""
        for viewer in list(self.viewers):
            self._introduce(viewer, viewer.token, viewer.seconds)

    # Requests.

    async def _guarded(self, request: Any, handler: Callable[[Any], Awaitable[Any]]) -> Any:
        """Look at every request before anything else does."""
        if self._connections is not None:
            self._connections.greet(request.protocol)
        web = self._web
        if not self._access.host_allowed(request.headers.get('Host'), self.port):
            response = web.Response(status=421, text='this address is not mine\n')
        else:
            try:
                response = await handler(request)
            except web.HTTPException as error:
                response = web.Response(status=error.status, text=f'{error.reason}\n')
        if not response.prepared:
            response.headers.update(HEADERS)
            response.headers['Content-Security-Policy'] = POLICY.format(
                host=request.headers.get('Host', ''))
            response.force_close()
        return response

    async def _serve_asset(self, request: Any) -> Any:
        kind, body = self._assets[request.path]
        return self._web.Response(body=body, content_type=kind, charset=(
            'utf-8' if kind.startswith('text/') else None))

    async def _serve_viewer(self, request: Any) -> Any:
        web = self._web
        if not self._access.origin_allowed(request.headers.get('Origin'),
                                           request.headers.get('Host')):
            raise web.HTTPForbidden(reason='not from a page of this server')
        if len(self.viewers) >= MOST_VIEWERS:
            raise web.HTTPServiceUnavailable(reason=f'{MOST_VIEWERS} viewers are here already')
        answer = web.WebSocketResponse(max_msg_size=MESSAGE, compress=False, heartbeat=20.0,
                                       timeout=2.0)
        await answer.prepare(request)
        peer = request.remote or '?'
        viewer = Viewer(answer, request.transport, peer, self._source)
        code, reason = 1008, 'hello expected'
        sender: asyncio.Task[None] | None = None
        try:
            # One deadline: a receive with a time-out would restart at each ping.
            token, seconds, axis = await asyncio.wait_for(self._hello(answer), HELLO_LIMIT)
            if not self._access.may_look(token):
                code, reason = 4401, 'the token is missing or wrong'
                return answer
            if not self._room(token):
                code, reason = 1013, 'the other places are for those with the token'
                return answer
            source = self._source.of_axis(axis)
            if source is None:
                code, reason = 1008, 'there is no such axis'
                return answer
            viewer.source = source
            self._introduce(viewer, token, seconds)
            self.viewers.add(viewer)
            sender = asyncio.create_task(self._feed(viewer))
            async for message in answer:
                self._answers.receive(viewer, message)
            code, reason = 1000, ''
        except ProtocolError as error:
            reason = str(error)
        except (ConnectionError, asyncio.TimeoutError):
            pass
        finally:
            self.viewers.discard(viewer)
            viewer.leave()
            if sender is not None:
                sender.cancel()
            if not answer.closed:
                await answer.close(code=code, message=reason.encode()[:120])
        return answer

    def _room(self, token: str) -> bool:
        """Return whether there is a place for a viewer with this token."""
        if self._access.knows(token):
            return len(self.viewers) < MOST_VIEWERS
        others = sum(not self._access.knows(viewer.token) for viewer in self.viewers)
        return others < MOST_VIEWERS - TOKEN_PLACES and len(self.viewers) < MOST_VIEWERS

    async def _hello(self, answer: Any) -> tuple[str, float, str]:
        """Return token, seconds of history wanted and the axis asked for, '' = none."""
        first = parse(await answer.receive(), self._kinds)
        seconds = finite(first.get('seconds', 0))
        if 'hello' not in first or seconds is None or not 0 <= seconds < 1e6:
            raise ProtocolError('hello expected')
        return str(first.get('token', '')), seconds, str(first.get('axis', ''))

    def _introduce(self, viewer: Viewer, token: str, seconds: float) -> None:
        """Send a viewer the description of the source and the rows of the last `seconds`."""
        history = viewer.source.history
        hello = viewer.source.hello()
        why_not = self._access.why_not(token)
        viewer.token, viewer.seconds, viewer.may_act = token, seconds, not why_not
        viewer.send({'kind': 'hello', **hello, 'generation': history.generation,
                    'may_act': not why_not, 'why_not': why_not, 'time': clock()})
        for message in viewer.source.now():
            viewer.send(message)
        viewer.generation = history.generation
        viewer.cursor = history.begin(seconds * hello.get('rate', 0.0))

    async def _feed(self, viewer: Viewer) -> None:
        """Send a viewer what there is until it goes."""
        try:
            while True:
                await viewer.wake.wait()
                viewer.wake.clear()
                await viewer.send_all(viewer.source.history)
        except (ConnectionError, RuntimeError):
            viewer.drop()
