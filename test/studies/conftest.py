# SPDX-License-Identifier: Apache-2.0
"""Processes of a study compile nothing in tests: what they run is shorter than compiling it."""

import importlib.util

import pytest


@pytest.fixture(autouse=True)
def plain_processes(monkeypatch):
    """Have this process run plain Python, and numba leave functions alone in those it starts.

    numba reads its settings again whenever it compiles, so this process must not.
    """
    monkeypatch.setattr('dz_ros.core.loop.compiled.available', lambda: False)
    if importlib.util.find_spec('numba') is not None:
        monkeypatch.setenv('NUMBA_DISABLE_JIT', '1')
