# SPDX-License-Identifier: Apache-2.0
"""The certificate of the loop in its layer, against simulation and independent computations."""

import math

import numpy as np
import pytest

from dz_ros.core.design.certificate import bare, certify
from dz_ros.core.design.intervals import Jet, join, NotEnclosedError, Ways, with_jets
from dz_ros.core.design.linear_loop import loop_matrix
from dz_ros.core.design.loop_sums import loop_sums
from dz_ros.core.plants import PLANTS
from dz_ros.core.records import Reference, State
from dz_ros.core.tracking import error_weights
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.errors import ConfigurationError, MissingDependencyError
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.certified_runs import certificate_picture, random_runs, reached

flint = pytest.importorskip('flint')

SLOW = pytest.mark.slow
"""Computes a certificate, in intervals, for seconds."""
PERIOD = 'loop.duration=6.4'
"""One period of the example's reference."""


@pytest.fixture(scope='module')
def example():
    """Return the recommended configuration and its certificate for a delay of 0 and 1."""
    configuration = load_configuration('robust_eso', [PERIOD])
    return configuration, certify(configuration)


def ball(middle, radius):
    """Return a ball at a precision that is not the default."""
    return flint.arb(middle, radius)


def test_jet_encloses_derivatives_of_a_composed_function():
    def function(t):
        return math.tanh(0.5 * t) * math.sin(t) / (2.0 + math.cos(t)) + abs(t) ** 2

    enclosed = with_jets(function)(Jet([ball(0.7, 0.05), flint.arb(1)], Ways()))
    low, high = (join([[enclosed]])[0, :, side] for side in (0, 1))
    step = 1e-3
    for t in np.linspace(0.651, 0.749, 15):
        around = [function(t + k * step) for k in (-2, -1, 0, 1, 2)]
        derivatives = (around[2], (around[3] - around[1]) / (2 * step),
                       (around[3] - 2 * around[2] + around[1]) / step ** 2,
                       (around[4] - 2 * around[3] + 2 * around[1] - around[0])
                       / (2 * step ** 3))
        for j, value in enumerate(derivatives):
            assert low[j] - 1e-5 <= value <= high[j] + 1e-5


def test_open_comparison_is_answered_both_ways():
    ways = Ways()

    def function(t):
        return t if t > 0.0 else -2.0 * t

    jet = Jet([ball(0.0, 1.0), flint.arb(1)], ways)
    results = list(ways.results(lambda: [with_jets(function)(jet)]))
    ends = join(results)
    assert len(results) == 2
    assert ways.branched
    assert ends[0, 1, 0] <= -2.0 <= 1.0 <= ends[0, 1, 1]


def test_unknown_function_is_refused_by_name():
    def gamma(t):
        return math.gamma(t)

    with pytest.raises(NotEnclosedError, match='gamma'):
        with_jets(gamma)(Jet([flint.arb(1)], Ways()))


@pytest.mark.parametrize('name', sorted(PLANTS.all()))
def test_every_plant_is_enclosed(name):
    plant = PLANTS.load(name)()
    generator = np.random.default_rng(3)
    x = generator.uniform(0.2, 1.0, plant.order)
    ways = Ways()
    jets = [Jet([ball(float(item), 0.01)], ways) for item in x]
    enclosed = [0.0] * plant.regressor_count
    with_jets(plant.regressors)(jets, plant.constants, enclosed)
    force = with_jets(plant.disturbance)(Jet([ball(0.3, 0.01)], ways), jets, plant.constants)
    for _ in range(20):
        near = x + generator.uniform(-0.01, 0.01, plant.order)
        plain = [0.0] * plant.regressor_count
        plant.regressors(near, plant.constants, plain)
        for jet, value in zip([*enclosed, force], [*plain, plant.disturbance(
                0.3, near, plant.constants)], strict=True):
            part = jet.parts[0] if isinstance(jet, Jet) else flint.arb(jet)
            assert float(part.lower()) - 1e-12 <= value <= float(part.upper()) + 1e-12


@pytest.mark.parametrize('name', sorted(set(TRAJECTORIES.all()) - {'waypoints'}))
def test_every_trajectory_is_enclosed(name):
    trajectory = TRAJECTORIES.load(name)(order=2)
    for middle in (0.5, 1.0, 2.3, 7.9):
        ways = Ways()
        jet = Jet([ball(middle, 0.02), flint.arb(1)], ways)

        def follow(jet=jet):
            x_d = [0.0] * 3
            with_jets(trajectory.evaluate)(jet, trajectory.constants, x_d)
            return [item if isinstance(item, Jet) else Jet([flint.arb(item)], jet.ways)
                    for item in x_d]

        ends = join(list(ways.results(follow)))
        for t in np.linspace(middle - 0.02, middle + 0.02, 9):
            for i, value in enumerate(trajectory(float(t))):
                assert ends[i, 0, 0] - 1e-9 <= value <= ends[i, 0, 1] + 1e-9
                if i < 2:   # the derivative of one is the value of the next
                    assert ends[i, 1, 0] - 1e-6 <= trajectory(float(t))[i + 1] \
                        <= ends[i, 1, 1] + 1e-6


@pytest.mark.parametrize('delay', [0, 1, 2])
def test_sums_are_those_of_the_impulse_response(delay):
    law = load_configuration('robust_eso').law
    model, period, beta = law.layer_model(), 0.005, 1.0
    outputs = np.zeros((2, 2 + len(model.c)))
    outputs[0, 0] = 1.0
    outputs[1, :2] = error_weights(law.gains.lambda_, 2)
    found = loop_sums(model, period, beta, delay, outputs)
    matrix = loop_matrix(model, period, beta, delay)
    state = np.zeros(len(matrix))
    state[:2] = [beta * period ** 2 / 2.0, beta * period]
    impulse = []
    for _ in range(3000):
        impulse.append(outputs @ state[:outputs.shape[1]])
        state = matrix @ state
    impulse = np.array(impulse)
    step = np.cumsum(impulse, axis=0)
    for bound, plain in ((found.held[0], np.abs(impulse).sum(axis=0)),
                         (found.held[1], period * np.abs(step[-1] - step).sum(axis=0))):
        assert (bound >= plain * (1.0 - 1e-9)).all()
        assert bound == pytest.approx(plain, rel=1e-2)


@SLOW
def test_example_is_certified_tightly(example):
    _, found = example
    assert found.certified
    assert [item.delay for item in found.delays] == [0, 1]
    assert found.error_bound[0] <= 0.0006
    for item in found.delays:
        assert item.s_bound < item.epsilon


@SLOW
def test_robust_is_certified_on_the_example_too():
    found = certify(load_configuration('robust', [PERIOD]))
    assert found.certified
    assert [item.delay for item in found.delays] == [0, 1]
    assert found.error_bound[0] <= 0.003


@SLOW
@pytest.mark.parametrize('at', [0, 1])
def test_runs_inside_the_assumptions_stay_below_the_bound(example, at):
    configuration, found = example
    bounds = found.delays[at]
    most = np.zeros(2)
    for run in random_runs(configuration, found, bounds.delay, 1000, seed=7):
        most = np.maximum(most, reached(run))
    assert (most <= bounds.error_bound).all()
    assert most[0] >= 0.4 * bounds.error_bound[0]     # the bound is of use


@SLOW
def test_runs_of_robust_inside_the_assumptions_stay_below_its_bound_too():
    configuration = load_configuration('robust', [PERIOD])
    found = certify(configuration)
    for bounds in found.delays:
        most = np.zeros(2)
        for run in random_runs(configuration, found, bounds.delay, 1000, seed=7):
            most = np.maximum(most, reached(run))
        assert (most <= bounds.error_bound).all()


@SLOW
def test_constructed_input_comes_within_twice_the_bound(example):
    """The dead-zone's residual, switched by the sign of the impulse response, drives the law."""
    configuration, found = example
    law, period, beta = bare(configuration).law, 0.005, 0.85
    last = 600

    def drive(inputs):
        memory, x, errors = law.take_over(law.initial_memory()), np.zeros(2), []
        for k, push in enumerate(inputs):
            errors.append(x[0])
            command, memory, _ = law.step(memory, Reference(k, 0, (0.0,) * 3),
                                          State(k, 0, tuple(x)), (0.0, 0.0), period)
            force = beta * (command.v + push)
            x = np.array([x[0] + period * x[1] + 0.5 * period ** 2 * force,
                          x[1] + period * force])
        return np.array(errors)

    small = 1e-3
    impulse = drive([small, *([0.0] * last)])[1:] / small
    worst = 0.65 * np.sign(impulse[::-1])
    reached_by_it = abs(drive([*worst, 0.0])[last])
    bound = found.delays[0].error_bound[0]
    assert 0.5 * bound <= reached_by_it <= bound


@SLOW
def test_where_it_fails_the_proposed_gain_does():
    configuration = load_configuration('step', ['loop.duration=4'])
    found = certify(configuration, (1,)).delays[0]
    assert not found.certified
    assert 'is not within ε' in found.failed[0]
    gains = dict(part.split(' = ') for part in
                 found.change.partition(':')[0].replace(' with ', ';').split(';'))
    wider = configuration.replace(**{key: float(value) for key, value in gains.items()})
    assert certify(wider, (1,)).certified


@pytest.mark.parametrize('law', ['pd', 'fuzzy', 'exact_inverse', 'sliding_integral'])
def test_law_without_a_linear_layer_is_refused(law):
    configuration = load_configuration('wang2004', [f'controller.law={law}'])
    with pytest.raises(ConfigurationError, match='has no certificate'):
        certify(configuration)


def test_missing_library_is_one_line(monkeypatch):
    monkeypatch.setitem(__import__('sys').modules, 'flint', None)
    with pytest.raises(MissingDependencyError, match='python-flint'):
        certify(load_configuration('robust_eso'))


@SLOW
def test_picture_has_a_line_for_each_bound(example):
    configuration, found = example
    runs = [list(random_runs(configuration, found, item.delay, 2)) for item in found.delays]
    figure = certificate_picture(found, runs).figure
    for panel, item in zip(figure.axes, found.delays, strict=True):
        bound = next(line for line in panel.lines if line.get_gid() == 'bound')
        assert bound.get_ydata()[0] == item.error_bound[0]


@pytest.mark.slow
def test_an_axis_of_a_coupled_plant_reports_that_the_others_rest():
    found = certify(load_configuration('rov_planar').axis('yaw'), delays=(0,))
    assert any('other axes of the plant rest' in sentence for sentence in found.assumed)
    assert not any('other axes' in sentence for sentence in certify(
        load_configuration('robust_eso'), delays=(0,)).assumed)
