# SPDX-License-Identifier: Apache-2.0
"""Permission to look and to act (docs/safety.md).

A foreign page in the same browser can send requests to this server, and a foreign name can
resolve to this machine. So the `Host` of every request must be an address or a name this server
was started with; a WebSocket must come from this server's own page (`Origin`); and an action needs
the token, which only the printed address carries. Looking needs it from another machine only.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket

from dz_ros.errors import ConfigurationError

LOOPBACK = '127.0.0.1'


class Access:
    """The rules for one server.

    Args:
        host: Address or name of its socket.
        read_only: Whether no viewer may act.
        actions: Whether there is anything to act on.

    Attributes:
        token: What an actor must show.
        local: Whether only this machine can connect.

    Raises:
        ConfigurationError: Not an address or name of this machine.
    """

    def __init__(self, host: str = LOOPBACK, read_only: bool = False,
                 actions: bool = True) -> None:
        self.host = host.strip('[]')
        self.read_only = read_only
        self.actions = actions
        self.token = secrets.token_urlsafe(24)
        try:
            found = socket.getaddrinfo(self.host, None, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError):
            found = []
        if not self.host or not found:
            raise ConfigurationError('host', host, 'must be an address or name of this machine, '
                                     '0.0.0.0 for all of them')
        self.local = all(ipaddress.ip_address(item[4][0].partition('%')[0]).is_loopback
                         for item in map(_address, found))
        self._names = {self.host.lower(), 'localhost', socket.gethostname().lower()}

    def host_allowed(self, header: str | None, port: int) -> bool:
        """Return whether a request's `Host` is this server: an address, or a name it knows.

        An address cannot be made to mean another machine, a name can.
        """
        if not header:
            return False
        name, given = _split(header)
        if given != port:
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name.lower() in self._names
        return True

    def origin_allowed(self, origin: str | None, host: str | None) -> bool:
        """Return whether a request comes from a page of this server."""
        return bool(host) and origin is not None and origin == f'http://{host}'

    def knows(self, token: object) -> bool:
        """Return whether the token is the right one, in constant time."""
        return isinstance(token, str) and secrets.compare_digest(
            token.encode(errors='replace'), self.token.encode())

    def may_look(self, token: object) -> bool:
        """Return whether a viewer with this token may look."""
        return self.local or self.knows(token)

    def may_act(self, token: object) -> bool:
        """Return whether a viewer with this token may act."""
        return not self.why_not(token)

    def why_not(self, token: object) -> str:
        """Return why a viewer with this token may not act; '' where it may."""
        if not self.actions:
            return 'a recorded run cannot be acted on'
        if self.read_only:
            return 'this page was started to be looked at only (read_only)'
        if not self.knows(token):
            return 'view only: open the whole address that was printed, it ends with the token'
        return ''

    def address(self, port: int) -> str:
        """Return the address to open, with the token where one is of use."""
        host = {'0.0.0.0': socket.gethostname(), '::': socket.gethostname()}.get(self.host,
                                                                                 self.host)
        place = f'http://[{host}]:{port}/' if ':' in host else f'http://{host}:{port}/'
        needed = not self.local or (self.actions and not self.read_only)
        # After the #, so that no browser sends it along or writes it into a log.
        return f'{place}#{self.token}' if needed else place


def _address(info: tuple[object, ...]) -> tuple[object, object, object, object, tuple[str, ...]]:
    """Return an entry of getaddrinfo as it is, its address as texts."""
    family, kind, protocol, name, address = info
    assert isinstance(address, tuple)
    return family, kind, protocol, name, tuple(map(str, address))


def _split(header: str) -> tuple[str, int]:
    """Return name and port of a `Host`; port 80 by default, −1 where it is not a number."""
    if header.startswith('['):
        name, _, rest = header[1:].partition(']')
        port = rest.removeprefix(':')
    else:
        name, _, port = header.partition(':')
    if not port:
        return name, 80
    return name, int(port) if port.isascii() and port.isdigit() and len(port) < 6 else -1
