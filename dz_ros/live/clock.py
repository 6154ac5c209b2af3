"""The server's time: seconds since the epoch when it started, and steady from there on (ours).

Pages tell from it how old is what they show, and say with it when they asked for something; a
clock that is set meanwhile must make nothing look old, or fresh.
"""

from __future__ import annotations

import time

_START = time.time() - time.monotonic()


def clock() -> float:
    """Return the server's time [s]."""
    return _START + time.monotonic()
