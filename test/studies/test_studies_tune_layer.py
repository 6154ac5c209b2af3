# SPDX-License-Identifier: Apache-2.0
"""Proposals from positions alone and under noise: calm, and `dz check` gives no warning."""

import numpy as np
import pytest

from dz_ros.core.design.finding import INFO
from dz_ros.core.design.guard_noise import LEAST, noise_in_s
from dz_ros.core.design.linear_loop import spectral_radius
from dz_ros.core.design.observation import (
    linear_observer,
    measured_steps,
    observer_of,
)
from dz_ros.core.design.rules import check
from dz_ros.core.loop.offline import simulate
from dz_ros.core.observers.base import noise_gain
from dz_ros.core.observers.tracking import Tracking
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.tune import tune
from dz_ros.studies.tune_layer import (
    loop_delays,
    settled,
    steepest_gain,
    suits,
    with_layer,
)

pytestmark = pytest.mark.slow

LAYER = ('chatter', 'observer', 'guard')
ENCODERS = {'cia402': 'driver.velocity_measured=false', 'joint': 'driver.measured=1',
            'serial': 'driver.measured=1'}
MEASURED = {'cia402': True, 'joint': 2, 'serial': 2}


@pytest.fixture(autouse=True)
def plain_processes():
    """Loops are compiled: a search runs some dozens of each kind."""


def encoder(name, *overrides):
    return load_configuration(name, [ENCODERS[name], 'loop.duration=8', *overrides])


def complaints(c):
    return [(item.rule, item.words) for item in check(c)
            if item.rule in LAYER and item.level != INFO]


def at_slope(c, b, m):
    """Return the loop with this input gain of the plant."""
    return c.replace(**{'plant.inertia': 1.0 / b, 'plant.dead_zone.m_r': m,
                        'plant.dead_zone.m_l': m})


def variation(c):
    """Return the total variation of v per second in the second half."""
    v = simulate(c).v
    late = v[len(v) // 2:]
    return float(np.abs(np.diff(late)).sum()) / (len(late) * c.loop.period)


@pytest.mark.parametrize('delay', [0, 1])
@pytest.mark.parametrize('law', ['robust', 'wang2004', 'extended', 'robust_eso'])
@pytest.mark.parametrize('name', ENCODERS)
def test_from_positions_alone_a_proposal_is_calm_by_check_matrix_and_simulation(name, law, delay):
    c = encoder(name, f'controller.law={law}', f'loop.delay={delay}')
    found = tune(c).after
    assert complaints(found) == []
    known, driver = found.controller_settings, found.make_driver()
    assert driver.measured == 1
    key = ENCODERS[name].partition('=')[0]
    for b, m in zip(known.b_bounds, known.m_bounds, strict=True):
        for late in (0, 1, 2):      # a device has a sample to spare
            assert spectral_radius(found.law.layer_model(), c.loop.period, b * m, late,
                                   linear_observer(found, 1)) < 1.0
        # as calm as the same gains are with a measured velocity
        own = at_slope(found, b, m)
        measured = own.replace(**{key: MEASURED[name]})
        assert measured.make_driver().measured == 2
        assert variation(own) < 2.0 * variation(measured)


@pytest.mark.parametrize('law', ['robust', 'wang2004', 'robust_eso'])
def test_wide_bounds_of_the_input_gain_lower_the_gain(law):
    c = encoder('joint', f'controller.law={law}', 'controller.b_bounds=[0.5, 2.0]',
                'loop.delay=1', 'controller.m_bounds=[1.0, 1.0]')
    found = tune(c).after
    assert complaints(found) == []
    narrow = tune(encoder('joint', f'controller.law={law}', 'loop.delay=1',
                          'controller.m_bounds=[1.0, 1.0]')).after
    assert found.law.design.gain < narrow.law.design.gain


@pytest.mark.parametrize(('name', 'delay', 'delays'), [
    ('servo', 0, (0, 1)), ('servo', 3, (0, 1, 3)), ('joint', 0, (0, 1, 2)),
    ('joint', 1, (0, 1, 2)), ('joint', 3, (0, 1, 3, 4))])
def test_a_device_has_a_sample_to_spare(name, delay, delays):
    assert loop_delays(load_configuration(name, [f'loop.delay={delay}'])) == delays


def test_the_limit_of_k_is_where_a_simulated_loop_begins_to_chatter():
    c = at_slope(load_configuration('servo', [
        'controller.law=wang2004', 'driver.measured=1', 'loop.delay=1', 'loop.duration=16']),
        1.1, 1.25)
    limit = steepest_gain(c)
    measured = steepest_gain(c.replace(**{'driver.measured': 2}))
    assert limit < 0.7 * measured       # the observer costs that much

    def with_gain(gain):
        gains = c.law.gains
        return c.replace(**{'controller.epsilon': gains.k_star / (gain - gains.k_d)})

    assert with_gain(limit).law.design.gain == pytest.approx(limit)
    calm, chatters = (variation(with_gain(share * limit)) for share in (0.9, 1.2))
    assert chatters > 3.0 * calm


@pytest.mark.parametrize('driver', ['cia402', 'simulated'])
@pytest.mark.parametrize('law', ['robust', 'robust_eso', 'wang2004'])
def test_noise_leaves_the_guard_and_the_layer_their_room(law, driver):
    c = (encoder('cia402', f'controller.law={law}') if driver == 'cia402' else
         load_configuration('servo', [f'controller.law={law}', 'driver.measured=1',
                                      'loop.duration=8', 'plant.resolution=1e-3']))
    found = tune(c).after
    assert complaints(found) == []
    own = found.make_driver()
    sigma = noise_in_s(found, own.measured, measured_steps(own))
    if 'kappa_f' in found.law.signal_names:
        assert found.law.design.epsilon >= LEAST * sigma > 0.0


def test_measured_noise_is_kept_out_of_the_guard_too():
    found = tune(load_configuration('robust', ['loop.duration=8', 'plant.noise=[0.001, 0.02]']))
    assert complaints(found.after) == []
    assert 'lowered from' in found.reasons['controller.margin']
    assert found.after.law.design.epsilon >= LEAST * 0.02


@pytest.mark.parametrize(('overrides', 'capped'), [
    (('controller.gain_cap=40',), True), (('controller.gain_cap=120',), False)])
def test_a_cap_on_k_is_where_the_layer_begins(overrides, capped):
    """What is lowered is the K the law has, not one that its cap keeps away."""
    c = load_configuration('robust', [*overrides, 'controller.margin=0.9', 'controller.k_d=5'])
    found = with_layer(c, {'controller.margin': 0.9})
    assert suits(found)
    if capped:      # calm as it is
        assert found.law.gains.margin == 0.9
        assert found.law.design.gain == 40.0
    else:
        assert found.law.gains.margin < 0.9
        assert found.law.design.gain > 40.0


def test_no_k_is_calm_names_the_slope():
    c = load_configuration('robust', ['controller.lambda=300', 'controller.k_d=1'])
    assert steepest_gain(c) == 0.0
    with pytest.raises(ConfigurationError, match='no layer is wide enough') as caught:
        with_layer(c, {'controller.margin': 0.4})
    assert caught.value.key == 'controller.lambda'


def test_an_observer_that_no_rule_judges_is_named():
    found = tune(encoder('joint', 'driver.observer_kind=levant', 'driver.observer=60'))
    words = [item.words for item in found.findings if item.rule == 'observer']
    assert len(words) == 1
    assert 'no rule shows' in words[0]


def test_no_faster_observer_is_taken_of_a_kind_that_no_rule_judges():
    step = 2.0 * np.pi / 2 ** 17
    c = tune(encoder('joint', 'driver.observer_kind=levant', f'driver.resolution={step}')).after
    assert c.driver_settings.observer == 0.0


def test_share_found_is_the_largest_that_suits():
    c = encoder('joint', 'controller.law=robust', 'controller.k_2=8',
                'controller.k_d=4', 'controller.lambda=4', 'loop.delay=1')

    def made(share):
        return c.replace(**{'controller.margin': 0.9 * share})

    assert not suits(made(1.0))
    found = settled(made).law.gains.margin
    assert suits(c.replace(**{'controller.margin': found}))
    assert not suits(c.replace(**{'controller.margin': 1.01 * found}))
    # none suits: the steepest is kept, with its complaints
    hopeless = encoder('joint', 'controller.law=robust', 'driver.observer=2')
    assert settled(lambda share: hopeless.replace(**{
        'controller.margin': 0.5 * share})).law.gains.margin == 0.5


@pytest.mark.parametrize(('bits', 'faster'), [(17, True), (14, True), (12, False), (5, False),
                                              (0, False)])
def test_a_faster_observer_where_the_layer_gains_by_it_and_noise_leaves_v_calm(bits, faster):
    step = 2.0 * np.pi / 2 ** bits if bits else 0.0     # 0: nothing is known of it
    c = tune(encoder('joint', f'driver.resolution={step}')).after
    by_rule = c.replace(**{'driver.observer': 0.0})
    assert (c.driver_settings.observer > observer_of(by_rule).omega) == faster
    assert suits(c)
    if faster:
        gains, sigma = c.law.gains, step / np.sqrt(12.0)
        passes = noise_gain(Tracking.linear(c.driver_settings.observer, c.loop.period))
        assert gains.layer_gain * sigma * np.hypot(gains.lambda_, passes) <= 0.1 * gains.k_star
        assert not suits(by_rule)       # the rule's own is too slow for this layer
