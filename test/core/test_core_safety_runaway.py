# SPDX-License-Identifier: Apache-2.0
"""The runaway guard: by itself, at the controller's end, and at the actuator's end."""

import math

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.controller import Controller, ViolationError
from dz_ros.core.plants import PLANTS
from dz_ros.core.records import Command, Reference, State
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.modes import Mode
from dz_ros.core.safety.runaway_guard import RunawayGuard
from dz_ros.core.safety.settings import SafetySettings

T = 0.005


def feed(guard, motion, v, samples=200):
    """Return the longest time that a guard gives; motion(t) is the speed, v(t) the command."""
    return max(guard.sample(k * T, v((k - 1) * T), (0.0, motion(k * T))) for k in range(samples))


def servo(**changes):
    plant = PLANTS.load('servo')
    return RunawayGuard(plant(plant.Parameters(viscous_friction=0.4, coulomb_friction=1.0)), T)


@pytest.mark.parametrize(('motion', 'v', 'seen'), [
    (lambda t: -3.0 * t, lambda _: 3.0, True),              # driven against the command
    (lambda t: 3.0 * t, lambda _: -3.0, True),              # … on the other side
    (lambda t: 3.0 * t, lambda _: 3.0, False),              # with it
    (lambda t: 2.0 - 2.0 * t, lambda _: -1.0, False),       # braked, then driven back
    (lambda t: -1.0 - 0.01 * t, lambda _: 0.0, False),      # nothing is commanded
    (lambda t: -3.0 * t, lambda t: 3.0 * (-1) ** round(t / T / 10), False),     # alternates
    (lambda t: 1e-3 * math.sin(1e3 * t), lambda _: 0.3, False),     # at rest, with noise
    (lambda t: -0.1 * t, lambda _: 3.0, False),     # what the model's friction would stop at once
    (lambda _: math.nan, lambda _: 3.0, False),
])
def test_only_a_device_that_gains_speed_against_its_command_runs_away(motion, v, seen):
    # -0.1 t: less than what half of the command would do, though friction resists it.
    lasted = feed(servo(), motion, v)
    assert (lasted > 0.5) == seen, lasted


def test_what_the_models_own_motion_explains_is_no_runaway():
    """A pendulum that falls on the side to which a weak command does not point."""
    plant = PLANTS.load('pendulum')()
    guard = RunawayGuard(plant, T)
    p, y, x, longest = plant.constants, [0.0] * plant.regressor_count, [1.0, 0.0], 0.0
    side = 0.0
    for k in range(100):
        plant.regressors(x, p, y)
        own = -sum(a * item for a, item in zip(plant.a, y, strict=True))
        side = side or -math.copysign(1.0, own)
        v = side * 0.2 * abs(own) / plant.b
        longest = max(longest, guard.sample(k * T, v, x))
        x = [x[0] + T * x[1], x[1] + T * (own + plant.b * v)]
    assert side * x[1] < 0.0        # it did gain speed against the command
    assert longest == 0.0


@pytest.mark.parametrize(('creep', 'rate', 'period'), [(1.88e-4, 2e-6, 0.01), (2.4e-4, 3e-6, 0.01),
                                                       (3.6e-4, 4e-6, 0.01), (3.6e-4, 4e-5, T)])
def test_a_device_that_creeps_inside_its_dead_zone_is_no_runaway(creep, rate, period):
    """Friction of the model would stop it at once; it creeps a little faster, that is no push.

    As a motor with cogging did, held inside the dead-zone while its law's command grew the other
    way from −1e−4 to −0.2.
    """
    plant = PLANTS.load('servo')
    guard = RunawayGuard(plant(plant.Parameters(viscous_friction=0.42, coulomb_friction=0.99)),
                         period)
    longest = 0.0
    for k in range(round(3.0 / period)):
        t = k * period
        v = -1e-4 * math.exp(min(t, 0.7) / 0.09) if t > 0.0 else 0.0
        x = (0.28 + creep * t, creep + rate * t)
        longest = max(longest, guard.sample(t, v, x))
    assert v < -0.2
    assert longest < SafetySettings().runaway_time


def test_a_device_of_the_wrong_sign_at_its_terminal_speed_is_one():
    """Viscous friction, which the model explains, keeps it from gaining speed for ever."""
    guard, speed, longest = servo(), 0.0, 0.0
    for k in range(round(30.0 / T)):
        longest = max(longest, guard.sample(k * T, 3.0, (0.0, speed)))
        speed += T * (-3.0 - (math.copysign(1.0, speed) if speed else 0.0) - 0.4 * speed)
    assert longest > 5.0


def test_a_gap_and_a_restart_begin_again():
    guard = servo()
    times = [k * T for k in range(60)] + [1.0 + k * T for k in range(60)]
    assert max(guard.sample(t, 3.0, (0.0, -3.0 * t)) for t in times) < 61 * T
    guard.restart()
    assert guard.sample(1.4, 3.0, (0.0, -5.0)) == 0.0


def reversed_loop(law, seconds, **changes):
    """Run a law on the mock whose commands act with the other sign from sample 200 on.

    Returns:
        The reason why the controller stopped, '' where it did not, and when [s].
    """
    c = Configuration.from_flat({
        'plant.model': 'servo', 'controller.law': law, 'driver.name': 'mock', 'driver.script':
        ['200- reversed'], 'trajectory.kind': 'sinusoid', 'safety.command_limit': 20.0, **changes})
    controller, device = Controller(c), c.make_driver()
    for k in range(round(seconds / T)):
        device.advance(k * T, k)
        x_d = [0.0] * 3
        c.trajectory.evaluate(k * T, c.trajectory.constants, x_d)
        controller.set_reference(Reference(k, k * T, tuple(x_d)))
        try:
            command, _ = controller.respond(State(k, k * T, device.measure(), k - 1, (k - 1) * T))
        except ViolationError as error:
            return str(error), k * T
        device.command(command.v, k * T)
    return '', seconds


@pytest.mark.parametrize('law', ['robust_eso', 'robust', 'wang2004', 'adaptive', 'pd',
                                 'pid'])
def test_the_controller_stops_a_device_whose_sign_turns(law):
    reason, at = reversed_loop(law, 4.0)
    assert reason.startswith('runaway: the device has gained speed against the command for 0.5')
    assert 200 * T + 0.5 <= at < 200 * T + 1.5


def test_only_the_operator_turns_it_off():
    reason, _ = reversed_loop('robust', 3.0, **{'safety.runaway_time': 0.0})
    assert reason == ''
    reason, at = reversed_loop('robust', 3.0, **{'safety.runaway_time': 0.1})
    assert ' s, safety.runaway_time = 0.1: ' in reason
    assert at < 200 * T + 0.6


def test_the_actuators_end_stops_as_well_and_stays_so_until_a_reset():
    plant = PLANTS.load('servo')()
    changes = []
    guard = ActuatorGuard(SafetySettings(), T, changed=changes.append, plants=[plant])
    for name in ('configure', 'activate'):
        guard.transition(name, 0.0)
    found = []
    for k in range(200):
        guard.command(Command(k, k * T, 3.0, k, k * T).numbers(), k, k * T)
        found.append(guard.measured((0.0, -3.0 * k * T), 3.0, k * T))
    stopped = next(k for k, v in enumerate(found) if v is not None)
    assert found[stopped] == guard.output == 0.0
    assert stopped * T == pytest.approx(0.5, abs=3 * T)
    assert guard.supervisor.mode is Mode.FAULT
    assert changes[-1].reason.startswith('runaway')
    assert guard.reset(200 * T) == ''
    assert guard.supervisor.mode is Mode.WAITING


def test_the_actuators_end_forgets_what_was_before_a_stop():
    guard = ActuatorGuard(SafetySettings(), T, plants=[PLANTS.load('servo')()])
    for name in ('configure', 'activate'):
        guard.transition(name, 0.0)
    for k in range(300):
        if k % 90 == 89:
            guard.end(k * T)
        else:
            guard.command(Command(k, k * T, 3.0, k, k * T).numbers(), k, k * T)
        assert guard.measured((0.0, -3.0 * k * T), 3.0, k * T) is None


@pytest.mark.parametrize(('behind', 'stops'), [(1, True), (2, True), (3, False), (20, False)])
def test_the_controllers_end_does_not_judge_by_commands_that_have_not_arrived(behind, stops):
    """A stalled actuator holds an old command; the newest reports nothing about what it does."""
    c = Configuration.from_flat({'plant.model': 'servo', 'controller.law': 'pd',
                                 'trajectory.kind': 'constant',
                                 'safety.command_limit': 3.0, 'safety.error_limit': 0.0})
    controller = Controller(c)

    def respond():
        for k in range(400):
            x_d = [0.0] * 3
            c.trajectory.evaluate(k * T, c.trajectory.constants, x_d)
            controller.set_reference(Reference(k, k * T, tuple(x_d)))
            # Away from the reference, ever faster, while v pushes towards it.
            speed = -8.0 * k * T
            command, _ = controller.respond(State(k, k * T, (0.5 * speed * k * T, speed),
                                                  k - behind, (k - behind) * T))
            assert k == 0 or command.v > 0.0

    if stops:
        with pytest.raises(ViolationError, match='runaway'):
            respond()
    else:
        respond()
