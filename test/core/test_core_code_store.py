# SPDX-License-Identifier: Apache-2.0
"""Compiled code is kept under a key that changes with everything it follows from."""

from enum import IntEnum
import math
from types import FunctionType

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop import compiled as module
from dz_ros.core.loop.code_store import describe, UnnamedError
from dz_ros.core.loop.compiled import compiled, keep_in, kept
from dz_ros.core.loop.offline import make_loop
from dz_ros.studies.code_folder import keep_compiled

FACTOR = 2.0
OFFSETS = (1.0, 2.0)
SOMETHING = object()


class Colour(IntEnum):
    """Constants as records have them."""

    RED = 1


class Shelf(dict):
    """A store that counts."""

    found = 0

    def load(self, key):
        data = self.get(key)
        self.found += data is not None
        return data

    def save(self, key, data):
        self[key] = data


@pytest.fixture
def shelf(monkeypatch):
    pytest.importorskip('numba', reason='numba is not installed: nothing is compiled')
    shelf = Shelf()
    keep_in(shelf)
    yield shelf
    keep_compiled()


def called(x):
    return FACTOR * x


def uses(x):
    return called(x) + OFFSETS[1] * math.sqrt(x) + Colour.RED.value


def opaque(x):
    return x if SOMETHING else -x


def other(function, **names):
    """Return a function of the same code that reads other things by name."""
    return FunctionType(function.__code__, {**function.__globals__, **names}, function.__name__)


def text(function):
    return '\n'.join(describe(function))


def test_code_is_taken_from_the_store_and_gives_the_same(shelf):
    first = kept(compiled.__wrapped__(uses))
    assert first(4.0) == uses(4.0)
    assert (len(shelf), shelf.found) == (1, 0)
    second = kept(compiled.__wrapped__(uses))
    assert second(4.0) == uses(4.0)
    assert (len(shelf), shelf.found) == (1, 1)
    assert kept(compiled.__wrapped__(other(uses, OFFSETS=(1.0, 3.0))))(4.0) == uses(4.0) + 2.0
    assert (len(shelf), shelf.found) == (2, 1)


@pytest.mark.parametrize('names', [
    {'called': other(called, FACTOR=3.0)}, {'OFFSETS': (1.0, 3.0)}, {'OFFSETS': (1, 2)},
    {'Colour': IntEnum('Colour', {'RED': 2})}, {'called': math.sin}, {'math': pytest}])
def test_the_key_changes_with_all_that_is_read(names):
    assert text(other(uses, **names)) != text(uses)


def test_the_key_is_that_of_the_code_not_of_the_object():
    assert text(other(uses)) == text(uses)
    assert text(lambda x: 2.0 * x) != text(lambda x: 3.0 * x)


def test_what_reads_something_without_a_name_is_compiled_and_not_kept(shelf):
    with pytest.raises(UnnamedError):
        text(opaque)
    assert kept(compiled.__wrapped__(opaque)).__class__ is compiled.__wrapped__(opaque).__class__
    assert not shelf


def test_every_loop_has_a_key_and_none_the_same():
    found = {}
    for flat in ({}, {'controller.law': 'robust'}, {'plant.model': 'pendulum'},
                 {'trajectory.kind': 'chirp'}, {'driver.observer_kind': 'levant'}):
        found[text(make_loop(Configuration.from_flat(flat)))] = flat
    assert len(found) == 5
    assert text(make_loop(Configuration.from_flat({'plant.b': 2.0}))) in found
    assert module.available() in (True, False)
