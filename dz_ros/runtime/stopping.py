"""Ctrl-C and SIGTERM as words that a loop asks for, instead of an exception anywhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import signal
from types import FrameType


class Stopping:
    """Why to stop.

    Attributes:
        reason: Words; '' = go on. The first reason stays.
    """

    def __init__(self) -> None:
        self.reason = ''

    def stop(self, reason: str) -> None:
        """Give a reason to stop."""
        self.reason = self.reason or reason


@contextmanager
def stop_on_signals() -> Iterator[Stopping]:
    """Yield what SIGINT and SIGTERM tell from now on; a second one raises KeyboardInterrupt."""
    stopping = Stopping()

    def hear(number: int, _frame: FrameType | None) -> None:
        if stopping.reason:
            raise KeyboardInterrupt
        stopping.stop(signal.Signals(number).name)

    earlier = {number: signal.signal(number, hear) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stopping
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)
