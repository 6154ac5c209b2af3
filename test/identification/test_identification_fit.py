# SPDX-License-Identifier: Apache-2.0
"""Plants estimated from simulated logs, where the truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, from_run, RunData
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants import PLANTS
from dz_ros.core.records import Command, State
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.identification.estimation.least_squares import solve, Stack
from dz_ros.identification.estimation.physical_parameters import (
    parameters_with,
    parameters_with_gain,
)
from dz_ros.identification.estimation.pipeline import fit_log
from dz_ros.identification.estimation.stretches import Cutter
from dz_ros.identification.samples import arrivals
from dz_ros.identification.samples import from_run as as_samples

NOISY = {'loop.duration': 8.0, 'plant.noise': [1e-3, 1e-2]}


def configured(**changes):
    return Configuration.from_flat({**NOISY, **changes})


def truth(c):
    zone = c.dead_zone
    return [*c.plant.a, zone.b_r, zone.b_l, c.plant.b * zone.m_r, c.plant.b * zone.m_l]


@pytest.mark.slow
def test_confidence_intervals_hold_the_truth_as_often_as_they_report():
    """Six parameters, four noises: of 24 intervals of 95 % at least 20 (fewer: 0.6 %)."""
    inside = 0
    for seed in range(4):
        c = configured(**{'loop.seed': seed, 'plant.a1': 1.3, 'plant.b': 0.8,
                          'plant.dead_zone.m_r': 1.1, 'plant.dead_zone.m_l': 0.9})
        wrong = c.replace(**{'plant.a1': 1.0, 'plant.dead_zone.m_r': 1.0,
                             'plant.dead_zone.m_l': 1.0, 'plant.dead_zone.b_r': 0.2,
                             'plant.dead_zone.b_l': -0.3})
        fit = fit_log(from_run(simulate(c)), wrong)
        assert fit.residual == pytest.approx([1e-3, 1e-2], rel=0.1)
        for item, value in zip(fit.estimates, truth(c), strict=True):
            inside += abs(item.value - value) <= item.half_width
            assert item.half_width < 0.15
            assert abs(item.value - value) < 4.0 * item.half_width
    assert inside >= 20


@pytest.mark.parametrize('model', ['servo', 'first_order', 'pendulum', 'zhang_feng1997'])
def test_every_model_without_noise_is_exact(model):
    c = configured(**{'plant.model': model, 'plant.noise': [0.0], 'loop.duration': 4.0})
    run = from_run(simulate(c))
    fit = fit_log(run, c.replace(**{'plant.dead_zone.b_r': 0.3, 'plant.dead_zone.b_l': -0.4}))
    for item, value in zip(fit.estimates, truth(c), strict=True):
        if item.seen:
            assert item.value == pytest.approx(value, rel=1e-4), item
    assert fit['b·m_r'].seen
    assert fit['b·m_l'].seen


def test_delay_limit_and_round_trip_report_when_a_command_acts():
    c = configured(**{'loop.delay': 2, 'plant.command_limit': 8.0, 'plant.noise': [0.0]})
    done = simulate(c)
    times, commands = arrivals(from_run(done), c, c.loop.delay)
    assert max(map(abs, commands)) == 8.0
    for begin, held in ((0.0, 0.0), (0.01, done.v_applied[2]), (1.0, done.v_applied[200])):
        found = [v for at, v in zip(times, commands, strict=True) if at <= begin + 1e-9]
        assert (found[-1] if found else 0.0) == held
    fit = fit_log(from_run(done), c)
    assert [item.value for item in fit.estimates] == pytest.approx(truth(c), rel=1e-6)


def test_commands_in_the_middle_of_a_sample():
    """A plant moved by commands that arrive late, as over topics; the driver is the judge."""
    c = configured(**{'loop.duration': 6.0, 'plant.noise': [0.0]})
    generator = np.random.default_rng(3)
    actuator, period = c.make_driver(), c.loop.period
    states, commands, trip = [], [], 0.0
    for k in range(1200):
        if k:
            actuator.advance(k * period, k - 1)
        x = actuator.measure()
        states.append(State(k, k * period, x, k - 1, (k - 1) * period, trip).numbers())
        v = 3.0 * np.sin(0.7 * k * period) - 4.0 * x[0] - 2.0 * x[1]
        commands.append(Command(k, k * period, v, k, k * period, 0.0).numbers())
        trip = generator.uniform(0.0, 0.9) * period
        actuator.command(v, k * period + trip)
    times = np.arange(1200)
    run = RunData({'state': Channel(State.labels(2), np.array(states), times, times),
                   'command': Channel(Command.labels(), np.array(commands), times, times)})
    fit = fit_log(run, c)
    assert [item.value for item in fit.estimates] == pytest.approx(truth(c), rel=1e-4)
    assert max(fit.residual) < 1e-6


def test_what_the_log_does_not_show_is_kept_and_marked():
    c = configured(**{'trajectory.amplitude': 0.0, 'plant.x0': [-1.0, 0.0], 'plant.noise': [0.0],
                      'loop.duration': 3.0, 'plant.dead_zone.b_l': -50.0,
                      'controller.b_l_bounds': [-60.0, -0.1]})
    fit = fit_log(from_run(simulate(c)), c.replace(**{'plant.dead_zone.b_l': -49.0}))
    assert not fit['b_l'].seen
    assert not fit['b·m_l'].seen
    assert fit['b_l'].value == -49.0
    assert fit['b_r'].seen


def test_least_squares_give_a_start_that_is_near():
    c = configured()
    found = Cutter(as_samples(from_run(simulate(c)), c), c).everything()
    line = solve(Stack(found, c.loop.period, 1))
    assert [*line.a[:2], *line.zone[0]] == pytest.approx(truth(c), rel=0.3)


def test_stretches_share_no_state_and_end_at_holes():
    c = configured(**{'plant.noise': [0.0]})
    run = from_run(simulate(c))
    state = run.channels['state']
    keep = np.setdiff1d(np.arange(len(state)), [300, 301])
    cut = replace(run, channels={**run.channels, 'state': Channel(
        state.labels, state.values[keep], state.log_time[keep], state.publish_time[keep])})
    samples = as_samples(cut, c)
    found = Cutter(samples, c).everything()
    rows = [row for item in found for row in range(item.rows[0], item.rows[1] + 1)]
    assert len(set(rows)) == len(rows) <= len(keep)
    for item in found:
        assert np.ptp(samples.seq[item.rows[0]:item.rows[1] + 1]) == item.rows[1] - item.rows[0]
        for row in range(*item.rows):
            assert sum(span for _, span, _ in samples.held(row)) == pytest.approx(c.loop.period)


@pytest.mark.parametrize('names', [('state',), ('command',), ()])
def test_too_little_to_fit(names):
    c = configured(**{'loop.duration': 1.0})
    run = from_run(simulate(c))
    with pytest.raises(RecordingError, match='cannot be identified'):
        fit_log(replace(run, channels={name: run.channels[name] for name in names}), c)


def test_too_short_to_fit():
    c = configured(**{'loop.duration': 0.1})
    with pytest.raises(RecordingError, match='cannot be identified'):
        fit_log(from_run(simulate(c)), c)


@pytest.mark.parametrize('model', list(PLANTS.builtin))
def test_physical_parameters_for_given_constants(model):
    plant = PLANTS.builtin[model]()
    wanted = [value * factor for value, factor in zip(plant.a, (1.1, 1.05, 1.02), strict=False)]
    keys = parameters_with(plant, wanted)
    made = Configuration.from_flat({'plant.model': model, **keys}).plant
    assert made.a == pytest.approx(wanted, rel=1e-9)
    assert made.b == pytest.approx(plant.b, rel=1e-9)
    assert made.extra == pytest.approx(plant.extra, rel=1e-9)


def test_only_what_must_change_changes():
    keys = parameters_with(PLANTS.builtin['servo'](), (0.6, 1.5))
    changed = {key for key, value in keys.items()
               if value != PLANTS.builtin['servo']().parameters.__dict__[key[6:]]}
    assert changed == {'plant.viscous_friction', 'plant.coulomb_friction'}


def test_constants_no_model_parameters_give():
    with pytest.raises(ConfigurationError, match='no allowed parameters'):
        parameters_with(PLANTS.builtin['servo'](), (-0.6, 1.5))


def test_another_input_gain_is_another_mass_or_another_force_constant():
    plant = PLANTS.builtin['axis']()
    ways = parameters_with_gain(plant, plant.a, 2.0 * plant.b)
    assert len(ways) == 2
    mass, force = sorted(ways, key=len, reverse=True)
    before = schema.to_dict(plant.parameters)
    assert mass['plant.mass'] == pytest.approx(0.5 * before['mass'])
    assert mass['plant.viscous_friction'] == pytest.approx(0.5 * before['viscous_friction'])
    assert force == {'plant.force_constant': pytest.approx(2.0 * before['force_constant'])}
