# SPDX-License-Identifier: Apache-2.0
"""The dead-zone against its definition, its decomposition and a vector program of its own."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.deadzone import dead_zone, DeadZone, residual, rho
from dz_ros.errors import ConfigurationError

slopes = st.floats(0.1, 10.0)
breaks = st.floats(0.0, 5.0)
commands = st.floats(-100.0, 100.0)


def by_clipping(v, m_r, m_l, b_r, b_l):
    """Return D(v) as what remains of v beyond the band: another form of (1)."""
    beyond = v - np.clip(v, b_l, b_r)
    return np.where(beyond > 0.0, m_r, m_l) * beyond


@given(commands, slopes, slopes, breaks, breaks)
def test_agrees_with_clipping(v, m_r, m_l, b_r, b_l):
    zone = DeadZone(m_r, m_l, b_r, -b_l)
    assert zone(v) == pytest.approx(float(by_clipping(v, m_r, m_l, b_r, -b_l)), abs=1e-12)


@given(commands, commands, slopes, slopes, breaks, breaks)
def test_grows_with_v_and_no_faster_than_the_larger_slope(v, other, m_r, m_l, b_r, b_l):
    zone = DeadZone(m_r, m_l, b_r, -b_l)
    low, high = min(v, other), max(v, other)
    rise = zone(high) - zone(low)
    assert 0.0 <= rise <= max(m_r, m_l) * (high - low) * (1.0 + 1e-12) + 1e-12


@given(st.floats(0.0, 1.0), breaks, breaks)
def test_gives_nothing_inside_the_band(share, b_r, b_l):
    inside = -b_l + share * (b_r + b_l)
    assert DeadZone(1.0, 1.0, b_r, -b_l)(min(max(inside, -b_l), b_r)) == 0.0


def test_ends_of_the_band_and_the_paper_s_numbers():
    zone = DeadZone()
    assert (zone(0.5), zone(-0.6), zone(0.0)) == (0.0, 0.0, 0.0)
    assert (zone(0.51), zone(-0.61)) == (pytest.approx(0.01), pytest.approx(-0.01))
    assert zone(1.5) == 1.0
    assert zone(-1.6) == -1.0
    assert DeadZone(m_r=1.25, m_l=0.5)(2.5) == 2.5
    assert DeadZone(m_r=1.25, m_l=0.5)(-2.6) == -1.0


@given(commands, st.floats(0.85, 1.25), st.floats(0.1, 0.6), st.floats(-0.7, -0.1),
       st.floats(0.0, 100.0))
def test_decomposition_and_its_bound(v, m, b_r, b_l, t):
    zone = DeadZone(m, m, b_r, b_l)
    w = zone(v, t)
    d = residual(v, w, t, zone.constants)
    assert m * v + d == pytest.approx(w, abs=1e-12)
    assert abs(d) <= rho(0.6, -0.7, 1.25) + 1e-12


def test_rho_takes_the_worse_side():
    assert rho(0.6, -0.7, 1.25) == pytest.approx(0.875)
    assert rho(0.9, -0.7, 1.25) == pytest.approx(1.125)


def test_residual_uses_the_slope_of_the_side_of_v():
    zone = DeadZone(m_r=2.0, m_l=0.5)
    assert residual(3.0, zone(3.0), 0.0, zone.constants) == pytest.approx(-1.0)
    assert residual(-3.0, zone(-3.0), 0.0, zone.constants) == pytest.approx(0.3)


@given(st.floats(0.0, 100.0), st.floats(-4.0, 4.0))
def test_drift_is_the_dead_zone_of_that_moment(t, v):
    drifting = DeadZone(b_r=0.35, b_l=-0.4, m_r_drift=(0.2, 0.3), m_l_drift=(-0.1, 1.1),
                        b_r_drift=(0.25, 0.9), b_l_drift=(0.3, 0.7))
    now = DeadZone(1.0 + 0.2 * math.sin(0.3 * t), 1.0 - 0.1 * math.sin(1.1 * t),
                   0.35 + 0.25 * math.sin(0.9 * t), -0.4 + 0.3 * math.sin(0.7 * t))
    w = now(v)
    assert drifting(v, t) == pytest.approx(w, abs=1e-12)
    slope = now.m_r if v >= 0.0 else now.m_l
    assert residual(v, w, t, drifting.constants) == pytest.approx(w - slope * v, abs=1e-12)


def test_without_drift_time_does_not_matter():
    constants = DeadZone().constants
    assert constants[0] == 0.0
    assert dead_zone(2.0, 0.0, constants) == dead_zone(2.0, 1e6, constants)


@pytest.mark.parametrize(('values', 'key'), [
    ({'m_r': 0.0}, 'm_r'),
    ({'m_l': -1.0}, 'm_l'),
    ({'b_r': -0.1}, 'b_r'),
    ({'b_l': 0.1}, 'b_l'),
    ({'b_r': math.nan}, 'b_r'),
    ({'m_r': math.inf}, 'm_r'),
    ({'b_r_drift': [0.1]}, 'b_r_drift'),
    ({'b_r_drift': [0.6, 1.0]}, 'b_r_drift'),
    ({'b_l_drift': [-0.7, 1.0]}, 'b_l_drift'),
    ({'m_r_drift': [1.0, 1.0]}, 'm_r_drift'),
])
def test_refuses_what_is_no_dead_zone(values, key):
    with pytest.raises(ConfigurationError) as caught:
        schema.build(DeadZone, values, 'plant.dead_zone.')
    assert caught.value.key == f'plant.dead_zone.{key}'


def test_a_break_point_may_drift_to_zero_but_a_slope_not():
    schema.build(DeadZone, {'b_r_drift': [0.5, 1.0]}, '')
    schema.build(DeadZone, {'m_r_drift': [0.99, 1.0]}, '')
