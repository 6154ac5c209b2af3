# SPDX-License-Identifier: Apache-2.0
"""The percentile that everything shows."""

from hypothesis import given
from hypothesis import strategies as st

from dz_ros.core.percentiles import percentile


@given(st.lists(st.floats(allow_nan=False), min_size=1), st.floats(0.0, 1.0))
def test_a_percentile_is_a_value_with_its_share_below(values, share):
    ordered = sorted(values)
    found = percentile(ordered, share)
    assert found in ordered
    assert sum(item < found for item in ordered) <= share * len(ordered)


def test_ends_and_middle():
    assert [percentile(range(101), share) for share in (0.0, 0.5, 0.99, 1.0)] == [0, 50, 99, 100]
    assert percentile([7.0], 0.5) == 7.0
