# SPDX-License-Identifier: Apache-2.0
"""What viewers send and are answered: texts that mean something, headers that keep pages apart."""

from __future__ import annotations

import json
import math
from typing import Any

HEADERS = {
    'X-Content-Type-Options': 'nosniff', 'X-Frame-Options': 'DENY',
    'Referrer-Policy': 'no-referrer', 'Cache-Control': 'no-store',
    'Cross-Origin-Opener-Policy': 'same-origin', 'Cross-Origin-Resource-Policy': 'same-origin',
}
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
          "connect-src 'self' ws://{host}; base-uri 'none'; form-action 'none'; "
          "frame-ancestors 'none'")
DEPTH = 8
"""Deepest nesting of a message to viewers."""


class ProtocolError(Exception):
    """What a viewer sent is nothing this server understands."""


def result(number: int, ok: bool, message: str) -> dict[str, Any]:
    """Return the answer to a request."""
    return {'kind': 'result', 'id': number, 'ok': ok, 'message': message}


def parse(message: Any, kinds: Any) -> dict[str, Any]:
    """Return what a viewer's text means.

    Raises:
        ProtocolError: Nothing; also where a number is not finite, or a text no Unicode.
    """
    if message.type is not kinds.TEXT:
        raise ProtocolError('text expected')
    try:
        found = json.loads(message.data)
        # 1e400 is read as infinity and "\ud800" as half a character: neither can be written again.
        json.dumps(found, ensure_ascii=False, allow_nan=False).encode()
    except (ValueError, RecursionError):
        raise ProtocolError('JSON expected, of finite numbers and whole characters') from None
    if not isinstance(found, dict):
        raise ProtocolError('a JSON object expected')
    return found


def finite(value: Any) -> float | None:
    """Return a received number, None where it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def text_of(message: Any) -> str:
    """Return the JSON of a message, ASCII alone; a value that JSON lacks is null.

    It never fails: messages carry what arbitrary nodes have published.
    """
    try:
        return json.dumps(message, allow_nan=False)
    except (ValueError, TypeError, RecursionError):
        return json.dumps(_plain(message, DEPTH), allow_nan=False)


def _plain(value: Any, depth: int) -> Any:
    """Return a value with null for what JSON lacks."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (str, int)):
        return value
    if isinstance(value, dict) and depth:
        return {str(key): _plain(item, depth - 1) for key, item in value.items()}
    if isinstance(value, (list, tuple)) and depth:
        return [_plain(item, depth - 1) for item in value]
    return None
