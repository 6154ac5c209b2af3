# SPDX-License-Identifier: Apache-2.0
"""Rows are the same whether a configuration is made from its keys or from another one's parts."""

import pytest

from dz_ros.core.loop import compiled
from dz_ros.studies.outcome import row_of, rows_of
from dz_ros.studies.scenarios import base_configuration, scenarios, yardstick


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    """Compiling takes longer than these runs."""
    monkeypatch.setattr(compiled, 'available', lambda: False)


@pytest.mark.parametrize('law', ['wang2004', 'robust_eso'])
def test_sections_that_are_kept_change_no_row(law):
    base = {**base_configuration(1.0), 'controller.law': law}
    changes = [{}, *(dict(item.members[0]) for item in scenarios(1.0, 1).values()),
               {'controller.k_d': 20.0}, {'controller.law': 'pd'}, {'plant.b': -1.0},
               {'plant.model': 'pendulum'}, {'controller.nonsense': 1}, {'loop.duration': 0.01}]
    assert rows_of(base, changes) == [row_of(base, item) for item in changes]
    assert rows_of(base, changes[:3], yardstick()) == [row_of(base, item, yardstick())
                                                       for item in changes[:3]]


def test_changes_may_mend_what_they_change():
    base = {**base_configuration(1.0), 'plant.b': -1.0}
    refused, mended = rows_of(base, [{}, {'plant.b': 1.0}])
    assert refused['reason'].startswith('refused: plant.b')
    assert mended == row_of(base_configuration(1.0), {})
