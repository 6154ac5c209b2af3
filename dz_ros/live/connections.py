# SPDX-License-Identifier: Apache-2.0
"""Limits on the connections to the page's server: their number, and the time without a request."""

from __future__ import annotations

import asyncio
from typing import Any

MAX_CONNECTIONS = 64
"""Connections at once, whatever they are for."""
SILENT = 10.0
"""A connection must have made a whole request by then [s]."""


class _Refused(asyncio.Protocol):
    """Ends a connection as soon as it is made."""

    def connection_made(self, transport: Any) -> None:
        """Cut it."""
        transport.abort()


class Connections:
    """Makes the protocols of an HTTP server's connections.

    Args:
        server: Makes those that are let in.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._silent: set[Any] = set()

    def __call__(self) -> asyncio.BaseProtocol:
        """Return the protocol of a new connection."""
        if len(self._server.connections) >= MAX_CONNECTIONS:
            return _Refused()
        protocol: asyncio.BaseProtocol = self._server()
        self._silent.add(protocol)
        asyncio.get_running_loop().call_later(SILENT, self._look, protocol)
        return protocol

    def greet(self, protocol: Any) -> None:
        """Note that a connection has made a request."""
        self._silent.discard(protocol)

    def _look(self, protocol: Any) -> None:
        """End a connection that has made no request yet."""
        if protocol in self._silent:
            self._silent.discard(protocol)
            if protocol.transport is not None:
                protocol.transport.abort()
