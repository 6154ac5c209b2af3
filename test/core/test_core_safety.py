# SPDX-License-Identifier: Apache-2.0
"""Guards, limiter, watchdogs and states one by one."""

import itertools
import math

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.controller import Controller
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Reference, State, Status
from dz_ros.core.safety.controller_guard import ControllerGuard, REPEATS
from dz_ros.core.safety.modes import Mode
from dz_ros.errors import ConfigurationError

T = 0.005


# --- the actuator's end

class Loop:
    """A controller's guard fed with the offline loop's states and references."""

    def __init__(self, **settings):
        keys = {key.replace('__', '.'): value for key, value in settings.items()}
        self.configuration = Configuration.from_flat({
            'loop.duration': 2.0, 'safety.fault_after': 80, **keys})
        self.run = simulate(self.configuration)
        self.begun = []
        self.guard = ControllerGuard(self.configuration,
                                     begins=lambda *what: self.begun.append(what))
        for name in ('configure', 'activate'):
            self.guard.transition(name)
        self.now = 100.0

    def reference(self, k):
        self.guard.reference((k, k * T, *map(float, self.run.x_d[k])), self.now)

    def state(self, k, echo=None, **changes):
        self.now += T
        state = State(k, k * T, tuple(map(float, self.run.x[k])),
                      k - 1 if echo is None else echo, (k - 1) * T)
        numbers = list(state.numbers())
        for place, value in changes.items():
            numbers[int(place[1:])] = value
        taken = self.guard.take(numbers, self.now)
        return None if taken is None else self.guard.answer(taken, self.now)

    def play(self, first, last):
        answers = []
        for k in range(first, last):
            self.reference(k)
            answers.append(self.state(k))
        return answers

    @property
    def mode(self):
        return self.guard.supervisor.mode


def test_a_healthy_run_is_the_offline_loops_bit_for_bit():
    loop = Loop()
    answers = loop.play(0, 401)
    assert [command.v for command, _ in answers] == loop.run.v.tolist()
    assert loop.begun == [(0, loop.configuration.law.initial_memory())]


def test_silence_of_states_is_answered_with_the_safe_command_by_itself():
    loop = Loop()
    loop.play(0, 50)
    memory = loop.guard.controller.memory
    assert loop.guard.poll(loop.now + 3 * T) is None
    sent = [loop.guard.poll(loop.now + (3.1 + k) * T) for k in range(20)]
    commands = [item[0] for item in sent if item]
    assert len(commands) == REPEATS
    assert {command.v for command in commands} == {0.0}
    assert [command.seq for command in commands] == list(range(50, 50 + REPEATS))
    assert loop.mode is Mode.LOST
    loop.guard.poll(loop.now + 84 * T)
    assert (loop.mode, loop.guard.supervisor.reason) == (Mode.FAULT, 'no state')
    _, terms = loop.play(50, 51)[0]
    assert (terms.status, terms.dt, terms.values[-1]) == (Status.INACTIVE, 0.0, 0.0)
    assert loop.guard.controller.memory == memory


def test_without_references_it_extrapolates_then_stops_then_faults():
    loop = Loop()
    loop.play(0, 50)
    modes = []
    for k in range(50, 160):
        loop.state(k)
        modes.append(loop.mode)
    assert modes.index(Mode.LOST) == 20
    assert modes.index(Mode.FAULT) == 20 + 81
    assert loop.guard.supervisor.reason == 'no reference'
    assert 'trajectory' in loop.guard.reset(loop.now)
    loop.play(160, 162)
    assert loop.guard.reset(loop.now) == ''
    loop.play(162, 165)
    assert loop.mode is Mode.RUNNING
    assert loop.begun[-1][0] == 162


def test_a_plant_that_takes_no_commands_stops_the_law():
    loop = Loop()
    loop.play(0, 50)
    for k in range(50, 80):
        loop.reference(k)
        loop.state(k, echo=49)
    assert (loop.mode, loop.guard.supervisor.reason) == (
        Mode.LOST, 'the actuator does not take the commands')
    loop.reference(80)
    loop.state(80, echo=79)
    assert loop.mode is Mode.RUNNING


@pytest.mark.parametrize('changes', [
    {'_2': math.nan}, {'_3': math.inf}, {'_0': 3.0}, {'_0': 1e6}, {'_1': 1e3}, {'_5': math.nan}])
def test_bad_states_reach_neither_command_nor_estimates(changes):
    loop = Loop()
    loop.play(0, 50)
    memory = loop.guard.controller.memory
    assert loop.state(50, **changes) is None
    assert loop.guard.controller.memory == memory
    assert sum(loop.guard.state_guard.rejected().values()) == 1
    assert loop.play(51, 52)[0] is not None


@pytest.mark.parametrize(('key', 'limit', 'words'), [
    ('safety__error_limit', 0.05, 'error'), ('safety__theta_limit', 0.851, 'theta'),
    ('safety__phi_limit', 0.86, 'phi')])
def test_limits_on_error_and_estimates_are_faults(key, limit, words):
    loop = Loop(**{key: limit, 'controller__phi_0': -0.85 if words == 'phi' else 0.85})
    shift = (1.0, 0.0) if words == 'error' else (0.0, 0.0)
    for k in range(200):
        loop.reference(k)
        x = tuple(float(a) + b * k / 100 for a, b in zip(loop.run.x[k], shift, strict=True))
        loop.state(k, _2=x[0])
    assert loop.mode is Mode.FAULT
    assert loop.guard.supervisor.reason.startswith(('error', 'estimate'))
    assert words in loop.guard.supervisor.reason
    names = loop.configuration.law.signal_names
    for name, value in zip(names, loop.guard.controller.memory, strict=True):
        assert not name.startswith(words) or abs(value) <= limit


def test_a_law_that_diverges_is_a_fault_and_its_memory_stays_finite():
    loop = Loop()
    loop.play(0, 10)
    command, _ = loop.state(10, _3=1e308)
    assert command.v == 0.0
    assert loop.mode is Mode.FAULT
    assert all(map(math.isfinite, loop.guard.controller.memory))


def test_saturation_against_s_freezes_the_estimates_and_reports_it():
    loop = Loop(safety__command_limit=5.0)
    answers = loop.play(0, 100)
    saturated = [(command, terms) for command, terms in answers
                 if terms.status & Status.SATURATED]
    assert saturated
    for command, terms in saturated:
        assert abs(command.v) == 5.0
        assert terms.dt == 0.0
        assert command.v * terms.values[0] < 0.0
    k = answers.index(saturated[0])
    assert answers[k + 1][1].signals == answers[k][1].signals


@pytest.mark.parametrize('estimates', ['keep', 'reset', 'restore'])
def test_estimates_are_kept_reset_or_restored(estimates):
    loop = Loop(safety__estimates=estimates, loop__duration=4.0)
    memories = []
    for k in range(700):
        memories.append(loop.guard.controller.memory)
        loop.play(k, k + 1)
    loop.guard.estop()
    loop.guard.estop(pressed=False)
    stopped = loop.guard.controller.memory
    assert loop.guard.reset(loop.now) == ''
    loop.play(700, 702)
    memory = loop.begun[-1][1]
    if estimates == 'restore':
        assert memory in memories[700 - round(2.1 / T):700 - round(1.0 / T)]
    else:
        assert memory == (stopped if estimates == 'keep'
                          else loop.configuration.law.initial_memory())


def test_deactivation_gives_the_safe_command_and_activation_starts_from_it():
    loop = Loop(safety__rate_limit=10.0)
    loop.play(0, 100)
    sent = loop.guard.transition('deactivate')
    assert len(sent) == REPEATS
    for command, terms in sent:
        assert (command.v, terms.status) == (0.0, Status.INACTIVE)
    assert loop.play(100, 101) == [None]
    loop.guard.transition('activate')
    after = [command.v for command, _ in loop.play(200, 260)]
    assert abs(after[0]) <= 10.0 * T + 1e-12
    assert max(abs(b - a) for a, b in itertools.pairwise(after)) <= 10.0 * T + 1e-9


def test_gains_change_between_two_samples():
    loop = Loop()
    loop.play(0, 100)
    changed = loop.configuration.replace(**{'controller.k_d': 20.0})
    loop.guard.configure(changed)
    loop.reference(100)
    command, terms = loop.state(100)
    assert terms.values[3] == -20.0 * terms.values[0]
    assert command.seq == 100


@pytest.mark.parametrize(('key', 'value', 'words'), [
    ('safety.safe_command', 2.0, 'command_limit'), ('safety.fault_after', 2, 'command_hold'),
    ('safety.estimates', 'guess', 'one of keep'), ('safety.ramp', -1.0, '>= 0')])
def test_limits_that_contradict_each_other_are_refused(key, value, words):
    with pytest.raises(ConfigurationError, match=words):
        Configuration.from_flat({'safety.command_limit': 1.0, key: value})


def test_the_section_survives_the_round_trip():
    configuration = Configuration.from_flat({'safety.command_limit': 3.0})
    assert Configuration.from_flat(configuration.to_flat()).safety == configuration.safety


def test_the_bare_controller_has_the_same_bounds():
    configuration = Configuration.from_flat({'safety.command_limit': 4.0})
    controller = Controller(configuration)
    controller.set_reference(Reference(0, 0.0, configuration.trajectory(0.0)))
    command, _ = controller.respond(State(0, 0.0, (-2.5, 3.5)))
    assert command.v == 4.0
