# SPDX-License-Identifier: Apache-2.0
"""Thrusters at a supply voltage that falls: the public figures, and the loop that follows."""

import numpy as np
import pytest

import dz_ros as dz
from dz_ros.core.loop.compiled import compiled, simulate_fast
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants.thruster import thrust, ZONE
from dz_ros.core.tracking import guaranteed_bounds

# Voltage [V]: edges of the dead band [µs], mean slopes right and left [N/µs].
FIGURES = {10.0: (1456.0, 1544.0, 0.083, 0.066), 12.0: (1460.0, 1540.0, 0.104, 0.082),
           16.0: (1468.0, 1532.0, 0.145, 0.113), 20.0: (1472.0, 1532.0, 0.180, 0.135)}
FULL = 360.0


@pytest.mark.parametrize('volts', FIGURES)
def test_has_the_band_and_the_mean_slopes_of_the_figures(volts):
    left, right, slope_right, slope_left = FIGURES[volts]
    assert thrust(right - 1500.0, volts) == thrust(left - 1500.0, volts) == 0.0
    assert thrust(right - 1499.0, volts) > 0.0 > thrust(left - 1501.0, volts)
    assert thrust(right - 1500.0 + FULL, volts) == pytest.approx(slope_right * FULL)
    assert thrust(left - 1500.0 - FULL, volts) == pytest.approx(-slope_left * FULL)


def test_slope_near_the_edge_at_12_volts_is_that_of_the_figures():
    step = 1e-3
    assert thrust(40.0 + step, 12.0) / step == pytest.approx(0.068, rel=0.01)
    assert -thrust(-40.0 - step, 12.0) / step == pytest.approx(0.054, rel=0.01)


def test_lies_between_the_figures_of_neighbouring_voltages_and_ends_with_the_last():
    for v in np.linspace(-400.0, 400.0, 81):
        between = sorted((abs(thrust(v, 16.0)), abs(thrust(v, 20.0))))
        assert between[0] <= abs(thrust(v, 17.3)) <= between[1]
        assert thrust(v, 24.0) == thrust(v, 20.0)
        assert thrust(v, 8.0) == thrust(v, 10.0)


def test_compiled_curve_gives_the_same_bits():
    pytest.importorskip('numba')
    fast = compiled(thrust)
    for v, volts in np.random.default_rng(3).uniform((-400.0, 9.0), (400.0, 21.0), (200, 2)):
        assert fast(v, volts) == thrust(v, volts)


def test_configuration_holds_the_curve():
    zone = dz.load('thruster').dead_zone
    assert zone.schedule_points == ZONE.schedule_points
    assert (zone.edge_slope, zone.edge_span) == (ZONE.edge_slope, ZONE.edge_span)
    for name in ('m_r', 'm_l', 'b_r', 'b_l'):
        assert getattr(zone, f'{name}_table') == pytest.approx(getattr(ZONE, f'{name}_table'),
                                                               abs=5e-4)


@pytest.mark.slow
def test_tracks_while_the_supply_falls_from_20_to_14_volts():
    c = dz.load('thruster')
    assert (c.loop.schedule(0.0), c.loop.schedule(c.loop.duration)) == (20.0, 14.0)
    run = simulate_fast(c)
    falling = (run.t >= c.loop.schedule_times[0])
    error = np.abs(run.x - run.x_d[:, :2])[falling].max(axis=0)
    design = c.law.design
    promised = guaranteed_bounds(design.lambda_, design.target, c.plant.order)
    assert error[0] < promised[0]
    assert error[1] < promised[1]
    assert error[0] < 0.0005


def test_python_and_compiled_loop_agree_bit_for_bit():
    pytest.importorskip('numba')
    c = dz.load('thruster').replace(**{'loop.duration': 2.0, 'loop.schedule_times': [0.5, 1.5]})
    slow, fast = simulate(c), simulate_fast(c)
    for name in ('x', 'v', 'v_applied', 'truth', 'terms'):
        assert np.array_equal(getattr(slow, name), getattr(fast, name))
