# SPDX-License-Identifier: Apache-2.0
"""The server's time: seconds since the epoch when it started, and steady from there on (ours).

Pages compute the age of data from it and stamp their requests with it; a system clock that is set
meanwhile must make nothing look old, or fresh.
"""

from __future__ import annotations

import time

_START = time.time() - time.monotonic()


def clock() -> float:
    """Return the server's time [s]."""
    return _START + time.monotonic()
