# SPDX-License-Identifier: Apache-2.0
"""The controller's rules on intervals, references and repeated states."""

import math

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.controller import accepted_interval, Controller
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Reference, State, Status

T = 0.005


@pytest.fixture
def configuration():
    return Configuration.from_flat({'loop.duration': 1.0})


def reference(configuration, k, stamp=None):
    stamp = k * T if stamp is None else stamp
    return Reference(k, stamp, configuration.trajectory(stamp))


def test_repeats_the_offline_loop_bit_for_bit(configuration):
    run = simulate(configuration)
    controller = Controller(configuration)
    for k in range(len(run.t)):
        controller.set_reference(reference(configuration, k))
        command, terms = controller.respond(State(k, k * T, tuple(run.x[k])))
        assert command.v == run.v[k]
        assert (*terms.values, terms.status, *terms.signals) == tuple(run.terms[k])
        assert (command.seq, command.echo_seq, command.stamp) == (k, k, k * T)
        assert controller.error == run.x[k, 0] - run.x_d[k, 0]


@pytest.mark.parametrize(('interval', 'expected'), [
    (T, T), (T + 5e-10, T), (2 * T, 2 * T), (0.5 * T, 0.5 * T), (0.49 * T, 0.0),
    (2.01 * T, 0.0), (0.0, 0.0), (-T, 0.0), (1.5 * T, 1.5 * T)])
def test_accepted_interval(interval, expected):
    assert accepted_interval(1.0, 1.0 + interval, T) == pytest.approx(expected, abs=1e-12)
    if expected == T:
        assert accepted_interval(1.0, 1.0 + interval, T) == T


def test_adaptation_advances_by_the_accepted_interval_and_freezes_outside(configuration):
    def phi_steps(stamps):
        controller = Controller(configuration)
        steps = []
        for k, stamp in enumerate(stamps):
            controller.set_reference(reference(configuration, k, stamp))
            before = controller.memory
            _, terms = controller.respond(State(k, stamp, (-2.5, 3.5)))
            steps.append((controller.memory[-1] - before[-1], terms))
        return steps

    (_, _), (one, first), (two, second), (none, third) = phi_steps(
        [0.0, T, 3 * T, 10 * T])
    assert (first.dt, second.dt, third.dt) == (T, pytest.approx(2 * T), 0.0)
    assert third.status == Status.BAD_INTERVAL
    assert none == 0.0
    rate = -configuration.law.gains.eta * first.values[1] * first.values[2]
    assert one == pytest.approx(T * rate, rel=1e-12)
    rate = -configuration.law.gains.eta * second.values[1] * second.values[2]
    assert two == pytest.approx(2 * T * rate, rel=1e-12)


def test_without_reference_there_is_no_answer(configuration):
    with pytest.raises(LookupError):
        Controller(configuration).respond(State(0, 0.0, (0.0, 0.0)))


def test_missing_reference_is_brought_to_the_stamp_by_its_derivatives(configuration):
    controller = Controller(configuration)
    controller.set_reference(reference(configuration, 100))
    _, terms = controller.respond(State(101, 101 * T, (0.0, 0.0)))
    exact = configuration.trajectory(101 * T)
    # Taylor remainders for 2.5 sin t: A T³/6 in x_d, A T²/2 in x_d', λ = 1.
    bound = 2.5 * (T ** 3 / 6 + T ** 2 / 2)
    assert abs(terms.values[0] - (-exact[0] - exact[1])) <= bound
    assert terms.status == Status.ADAPTING


def test_a_reference_too_old_freezes_adaptation(configuration):
    controller = Controller(configuration)
    controller.set_reference(reference(configuration, 0))
    _, terms = controller.respond(State(3, 3 * T, (0.0, 0.0)))
    assert terms.status & Status.STALE_REFERENCE
    assert terms.dt == 0.0


def test_the_reference_of_the_next_sample_does_not_hide_this_one(configuration):
    controller = Controller(configuration)
    for k in (5, 6):
        controller.set_reference(reference(configuration, k))
    _, terms = controller.respond(State(5, 5 * T, (0.0, 0.0)))
    exact = configuration.trajectory(5 * T)
    assert terms.values[0] == pytest.approx(-exact[0] - exact[1], abs=1e-15)


def test_repeated_states_get_the_same_command_and_older_ones_none(configuration):
    controller = Controller(configuration)
    controller.set_reference(reference(configuration, 1))
    first = controller.respond(State(1, T, (1.0, 1.0)))
    memory = controller.memory
    assert controller.respond(State(1, T, (9.0, 9.0))) == first
    assert controller.respond(State(2, 2 * T, (1.0, 1.0))) is not None
    after = controller.memory
    assert after != memory
    assert controller.respond(State(1, T, (1.0, 1.0))) is None
    assert controller.memory == after
    assert controller.ignored == {'repeated': 1, 'out_of_order': 1, 'not_finite': 0}


def test_a_plant_that_starts_again_is_answered_with_adaptation_frozen_once(configuration):
    controller = Controller(configuration)
    controller.set_reference(reference(configuration, 0))
    controller.respond(State(7, 7 * T, (1.0, 1.0)))
    memory = controller.memory
    _, terms = controller.respond(State(0, 0.0, (1.0, 1.0)))
    assert terms.status == Status.BAD_INTERVAL
    assert controller.memory == memory
    _, terms = controller.respond(State(1, T, (1.0, 1.0)))
    assert terms.status == Status.ADAPTING


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_reach_neither_command_nor_estimates(configuration, bad):
    controller = Controller(configuration)
    controller.set_reference(Reference(0, 0.0, (bad, 0.0, 0.0)))
    assert not controller.has_reference
    controller.set_reference(reference(configuration, 0))
    assert controller.respond(State(0, 0.0, (bad, 0.0))) is None
    assert controller.memory == configuration.law.initial_memory()
    assert controller.ignored['not_finite'] == 2


def test_taylor_of_a_polynomial_reference_is_exact():
    coefficients = np.polynomial.Polynomial([1.0, -2.0, 0.5])
    reference = Reference(0, 1.0, tuple(float(coefficients.deriv(i)(1.0)) for i in range(3)))
    moved = reference.at(1.5)
    assert moved.x_d == pytest.approx([coefficients.deriv(i)(1.5) for i in range(3)], rel=1e-14)
