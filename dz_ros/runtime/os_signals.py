# SPDX-License-Identifier: Apache-2.0
"""Signals that end a program, as text that a loop polls, instead of an exception anywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
import signal
import threading
from types import FrameType
from typing import Any

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a program in order; the last one is a terminal that was closed."""


def on_ends(handler: Callable[[int, FrameType | None], None]) -> dict[signal.Signals, Any]:
    """Have a handler called for each of `ENDS`; return the earlier handlers.

    A SIGHUP that is ignored, as `nohup` arranges, stays so.
    """
    return {number: signal.signal(number, handler) for number in ENDS
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN}


def ignore_ends() -> None:
    """Ignore `ENDS` from now on, in a program whose work is done.

    While it ends, the interpreter gives Python's handlers back to the system, and a signal that
    comes then, such as a second Ctrl-C, would kill an orderly end half a second before its exit
    code. A signal that is ignored stays ignored.
    """
    restore_handlers(dict.fromkeys(ENDS, signal.SIG_IGN))


def restore_handlers(handlers: Mapping[signal.Signals, Any]) -> None:
    """Set handlers of signals, such as earlier ones; leave alone those that are set already.

    A signal that comes while Python replaces a handler of its own by one of the system's has none
    to call: Python writes a traceback and drops it. So the system takes the signal first; Python
    handles what came before that, and only then gives up its handler.

    Args:
        handlers: Signal → its handler; None = not Python's, left alone.
    """
    for number, handler in handlers.items():
        if handler is None or signal.getsignal(number) is handler:
            continue
        if handler in (signal.SIG_IGN, signal.SIG_DFL):
            _system_signal()(number, int(handler))
        signal.signal(number, handler)


@cache
def _system_signal() -> Callable[[int, int], int]:
    """Return the C library's own `signal`."""
    # Not imported before a signal can be taken: a busy machine takes long over it.
    import ctypes
    found = ctypes.CDLL(None).signal
    found.argtypes, found.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    return found


class Stopping:
    """A reason to stop, '' = go on; the first reason stays."""

    reason = ''

    def stop(self, reason: str) -> None:
        """Give a reason to stop."""
        self.reason = self.reason or reason


@contextmanager
def stop_on_signals() -> Iterator[Stopping]:
    """Yield the reason that one of `ENDS` gives; a second one raises KeyboardInterrupt.

    A SIGHUP that is ignored, as `nohup` arranges, stays so.
    """
    stopping = Stopping()

    def handle(number: int, _frame: FrameType | None) -> None:
        if stopping.reason:
            raise KeyboardInterrupt
        stopping.stop(signal.Signals(number).name)

    earlier = on_ends(handle)
    try:
        yield stopping
    finally:
        restore_handlers(earlier)


@contextmanager
def held_ends(deliver: bool = True) -> Iterator[None]:
    """Hold `ENDS` back while something must not be interrupted, such as taking power away.

    In another thread than the main one, which no signal interrupts, nothing is held back.

    Args:
        deliver: Whether the first that came acts afterwards; not where the program ends anyway.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    earlier = on_ends(lambda number, _frame: came.append(number))
    try:
        yield
    finally:
        restore_handlers(earlier)
        if came and deliver:
            signal.raise_signal(came[0])
