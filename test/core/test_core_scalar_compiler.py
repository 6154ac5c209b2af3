# SPDX-License-Identifier: Apache-2.0
"""The short pipelines of numba: inlined code alone, the same errors, refusal of what they lack."""

import numpy as np
import pytest

pytest.importorskip('numba', reason='numba is not installed: nothing is compiled')

from numba.core.errors import NumbaError  # noqa: E402

from dz_ros.core.loop import scalar_compiler  # noqa: E402
from dz_ros.core.loop.compiled import compiled  # noqa: E402

TABLE = np.array([1.0, 2.0])


def ratio(a, b):
    return a / b + a ** 2


def both(a, b):
    return ratio(a, b) - ratio(b, a)


def looked_up(i):
    return TABLE[i]


def reads_a_table(i):
    return looked_up(i) + 1.0


@pytest.fixture(autouse=True)
def tested_version():
    if not scalar_compiler.compilers():
        pytest.skip('another version of numba: its own pipeline')


def test_a_function_that_only_compiled_ones_call_has_no_machine_code_of_its_own():
    made = compiled(both)
    assert made(3.0, 7.0) == both(3.0, 7.0)
    (inner,) = made.py_func.__globals__['ratio'].overloads.values()
    (outer,) = made.overloads.values()
    assert (type(inner.library).__name__ == 'InlinedLibrary')
    assert type(outer.library).__name__ != 'InlinedLibrary'
    with pytest.raises(ZeroDivisionError):
        made(1.0, 0.0)


def test_a_constant_array_is_part_of_the_code_or_refused_by_numbas_error():
    made = compiled(reads_a_table)
    try:
        found = made(1)
    except NumbaError:      # the loop is then compiled by numba's own pipeline
        return
    assert found == 3.0


def test_another_version_of_numba_has_its_own_pipeline(monkeypatch):
    monkeypatch.setattr(scalar_compiler, 'TESTED', ())
    compiled.cache_clear()
    scalar_compiler.compilers.cache_clear()
    try:
        made = compiled(both)
        assert made(3.0, 7.0) == both(3.0, 7.0)
        (inner,) = made.py_func.__globals__['ratio'].overloads.values()
        assert type(inner.library).__name__ != 'InlinedLibrary'
    finally:
        compiled.cache_clear()
        scalar_compiler.compilers.cache_clear()
