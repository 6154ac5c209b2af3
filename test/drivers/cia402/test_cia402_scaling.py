# SPDX-License-Identifier: Apache-2.0
"""Scaling, wrap of the position, parameters and what they refuse."""

from dataclasses import replace
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.core import schema
from dz_ros.drivers.cia402.scaling import Scaling
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.errors import ConfigurationError


def test_a_rotary_axis_with_a_gear_in_numbers():
    # Gear 100, 20 bits: a quarter of an output turn is 25 motor turns.
    s = Scaling.of(Cia402Parameters(counts_per_rev=2 ** 20, gear=100.0, rated_torque=0.64,
                                    torque_per_command=0.08, max_torque=2.5))
    assert s.x(25 * 2 ** 20) == pytest.approx(math.pi / 2.0)
    assert s.speed(2 ** 20 * 100) == pytest.approx(2.0 * math.pi)   # counts/s of one output turn/s
    assert s.target(4.0) == 500         # 4 A × 0.08 N m/A = 0.32 N m = half of the rated torque
    assert s.target(-1000.0) == -2500
    assert s.limit == pytest.approx(2.5 * 0.64 / 0.08)


def test_a_lead_screw_in_millimetres_that_turns_the_other_way():
    s = Scaling.of(Cia402Parameters(counts_per_rev=4000, unit_per_rev=5.0, gear=2.0, zero=100,
                                    reverse=True, velocity_counts=60.0))
    assert s.x(100 + 8000) == pytest.approx(-5.0)
    assert s.speed(600) == pytest.approx(-25.0)         # 600 1/min: 10 motor turns, 5 turns a s
    assert s.target(0.5) == -500


def test_velocity_mode_in_numbers():
    # rpm drive: 1 unit/s of the output = 2 motor turns a second = 120 1/min.
    s = Scaling.of(Cia402Parameters(mode='velocity', velocity_counts=60.0, gear=2.0,
                                    unit_per_rev=1.0, speed_per_command=1.0, max_speed=3000.0))
    assert s.target(1.0) == 120
    assert s.target(1e6) == 3000
    assert s.limit == pytest.approx(25.0)
    assert s.speed(120) == pytest.approx(1.0)


scalings = st.builds(
    lambda counts, gear, unit, reverse, zero: Scaling.of(Cia402Parameters(
        counts_per_rev=counts, gear=gear, unit_per_rev=unit, reverse=reverse, zero=zero)),
    st.integers(100, 2 ** 24), st.floats(0.01, 200.0), st.floats(0.001, 100.0), st.booleans(),
    st.integers(-10 ** 6, 10 ** 6))


@settings(deadline=None)
@given(scalings, st.integers(-2 ** 30, 2 ** 30), st.integers(-1000, 1000))
def test_the_drive_and_the_driver_agree_on_every_number(s, counts, target):
    assert s.counts(s.x(counts)) == counts
    assert s.number(s.speed(counts)) == counts
    assert s.target(s.v(target)) == target


@settings(deadline=None)
@given(scalings, st.floats(-1e9, 1e9))
def test_a_target_is_never_more_than_its_object_holds(s, v):
    target = s.target(v)
    assert abs(target) <= s.largest <= 32767
    if abs(v) <= s.limit:
        assert abs(target - v * s.command) <= 0.5 + 1e-6 * abs(target)


@pytest.mark.parametrize(('values', 'message'), [
    ({'master_id': 1}, 'driver.master_id = 1: must not be that of the drive, driver.node_id'),
    ({'heartbeat_hold': 0.06}, 'driver.heartbeat_hold = 0.06: must be at least two heartbeats'),
    ({'bus_options': ['port']}, "'port' must be name=value"),
    ({'mode': 'position'}, 'must be one of torque, velocity'),
    ({'node_id': 128}, 'driver.node_id = 128: must be an integer >= 1 and <= 127'),
    ({'max_torque': 33.0}, '<= 32.767'),
    ({'max_speed': 1e6, 'counts_per_rev': 2 ** 20}, 'is more than 32 bits hold')])
def test_parameters_that_cannot_be(values, message):
    with pytest.raises(ConfigurationError) as caught:
        schema.build(Cia402Parameters, values, 'driver.')
    assert message in str(caught.value)
    assert '\n' not in str(caught.value)


def test_options_of_the_interface_have_their_type():
    p = replace(Cia402Parameters(), bus_options=('port=43113', 'fd=false', 'app_name=a=b',
                                                 'timing=0.5'))
    assert p.options == {'port': 43113, 'fd': False, 'app_name': 'a=b', 'timing': 0.5}
