"""What somebody else's code raises, in one line with its place (ours)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from dz_ros.errors import DriverError, DzRosError

Result = TypeVar('Result')


def checked(name: str, call: Callable[[], Result]) -> Result:
    """Return what something of a driver's returns that may fail in words.

    Raises:
        DriverError: It raised something else than our errors.
    """
    try:
        return call()
    except DzRosError:
        raise
    except Exception as error:
        raise DriverError(told(name, error)) from error


def told(name: str, error: Exception) -> str:
    """Return an exception of a driver's code in one line, with the place where it was raised."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = '' if trace is None else (f' ({Path(trace.tb_frame.f_code.co_filename).name}, '
                                      f'line {trace.tb_lineno})')
    return f'{name}: {type(error).__name__}: {" ".join(str(error).split())}{place}'
