# SPDX-License-Identifier: Apache-2.0
"""Audits of runs of several axes, coupled ones with what the others had."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dz_ros.core.dataset import from_runs, RunData
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.save import state_configuration
from dz_ros.replay.audit.audit import audit
from dz_ros.runs.axes import each_axis


def recorded(name: str) -> dict[str, RunData]:
    """Return axis → run of a shipped configuration, half a second of it."""
    c = load_configuration(name, ['loop.duration=0.5'])
    memory = [number for item in c.each for number in item.law.initial_memory()]
    return each_axis(state_configuration(from_runs(simulate_axes(c), c, 10**9), memory))


@pytest.mark.parametrize('name', ['six_axes', 'two_link_arm', 'rov_planar'])
def test_every_axis_is_reproduced_bit_for_bit(name):
    runs = recorded(name)
    for axis, run in runs.items():
        result = audit(run, others=[item for other, item in runs.items() if other != axis])
        assert result.passed, (axis, result)
        assert result.checked == 101


def test_a_law_that_knows_all_axes_cannot_be_checked_without_the_others():
    runs = recorded('two_link_arm')
    result = audit(runs['shoulder'])
    assert not result.passed
    assert result.checked == 0
    assert [item.text for item in result.not_checkable] == [
        'what the other axes had is not in the log, and the law knows all axes']


def test_a_number_of_another_axis_that_was_changed_is_found():
    runs = recorded('two_link_arm')
    channel = runs['elbow'].channels['state']
    values = channel.values.copy()
    values[40, channel.labels.index('x1')] += 0.01
    changed = replace(runs['elbow'], channels={
        **runs['elbow'].channels, 'state': replace(channel, values=values)})
    result = audit(runs['shoulder'], others=[changed])
    assert not result.passed
    assert result.first.seq == 40
