"""What a process of the loop does to itself before the loop starts; all of it may be refused."""

from __future__ import annotations

import ctypes
import gc

_PR_SET_TIMERSLACK = 29


def settle() -> None:
    """Keep the garbage collector and the kernel's timer slack out of the loop.

    Objects made so far are frozen and automatic collection is off: a node makes no cycles per
    sample, so nothing accumulates. Timers then wake within a microsecond of their time instead of
    the default 50 (Linux; elsewhere nothing happens).
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    except (AttributeError, OSError):
        return
