"""What viewers send and are answered: texts that mean something, headers that keep pages apart."""

from __future__ import annotations

import json
from typing import Any, NoReturn

HEADERS = {
    'X-Content-Type-Options': 'nosniff', 'X-Frame-Options': 'DENY',
    'Referrer-Policy': 'no-referrer', 'Cache-Control': 'no-store',
    'Cross-Origin-Opener-Policy': 'same-origin', 'Cross-Origin-Resource-Policy': 'same-origin',
}
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
          "connect-src 'self' ws://{host}; base-uri 'none'; form-action 'none'; "
          "frame-ancestors 'none'")



class ProtocolError(Exception):
    """What a viewer sent is nothing this server understands."""


def result(number: int, ok: bool, message: str) -> dict[str, Any]:
    """Return the answer to a request."""
    return {'kind': 'result', 'id': number, 'ok': ok, 'message': message}


def parse(message: Any, kinds: Any) -> dict[str, Any]:
    """Return what a viewer's text means.

    Raises:
        ProtocolError: Nothing.
    """
    def refuse(_text: str) -> NoReturn:
        raise ValueError('not JSON')

    if message.type is not kinds.TEXT:
        raise ProtocolError('text expected')
    try:
        found = json.loads(message.data, parse_constant=refuse)
    except (ValueError, RecursionError):
        raise ProtocolError('JSON expected') from None
    if not isinstance(found, dict):
        raise ProtocolError('a JSON object expected')
    return found
