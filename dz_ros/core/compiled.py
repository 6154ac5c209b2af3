"""The closed loop compiled by numba: the same source, the same bits, off line only (ours).

Every function of a loop is plain scalar code over sequences of floats, so numba compiles it as it
stands. numba is optional; whatever uses this falls back to plain Python, which is slower and
gives the same numbers. A combination of law, plant and trajectory is compiled once in a process.

Nothing in a loop allocates, so numba's counting of references, which it would otherwise do around
each of the inner calls and which takes longer than the mathematics, is left out and the functions
are inlined. A plant or law of one's own that does allocate is compiled with the counting.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from types import FunctionType
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop import Loop, make_loop, Run, simulate
from dz_ros.errors import MissingDependencyError

_loops: dict[tuple[Any, ...], Loop] = {}


def available() -> bool:
    """Return whether numba is installed."""
    return find_spec('numba') is not None


@cache
def compiled(function: Callable[..., Any], allocates: bool = False) -> Any:
    """Return a function compiled, together with the plain functions it calls by name.

    Args:
        function: Plain scalar code; what is no Python function is returned as it is.
        allocates: True where it makes arrays, lists or the like.

    Raises:
        MissingDependencyError: numba is not installed.
    """
    if not available():
        raise _not_installed()
    from numba import njit

    if not isinstance(function, FunctionType):
        return function
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        called = names.get(name)
        if isinstance(called, FunctionType) and called is not function:
            names[name] = compiled(called, allocates)
    copy = FunctionType(function.__code__, names, function.__name__, function.__defaults__,
                        function.__closure__)
    copy.__kwdefaults__ = function.__kwdefaults__
    # Python's errors for what Python refuses (division by zero); no reordering of operations.
    options = {} if allocates else {'_nrt': False, 'forceinline': True}
    return njit(copy, error_model='python', fastmath=False, **options)


def _not_installed() -> MissingDependencyError:
    return MissingDependencyError("numba is not installed: pip install 'dz_ros[numba]', or go "
                                  'without; the numbers are the same')


def _compiled_loop(configuration: Configuration) -> Loop:
    """Return the loop compiled without counting references, or with, where that is needed."""
    from numba.core.errors import NumbaError

    loop = make_loop(configuration, compiled)

    def run(*arguments: Any) -> None:
        nonlocal loop
        try:
            loop(*arguments)
        except (NumbaError, KeyError):      # before anything has run; KeyError: unknown option
            loop = make_loop(configuration, lambda function: compiled(function, True))
            loop(*arguments)

    return run


def compiled_loop(configuration: Configuration) -> Loop:
    """Return the compiled loop for a configuration's law, plant and trajectory.

    Raises:
        MissingDependencyError: numba is not installed.
    """
    if not available():
        raise _not_installed()
    c = configuration
    key = (type(c.law).kernel, type(c.plant).regressors, type(c.plant).disturbance,
           type(c.trajectory).evaluate)
    if key not in _loops:
        _loops[key] = _compiled_loop(c)
    return _loops[key]


def simulate_fast(configuration: Configuration) -> Run:
    """Return `simulate`'s run, compiled where numba is installed, in plain Python elsewhere."""
    if not available():
        return simulate(configuration)
    return simulate(configuration, compiled_loop(configuration))
