# SPDX-License-Identifier: Apache-2.0
"""The closed loop compiled by numba: the same source, the same bits, offline only (ours).

Every function of a loop is plain scalar code over sequences of floats. numba is optional; without
it plain Python gives the same numbers, slower. A combination of law, plant and trajectory is
compiled once in a process, or once for all processes where there is a store for it (`keep_in`).
Nothing in a loop allocates, so numba's counting of references is left out and functions are
inlined; a user's plant or law that does allocate is compiled with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
import gc
from importlib.util import find_spec
import sys
from types import FunctionType
from typing import Any, cast

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.code_store import CodeStore, StoredCode, UnnamedError
from dz_ros.core.loop.offline import Loop, make_loop, prepare, Run, simulate
from dz_ros.core.loop.scalar_compiler import compilers
from dz_ros.errors import MissingDependencyError

loops: dict[tuple[Any, ...], Loop] = {}
"""What was compiled in this process, by law, plant and trajectory."""


_stores: list[CodeStore] = []
_refused: set[tuple[Any, ...]] = set()
"""What numba could not compile, as in `loops`."""


def keep_in(store: CodeStore | None) -> None:
    """Keep what is compiled from now on in a store and take it from there; None = in none."""
    _stores[:] = [] if store is None else [store]


@cache
def available() -> bool:
    """Return whether numba is installed."""
    return find_spec('numba') is not None


@cache
def compiled(function: Callable[..., Any], allocates: bool = False, inner: bool = False) -> Any:
    """Return a function compiled, together with the plain functions it calls by name.

    Args:
        function: Plain scalar code; what is no Python function is returned as it is.
        allocates: True where it makes arrays, lists or the like.
        inner: True where only compiled functions call it, so that it needs no entry from Python,
            which takes a fifth of the time to compile.

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
            names[name] = compiled(called, allocates, True)
    copy = FunctionType(function.__code__, names, function.__name__, function.__defaults__,
                        function.__closure__)
    copy.__kwdefaults__ = function.__kwdefaults__
    # Python's errors for what Python refuses (division by zero); no reordering of operations.
    options: dict[str, Any] = {} if allocates else {'_nrt': False, 'forceinline': True}
    if not allocates:
        found = compilers()
        if found is not None:
            options['pipeline_class'] = found[inner]
    options |= {'no_cpython_wrapper': inner, 'no_cfunc_wrapper': True}
    return njit(copy, error_model='python', fastmath=False, **options)


def kept(dispatcher: Any, allocates: bool = False) -> Any:
    """Return a compiled function that takes its code from the store and leaves it there.

    One without store, or that reads what no text names, is returned as it is.
    """
    if _stores and hasattr(dispatcher, 'py_func'):
        with suppress(UnnamedError):
            dispatcher._cache = StoredCode(dispatcher, f'allocates={allocates}', _stores[0])
    return dispatcher


def quick(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of plain scalar code in the form that is quicker in this process.

    Compiled where numba has been imported already, as it is elsewhere: its import takes longer
    than most of what calls this. The numbers are the same.
    """
    return _quick(function) if 'numba' in sys.modules and available() else function


@cache
def _quick(function: Callable[..., Any]) -> Callable[..., Any]:
    made: Callable[..., Any] = kept(compiled(function))
    return made if hasattr(made, 'py_func') else function


@contextmanager
def _uncollected(compiling: bool) -> Iterator[None]:
    """Collect no garbage while numba compiles: it looks through what is all in use."""
    compiling = compiling and gc.isenabled()
    if compiling:
        gc.disable()
    try:
        yield
    finally:
        if compiling:
            gc.enable()


def _not_installed() -> MissingDependencyError:
    return MissingDependencyError("numba is not installed: pip install 'dz_ros[numba]', or go "
                                  'without; the numbers are the same')


def _compiled_loop(configuration: Configuration) -> Loop:
    """Return the loop compiled without counting references, or with, where that is needed."""
    from numba.core.errors import NumbaError

    def made(allocates: bool) -> Loop:
        return cast(Loop, kept(make_loop(
            configuration, lambda function: compiled(function, allocates, True),
            lambda function: compiled(function, allocates)), allocates))

    loop, begun = made(False), False

    def run(*arguments: Any) -> None:
        nonlocal loop, begun
        if begun:
            loop(*arguments)
            return
        try:
            with _uncollected(not getattr(loop, 'signatures', True)):
                loop(*arguments)
        except (NumbaError, KeyError):      # before anything has run; KeyError: unknown option
            loop = made(True)
            loop(*arguments)
        begun = True        # the types of the arguments are always the same

    return run


def _kind(c: Configuration) -> tuple[Any, ...]:
    """Return what a loop is compiled for."""
    return (type(c.law).kernel, type(c.plant).regressors, type(c.plant).disturbance,
            type(c.plant).sticking, type(c.trajectory).evaluate, c.driver_settings.observer_kind)


def compiled_loop(configuration: Configuration) -> Loop:
    """Return the compiled loop for a configuration's law, plant and trajectory.

    Raises:
        MissingDependencyError: numba is not installed.
    """
    if not available():
        raise _not_installed()
    key = _kind(configuration)
    if key not in loops:
        loops[key] = _compiled_loop(configuration)
    return loops[key]


def simulate_fast(configuration: Configuration,
                  memory: Sequence[float] | None = None) -> Run:
    """Return `simulate`'s run, compiled where numba is installed, in plain Python elsewhere."""
    return prepare_fast(configuration, memory)()


def simulate_quick(configuration: Configuration) -> Run:
    """Return `simulate`'s run in the form that is quicker in this process.

    Compiled where numba has been imported or what it compiles is kept (`keep_in`), unless numba
    refuses a law or plant of the user's own. The numbers are the same.

    Raises:
        OverflowError, ValueError: As `simulate`; compiled, more runs end in infinities or NaN.
    """
    kind = _kind(configuration)
    if available() and (_stores or 'numba' in sys.modules) and kind not in _refused:
        from numba.core.errors import NumbaError

        try:
            return simulate_fast(configuration)
        except NumbaError:
            _refused.add(kind)      # to be refused takes longer than a run
    return simulate(configuration)


def prepare_fast(configuration: Configuration,
                 memory: Sequence[float] | None = None) -> Callable[[], Run]:
    """Return the function that runs `simulate_fast`, once; what is small is made already."""
    return prepare(configuration, compiled_loop(configuration) if available() else None, memory)
