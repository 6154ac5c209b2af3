# SPDX-License-Identifier: Apache-2.0
"""Machine code of numba as bytes, kept under a key that names all it follows from (ours).

numba keeps code by the place of a function's source. Our functions are made at run time, from the
law, plant and trajectory chosen, so the key here is a hash of their byte code, of every function
they call and every constant they read, of the signature, the processor and the versions of Python
and numba. Where something they read has no such text, nothing is kept: it is compiled each time.

What is loaded is machine code: a store must be as private as the programs it is used by.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
import hashlib
import pickle
import sys
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Protocol


class CodeStore(Protocol):
    """Where code is kept between processes. Neither method raises."""

    def load(self, key: str) -> bytes | None:
        """Return what was saved under a key; None where nothing is, or it is damaged."""

    def save(self, key: str, data: bytes) -> None:
        """Keep data under a key, if possible."""


class UnnamedError(Exception):
    """A function reads something whose value no text names."""


class StoredCode:
    """Cache of one of numba's dispatchers, in a `CodeStore`.

    Args:
        dispatcher: The compiled function.
        options: How it is compiled, as text.
        store: Where code is kept.

    Raises:
        UnnamedError: It reads something that has no name.
    """

    cache_path = None

    def __init__(self, dispatcher: Any, options: str, store: CodeStore) -> None:
        self._store = store
        self._source = '\n'.join((options, *describe(dispatcher.py_func)))

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the function compiled for a signature, or None; called by numba."""
        from numba.core.compiler import CompileResult

        target.refresh()
        data = self._store.load(self._key(signature, target.codegen()))
        if data is None:
            return None
        return CompileResult._rebuild(target, *pickle.loads(data))

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep the function compiled for a signature; called by numba."""
        from numba.core.serialize import dumps

        if result.lifted or result.library.has_dynamic_globals:
            return
        self._store.save(self._key(signature, result.codegen), dumps(result._reduce()))

    def enable(self) -> None:
        """Do nothing; part of numba's interface."""

    disable = flush = enable

    def _key(self, signature: Any, codegen: Any) -> str:
        import numba

        text = '\n'.join((sys.version, numba.__version__, repr(codegen.magic_tuple()),
                          str(signature), self._source))
        return hashlib.sha256(text.encode()).hexdigest()


def describe(function: Any) -> Iterator[str]:
    """Yield lines that are the same for functions that compile to the same code.

    Args:
        function: A Python function of plain scalar code, or one that numba has wrapped.

    Raises:
        UnnamedError: It reads something whose value no text names.
    """
    yield from _function(function, [])


def _function(function: Any, seen: list[Any]) -> Iterator[str]:
    if function in seen:
        yield f'function {seen.index(function)}'
        return
    seen.append(function)
    code = function.__code__
    yield from _code(code)
    yield f'defaults {function.__defaults__!r} {function.__kwdefaults__!r}'
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        yield from _value(name, cell.cell_contents, seen)
    for inner in _codes(code):
        for name in inner.co_names:
            if name in function.__globals__:
                yield from _value(name, function.__globals__[name], seen, inner.co_names)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a function's code and that of the functions inside it."""
    yield code
    for item in code.co_consts:
        if isinstance(item, CodeType):
            yield from _codes(item)


def _code(code: CodeType) -> Iterator[str]:
    for inner in _codes(code):
        constants = [item for item in inner.co_consts if not isinstance(item, CodeType)]
        yield (f'code {inner.co_name} {inner.co_code.hex()} {inner.co_names} {inner.co_varnames} '
               f'{inner.co_freevars} {inner.co_cellvars} {inner.co_argcount} {constants!r}')


def _value(name: str, value: Any, seen: list[Any], names: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield lines for something that a function reads by name."""
    yield f'name {name}'
    value = getattr(value, 'py_func', value)
    if isinstance(value, FunctionType):
        yield from _function(value, seen)
    elif isinstance(value, ModuleType):
        yield f'module {value.__name__}'
        if value.__name__ not in ('math', 'numpy'):     # those numba brings itself
            for own in names:
                if own in vars(value):
                    yield from _value(own, vars(value)[own], seen)
    elif isinstance(value, type) and issubclass(value, Enum):
        yield f'enum {[(item.name, item.value) for item in value]!r}'
    elif isinstance(value, (BuiltinFunctionType, type)) and value.__module__ in ('builtins',
                                                                                 'math'):
        yield f'builtin {value.__module__}.{value.__qualname__}'
    elif isinstance(value, (bool, int, float, str, bytes, type(None))):
        yield f'constant {type(value).__name__} {value!r}'
    elif type(value) is tuple:
        yield f'tuple {len(value)}'
        for item in value:
            yield from _value('', item, seen)
    else:
        raise UnnamedError(name)
