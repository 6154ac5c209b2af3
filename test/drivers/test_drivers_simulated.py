# SPDX-License-Identifier: Apache-2.0
"""The simulated actuator against the offline loop and an independent integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import simulate


@pytest.mark.parametrize('overrides', [
    {}, {'loop.delay': 2}, {'plant.command_limit': 5.0}, {'plant.noise': [0.001, 0.01]},
    {'plant.dead_zone.b_r_drift': [0.25, 0.9], 'plant.dead_zone.m_l': 0.5},
    {'plant.disturbance_pulse': [0.3, -20.0, 0.05], 'loop.delay': 1}])
def test_commands_at_the_samples_repeat_the_offline_loop(overrides):
    configuration = Configuration.from_flat({'loop.duration': 1.0, **overrides})
    run = simulate(configuration)
    actuator = configuration.make_driver()
    period = configuration.loop.period
    for k in range(len(run.t) - 1):
        assert actuator.measure() == tuple(run.x_measured[k])
        assert tuple(actuator.x) == tuple(run.x[k])
        actuator.command(float(run.v[k]), k * period)
        truth = actuator.advance((k + 1) * period, k)
        assert actuator.held == run.v_applied[k]
        assert (truth.w, truth.d, truth.disturbance) == tuple(run.truth[k])


def test_a_command_in_the_middle_of_a_sample_acts_from_there():
    configuration = Configuration.from_flat({'plant.substeps': 16})
    actuator = configuration.make_driver()
    actuator.command(3.0, 0.0)
    actuator.advance(0.005, 0)
    actuator.command(-4.0, 0.0071)
    actuator.advance(0.010, 1)
    zone = configuration.dead_zone

    def motion(t, x, v):
        accelerate = (np.tanh(x[0] / 2) - (x[0] ** 2 + 2 * x[0]) * np.sin(x[0])
                      - 0.5 * x[0] * np.sin(3 * t) + zone(v))
        return [x[1], accelerate]

    x = [-2.5, 3.5]
    for start, end, v in ((0.0, 0.0071, 3.0), (0.0071, 0.010, -4.0)):
        x = solve_ivp(motion, (start, end), x, args=(v,), rtol=1e-12, atol=1e-13).y[:, -1]
    assert actuator.x == pytest.approx(list(x), abs=1e-11)


def test_the_newest_of_several_commands_is_held():
    actuator = Configuration.from_flat({}).make_driver()
    actuator.command(1.0, 0.0)
    actuator.command(2.0, 0.0)
    actuator.advance(0.005, 0)
    assert actuator.held == 2.0


def test_several_periods_at_once_are_integrated_in_full():
    configuration = Configuration.from_flat({})
    together, apart = configuration.make_driver(), configuration.make_driver()
    for actuator in (together, apart):
        actuator.command(2.0, 0.0)
    together.advance(0.015, 0)
    for k in range(3):
        apart.advance((k + 1) * 0.005, k)
    assert together.x == pytest.approx(apart.x, abs=1e-13)


def test_a_pulse_may_be_given_while_it_runs():
    plain = Configuration.from_flat({})
    disturbed = plain.replace(**{'plant.disturbance_pulse': [0.5, 20.0, 0.05]})
    whole, later = (item.make_driver() for item in (disturbed, plain))
    for sample in range(200):
        if sample == 80:        # 0.4 s, before the pulse begins
            later.configure(disturbed)
        for driver in (whole, later):
            driver.command(0.3, sample * 0.005)
        one, other = (driver.advance((sample + 1) * 0.005, sample) for driver in (whole, later))
        assert one == other
        assert (one.disturbance < -15.0) == (100 <= sample < 110)
    assert whole.x == later.x


def test_commands_in_steps_are_those_of_the_offline_loop_bit_for_bit():
    c = Configuration.from_flat({'plant.command_resolution': 0.02, 'plant.command_limit': 8.0,
                                 'loop.delay': 1, 'loop.duration': 1.0})
    offline, driver = simulate(c), c.make_driver()
    for k in range(c.loop.samples):
        assert driver.measure() == tuple(offline.x[k])
        driver.command(offline.v[k], k * c.loop.period)
        driver.advance((k + 1) * c.loop.period, k)
    steps = offline.v_applied / 0.02
    assert np.abs(steps - np.round(steps)).max() < 1e-9
    assert np.abs(offline.v_applied).max() <= 8.0
