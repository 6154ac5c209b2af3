# SPDX-License-Identifier: Apache-2.0
"""Friction that sticks, play and steps of the command: models, compensations, predictions."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

import dz_ros as dz
from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import DeadZone, played
from dz_ros.core.design.certificate import bare
from dz_ros.core.design.command_steps import limit_cycle_bound
from dz_ros.core.design.finding import WARNING
from dz_ros.core.design.rules import check
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.loop.controller import Controller
from dz_ros.core.loop.integration import make_advance
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants.servo import Servo, ServoParameters
from dz_ros.core.records import Reference, State
from dz_ros.core.tracking import shown_position
from dz_ros.errors import ConfigurationError

PERIOD = 0.005
STICKS = ServoParameters(static_friction=1.5, cogging_torque=0.0)
NO_ZONE = DeadZone(b_r=0.0, b_l=0.0).constants


def held(parameters, x, current, seconds, substeps=4):
    """Return the states of a servo under a constant current, shape (samples, 2)."""
    plant = Servo(parameters)
    advance = make_advance(plant.regressors, plant.disturbance, sticking=plant.sticking)
    x, found = list(x), []
    for k in range(round(seconds / PERIOD)):
        advance(x, current, k * PERIOD, PERIOD / substeps, substeps, plant.constants, NO_ZONE,
                [0.0] * 2, *([0.0] * 2 for _ in range(4)))
        found.append(tuple(x))
    return np.array(found)


@pytest.mark.parametrize('current', [-1.49, -1.0, 0.0, 0.7, 1.49])
def test_rests_below_static_friction_for_good(current):
    found = held(STICKS, (0.0, 0.0), current, 2.0)
    assert abs(found[-1, 1]) < 1e-9
    assert np.ptp(found[200:, 0]) < 1e-9       # smoothed friction creeps
    smooth = held(ServoParameters(cogging_torque=0.0), (0.0, 0.0), 0.7, 2.0)
    assert np.ptp(smooth[200:, 0]) > 1e-3


@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_breaks_away_above_it_and_then_slides_with_less(sign):
    found = held(STICKS, (0.0, 0.0), sign * 1.51, 30.0)
    assert sign * found[-1, 1] == pytest.approx((1.51 - 1.0) / 0.4, rel=1e-3)


def test_slides_on_below_static_friction():
    speed = (1.2 - 1.0) / 0.4
    found = held(STICKS, (0.0, speed), 1.2, 5.0)
    assert found[-1, 1] == pytest.approx(speed, rel=1e-3)


@given(st.floats(-5.0, 5.0), st.floats(-3.0, 3.0))
def test_friction_opposes_the_motion_and_is_bounded(free, speed):
    plant = Servo(STICKS)
    y = [0.0, 0.0]
    plant.regressors([0.0, speed], plant.constants, y)
    smoothed = plant.a[1] * y[1]
    force = plant.sticking(free - smoothed, [0.0, speed], plant.constants, y) + smoothed
    assert abs(force) <= 1.5
    if abs(speed) > 0.02:       # beyond what the free acceleration of 5 can reach in 2 ms
        assert force * speed > 0.0
        assert abs(force) == pytest.approx(1.0, abs=1e-6)


def test_finer_steps_change_little():
    coarse = held(STICKS, (0.0, 1.0), 0.3, 3.0)
    fine = held(STICKS, (0.0, 1.0), 0.3, 3.0, 64)
    assert coarse[-1, 0] == pytest.approx(fine[-1, 0], abs=1e-5)
    assert coarse[-1, 1] == pytest.approx(0.0, abs=1e-9)


def test_without_static_friction_nothing_sticks_and_less_than_coulomb_is_refused():
    plant = Servo()
    assert plant.sticking(3.0, (0.0, 0.0), plant.constants, (0.0, 0.0)) == 0.0
    with pytest.raises(ConfigurationError, match='coulomb_friction'):
        Configuration.from_flat({'plant.model': 'servo', 'plant.static_friction': 0.5})


def agrees(c):
    """Check that Python, compiled loop, and controller with simulated device agree to the bit."""
    slow, fast = simulate(c), simulate_fast(c)
    for name in ('x', 'x_measured', 'v', 'v_applied', 'truth', 'terms'):
        assert np.array_equal(getattr(slow, name), getattr(fast, name))
    controller, device = Controller(c), c.make_driver()
    for k in range(len(slow.t)):
        stamp = k * c.loop.period
        assert device.measure() == tuple(slow.x_measured[k])
        controller.set_reference(Reference(k, stamp, tuple(slow.x_d[k].tolist())))
        command, _ = controller.respond(State(k, stamp, tuple(slow.x_measured[k].tolist())))
        assert command.v == slow.v[k]
        device.command(command.v, stamp)
        truth = device.advance((k + 1) * c.loop.period, k)
        assert (truth.w, truth.d, truth.disturbance) == tuple(slow.truth[k])
    return slow


@pytest.mark.parametrize('changes', [
    {'plant.static_friction': 1.5}, {'plant.backlash': 0.3, 'loop.delay': 1},
    {'plant.static_friction': 1.2, 'controller.error_band': 1e-3,
     'controller.regressors_at': 'reference', 'plant.command_resolution': 0.01}])
def test_every_way_to_run_it_gives_the_same_bits(changes):
    agrees(dz.load('servo').replace(**{'loop.duration': 4.0, 'loop.timing': 'lockstep',
                                       **changes}))


def test_disturbance_of_a_servo_that_rests_balances_the_rest():
    run = simulate(dz.load('servo').replace(**{
        'plant.static_friction': 1.5, 'plant.x0': [0.0, 0.0], 'plant.cogging_torque': 0.0,
        'loop.duration': 0.5}))
    still = np.abs(run.x[:, 1]) == 0.0
    assert still.sum() > 50
    assert run.truth[still, 2] == pytest.approx(run.truth[still, 0], abs=1e-12)


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40), st.floats(0.0, 2.0))
def test_play_is_followed_at_half_its_width_and_rests_within(commands, width):
    before = 0.0
    for v in commands:
        after = played(v, before, width)
        assert abs(after - v) <= 0.5 * width + 1e-12
        if abs(before - v) <= 0.5 * width:
            assert after == before
        before = after
    assert played(before, before, width) == before


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 0.5))
def test_band_hides_what_is_within_it_and_no_more(x, x_d, band):
    error = shown_position(x, x_d, band) - x_d
    if abs(x - x_d) <= band:
        assert error == 0.0
    else:
        assert abs(error) == pytest.approx(abs(x - x_d) - band, abs=1e-12)
        assert error * (x - x_d) >= 0.0


REST = {'trajectory.kind': 'point_to_point', 'trajectory.goal': 1.0, 'trajectory.repeat': False,
        'trajectory.t_start': 0.0, 'trajectory.duration': 2.0, 'plant.x0': [0.0, 0.0],
        'plant.static_friction': 1.5, 'loop.duration': 20.0}


def hunting(**changes):
    """Return total variation of v and largest error at rest, over the last 10 s."""
    run = simulate_fast(dz.load('servo').replace(**{**REST, **changes}))
    late = run.t >= 10.0
    return (float(np.abs(np.diff(run.v[late])).sum()),
            float(np.abs(run.x[late, 0] - run.x_d[late, 0]).max()))


@pytest.mark.slow
@pytest.mark.parametrize('law', ['pid', 'robust_eso', 'robust'])
def test_what_integrates_hunts_at_rest_and_a_band_of_error_ends_it(law):
    variation, error = hunting(**{'controller.law': law})
    smooth, _ = hunting(**{'controller.law': law, 'plant.static_friction': 0.0})
    assert variation > 10.0
    assert smooth < 0.1 * variation
    band = 5.0 * error
    rests, left = hunting(**{'controller.law': law, 'controller.error_band': band})
    assert rests < 0.1 * variation
    assert left < 2.0 * band


@pytest.mark.slow
def test_regressors_at_the_reference_help_while_it_moves():
    sine = {'trajectory.kind': 'sinusoid', 'trajectory.amplitude': 1.0}
    variation, error = hunting(**sine)
    calmer, smaller = hunting(**sine, **{'controller.regressors_at': 'reference'})
    assert smaller < 0.9 * error
    assert calmer < variation


STILL = {'trajectory.kind': 'constant', 'trajectory.value': 0.123, 'plant.dead_zone.b_r': 0.0,
         'plant.dead_zone.b_l': 0.0, 'plant.x0': [0.1, 0.0], 'loop.duration': 30.0}


@pytest.mark.parametrize('delay', [0, 1])
@pytest.mark.parametrize('step', [0.02, 0.1, 0.4])
def test_limit_cycle_of_a_command_in_steps_is_predicted(step, delay):
    base = dz.load('robust_eso').replace(**STILL, **{'loop.delay': delay})
    errors = []
    for c in (base, base.replace(**{'plant.command_resolution': step})):
        run = simulate_fast(c)
        late = run.t >= 20.0
        errors.append([np.abs(run.x[late, i] - run.x_d[late, i]).max() for i in range(2)])
    bound = limit_cycle_bound(base, step, 2)
    for without, found, most in zip(*errors, bound, strict=False):
        assert found <= without + most
        assert found > 0.15 * most
    assert math.isfinite(bound[-1])


def test_check_names_the_limit_cycle_and_warns_beyond_the_layer():
    c = dz.load('robust_eso').replace(**STILL, **{'plant.command_resolution': 0.02})
    found = {item.rule: item for item in check(c)}['command steps']
    bound = limit_cycle_bound(c, 0.02, 2)
    assert (found.numbers['x0'], found.numbers['s']) == (bound[0], bound[-1])
    assert 'command steps' not in {item.rule for item in check(dz.load('robust_eso'))}
    rough = {item.rule: item for item in check(c.replace(**{'plant.command_resolution': 20.0}))}
    assert rough['command steps'].level == WARNING


@pytest.mark.parametrize(('key', 'value'), [
    ('plant.static_friction', 1.5), ('plant.backlash', 0.1), ('controller.error_band', 0.001),
    ('controller.regressors_at', 'reference'), ('controller.law', 'scheduled')])
def test_nothing_of_it_has_a_certificate(key, value):
    bare(dz.load('servo'))
    with pytest.raises(ConfigurationError) as caught:
        bare(dz.load('servo').replace(**{key: value}))
    assert caught.value.key == key


def test_drivers_state_the_step_of_their_command():
    drive = dz.load('cia402').replace(**{'driver.name': 'cia402'})
    p = drive.driver_parameters
    assert drive.make_driver().command_resolution == pytest.approx(
        p.rated_torque / (1000.0 * p.torque_per_command))
    stated = drive.replace(**{'driver.command_resolution': 0.5})
    assert stated.make_driver().command_resolution == 0.5
    assert dz.load('thruster').make_driver().command_resolution == 1.0
