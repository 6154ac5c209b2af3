# SPDX-License-Identifier: Apache-2.0
"""The guard under noise: the rule ε >= 4 σ_s, and simulations on both sides of it."""

import math

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import INFO, WARNING
from dz_ros.core.design.guard_noise import check_guard, noise_in_s
from dz_ros.core.design.linear_loop import largest_beta
from dz_ros.core.design.observation import measured_steps
from dz_ros.core.design.rules import check
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.loop.offline import simulate
from dz_ros.core.signals import STATUS
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration


def noisy(law, ratio, **changes):
    """Return a configuration whose ε is that many σ_s, noise on the velocity alone."""
    c = Configuration.from_flat({'controller.law': law, 'loop.duration': 15.0, **changes})
    sigma = c.law.design.epsilon / ratio
    return c.replace(**{'plant.noise': [0.0, sigma]})


@pytest.mark.parametrize('law', ['robust', 'robust_eso'])
def test_the_rule_is_what_simulation_shows(law):
    kappas = []
    for ratio, level in ((4.5, INFO), (2.0, WARNING)):
        c = noisy(law, ratio)
        finding, = check_guard(c, 2, (0.0,))
        assert finding.level == level
        assert finding.numbers['ratio'] == pytest.approx(ratio)
        place = STATUS + 1 + list(c.law.signal_names).index('kappa_f')
        kappas.append(simulate(c).terms[-1, place])
    assert kappas[0] == 1.0
    assert kappas[1] < 1.0


@pytest.mark.parametrize('delay', [0, 1])
def test_near_its_limit_the_loop_amplifies_the_noise_and_the_guard_steps(delay):
    """One K and one noise, ε = 5.7 σ_s; only b m differs."""
    own = Configuration.from_flat({'controller.law': 'robust_eso', 'loop.delay': delay,
                                   'plant.noise': [1e-3, 1e-2], 'loop.duration': 15.0})
    limit = largest_beta(own.law.layer_model(), own.loop.period, delay)
    place = STATUS + 1 + list(own.law.signal_names).index('kappa_f')
    for share, level, least in ((0.6, INFO, 3.0), (0.96, WARNING, 0.0)):
        beta = share * limit
        c = own.replace(**{'plant.b': beta / own.dead_zone.m_r, 'controller.m_bounds': [1.0, 1.0],
                           'controller.b_bounds': [0.5 * limit, beta]})
        finding, = check_guard(c, 2, (0.0, 0.0))
        assert finding.level == level
        assert finding.numbers['ratio'] == pytest.approx(4.0 * math.sqrt(2.0))
        assert least <= finding.numbers['loop_ratio'] < least + 3.0
        kappas = [simulate(c.replace(**{'loop.seed': seed})).terms[-1, place] for seed in (0, 1)]
        assert (min(kappas) == 1.0) == (level == INFO)
        assert ('narrow the bounds of b m' in finding.change) == (level == WARNING)


def test_what_it_does_not_see_is_stated_by_dz_check():
    finding, = (item for item in check(Configuration.from_flat({'controller.law': 'robust_eso'}))
                if item.rule == 'guard')
    assert finding.level == INFO
    assert 'inside the layer it does not see' in finding.words
    assert not [item for item in check(Configuration.from_flat({})) if item.rule == 'guard']


def test_an_observed_velocity_passes_more_noise():
    c = Configuration.from_flat({'controller.law': 'robust_eso', 'plant.noise': [1e-4, 0.0],
                                 'driver.measured': 1})
    assert noise_in_s(c, 1, (0.0,)) > 10.0 * noise_in_s(c, 2, (0.0,))
    finding, = check_guard(c, 1, (6e-3,))
    assert finding.level == WARNING
    assert 'widen' in finding.change


STEPS = {'plant.model': 'servo', 'controller.law': 'robust_eso', 'plant.resolution': 1e-3,
         'plant.derivative_resolution': [0.01], 'loop.duration': 3.0}


def test_steps_of_each_measured_state_are_noise_in_s():
    c = Configuration.from_flat(STEPS)
    finding, = (item for item in check(c) if item.rule == 'guard')
    lambda_ = c.law.design.lambda_
    assert finding.numbers['noise'] == pytest.approx(
        math.hypot(lambda_ * 1e-3, 0.01) / math.sqrt(12.0))
    assert 'measurement noise (v shows' in ' '.join(item.words for item in check(c))
    # A device that states its steps is judged as the simulated one that has them.
    device = c.replace(**{'plant.resolution': 0.0, 'plant.derivative_resolution': [],
                          'driver.resolution': 1e-3, 'driver.derivative_resolution': [0.01]})
    assert [item for item in check(device) if item.rule == 'guard'] == [finding]


def test_steps_of_what_a_third_state_is_observed_from_are_noise_in_s():
    sigma = 1e-3
    flat = {'plant.model': 'valve_actuator', 'controller.law': 'robust_eso', 'driver.measured': 2}
    ways = ({'plant.derivative_resolution': [sigma * math.sqrt(12.0)]},
            {'plant.noise': [0.0, sigma, 0.0]})
    findings = []
    for way in ways:
        c = Configuration.from_flat(flat | way)
        findings.append(next(check_guard(c, 2, measured_steps(c.make_driver()))).numbers)
    assert findings[0]['noise'] == pytest.approx(findings[1]['noise'])
    assert findings[0].get('loop_noise') == pytest.approx(findings[1].get('loop_noise'))


def test_where_the_loop_is_not_calm_that_is_stated():
    c = Configuration.from_flat({'controller.law': 'robust_eso', 'loop.delay': 2,
                                 'plant.noise': [1e-3, 1e-2]})
    finding, = check_guard(c, 2, (0.0, 0.0))
    assert finding.level == INFO        # the rule of chatter warns
    assert 'the closed loop is not calm at b m = ' in finding.words
    c = c.replace(**{'controller.layer_gain': 1e308})
    assert any(item.rule == 'chatter' for item in check(c))


@pytest.mark.parametrize('fast', [False, True])
def test_the_simulated_sensor_counts_each_state_in_its_steps(fast):
    if fast:
        pytest.importorskip('numba', reason='numba is not installed')
    c = Configuration.from_flat(STEPS)
    run = (simulate_fast if fast else simulate)(c)
    for i, step in enumerate((1e-3, 0.01)):
        counts = run.x_measured[:, i] / step
        assert np.abs(counts - np.round(counts)).max() < 1e-9
        assert np.abs(run.x_measured[:, i] - run.x[:, i]).max() <= 0.5000001 * step
    device = c.make_driver()
    device.advance(0.0, 0)
    assert device.derivative_resolution == (0.01,)
    device.x[:] = [0.0126, 0.0374]
    assert device.measure() == pytest.approx((0.013, 0.04))


def test_drives_state_the_steps_of_what_they_measure():
    c = load_configuration('cia402', [])
    drive = c.make_driver()
    counts = c.driver_parameters.counts_per_rev * c.driver_parameters.gear
    assert drive.resolution == pytest.approx(c.driver_parameters.unit_per_rev / counts)
    speed = (c.driver_parameters.velocity_counts
             or c.driver_parameters.counts_per_rev) * c.driver_parameters.gear
    assert drive.derivative_resolution == pytest.approx(
        (c.driver_parameters.unit_per_rev / speed,))
    pytest.importorskip('serial', reason='pyserial is not installed')
    board = load_configuration('serial', ['driver.state_scales=[0.001, 0.02]']).make_driver()
    assert (board.resolution, *board.derivative_resolution) == (0.001, 0.02)


def test_more_steps_than_states_are_refused():
    with pytest.raises(ConfigurationError, match='at most 1 values for servo'):
        Configuration.from_flat({**STEPS, 'plant.derivative_resolution': [0.01, 0.1]})
