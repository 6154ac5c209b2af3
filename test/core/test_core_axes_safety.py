# SPDX-License-Identifier: Apache-2.0
"""Both ends of a loop of several axes, without ROS: the offline numbers, and what faults do."""

from __future__ import annotations

import math

import pytest

from dz_ros.core.axes import Rows
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.records import Command, Reference, State
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.controller_guard import ControllerGuard
from dz_ros.core.safety.modes import LifecycleState, Mode
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.drivers.hosted_axes import host, HostedDrivers

T = 0.005
THREE = {'loop.axes': ['surge', 'sway', 'yaw'], 'loop.duration': 0.5, 'loop.timing': 'lockstep',
         'axes.sway.plant.dead_zone.b_r': 0.2, 'axes.yaw.controller.lambda': 2.0,
         'axes.surge.trajectory.amplitude': 1.5, 'plant.noise': [0.001, 0.01]}
SPRINGS = {'loop.axes': ['left', 'right'], 'loop.duration': 0.5, 'loop.timing': 'lockstep',
           'plant.model': 'test_core_axes:Springs', 'controller.law': 'test_core_axes:Both',
           'axes.right.plant.x0': [-0.3, 0.0], 'loop.delay': 1, 'plant.command_limit': 3.0,
           'plant.command_resolution': 0.01, 'plant.disturbance_pulse': [0.1, 2.0, 0.05],
           'axes.left.plant.backlash': 0.2}


class Machine:
    """Both ends, a driver and the trajectories, as the nodes hold them in lockstep."""

    def __init__(self, flat):
        self.c = c = Configuration.from_flat(flat)
        self.changes, self.begun = [], []
        several = len(c.axes) > 1
        limits = [item.safety for item in c.each] if several else c.safety
        watch = c.loop.timing == 'realtime'
        self.controller = ControllerGuard(c, self.changes.append,
                                          lambda *begins: self.begun.append(begins))
        self.actuator = ActuatorGuard(limits, T, watch, self.changes.append, c.axis_names)
        self.hosted = host(c)
        self.hosted.open()
        self.hosted.enable()
        for guard in (self.controller, self.actuator):
            guard.supervisor.transition('configure')
            guard.supervisor.transition('activate')
        self.k = 0
        self.truth = None

    def state(self):
        measured = self.hosted.measure(self.k * T)
        echo = self.actuator.taken
        details = (echo.seq, echo.stamp) if echo is not None else (-1, 0.0)
        return Rows(State(self.k, self.k * T, x, *details) for x in measured)

    def references(self):
        t = self.k * T
        return Rows(Reference(self.k, t, tuple(item.trajectory(t))) for item in self.c.each)

    def step(self, state=None, reference=None):
        """Answer a sample; return the answer of the controller."""
        t = self.k * T
        self.controller.reference((reference or self.references()).numbers(), t)
        taken = self.controller.take((state or self.state()).numbers(), t)
        if taken is None or not self.controller.ready(taken):
            return None
        answer = self.controller.answer(taken, t)
        v = self.actuator.command(answer[0].numbers(), self.k, t)
        if v is not None:
            (self.hosted.command if self.actuator.supervisor.running
             else self.hosted.safe)(v, t)
        self.truth = self.hosted.advance((self.k + 1) * T, self.k)
        self.k += 1
        return answer


@pytest.mark.parametrize('flat', [THREE, SPRINGS], ids=['independent', 'coupled'])
def test_lockstep_is_offline_bit_for_bit_for_every_axis(flat, monkeypatch):
    monkeypatch.syspath_prepend(str(__import__('pathlib').Path(__file__).parent))
    machine = Machine(flat)
    runs = simulate_axes(machine.c)
    for k in range(machine.c.loop.samples):
        command, terms = machine.step()
        for row, name in enumerate(machine.c.axis_names):
            run = runs[name]
            assert command[row].v == run.v[k], (k, name)
            assert terms[row].values == tuple(run.terms[k, :len(terms[row].values)])
            assert (machine.truth[row].w, machine.truth[row].d,
                    machine.truth[row].disturbance) == tuple(run.truth[k]), (k, name)
            assert tuple(machine.hosted.each[row].driver.x) == tuple(run.x[k + 1])


def test_one_axis_in_fault_stops_all_and_is_named():
    machine = Machine({**THREE, 'axes.sway.safety.error_limit': 0.05, 'plant.x0': [0.0, 0.0],
                       'axes.sway.trajectory.amplitude': 3.0, 'trajectory.amplitude': 0.01,
                       'axes.surge.trajectory.amplitude': 0.01})
    while machine.controller.supervisor.mode is not Mode.FAULT:
        before = machine.controller.controller.memory
        answer = machine.step()
        assert machine.k < 90
    assert machine.controller.supervisor.reason.startswith('axis sway: error ')
    command, terms = answer
    assert command.v == (0.0, 0.0, 0.0)
    assert {row.seq for row in command} == {machine.k - 1}
    assert all(row.status == 8 for row in terms)
    assert machine.controller.controller.memory == before       # none has taken the step
    assert machine.actuator.output == (0.0, 0.0, 0.0)
    assert {row.seq for row in machine.step()[0]} == {machine.k - 1}    # none is ahead of others


@pytest.mark.parametrize(('axes', 'beyond', 'reason'), [
    (('',), (0,), 'command beyond every number'),
    (('surge', 'sway', 'yaw'), (1,), 'axis sway: command beyond every number'),
    (('surge', 'sway', 'yaw'), (0, 2), 'axes surge, yaw: command beyond every number'),
])
def test_a_command_that_its_ramp_takes_beyond_every_number_is_named_by_its_axis(axes, beyond,
                                                                                reason):
    names = tuple(filter(None, axes))
    limits = [SafetySettings(ramp=1.0, safe_command=-1e308 if place in beyond else 0.0)
              for place in range(len(axes))]
    guard = ActuatorGuard(limits if names else limits[0], T, axes=names)
    for name in ('configure', 'activate'):
        guard.transition(name, 0.0)
    for k, v in enumerate((0.0, 1.7e308)):      # finite, and too far from the safe command
        rows = Rows(Command(k, k * T, v, k, k * T) for _ in axes)
        given = guard.command((rows if names else rows[0]).numbers(), k, (k + 0.5) * T)
    safe = tuple(item.safe_command for item in limits)
    assert guard.supervisor.mode is Mode.FAULT
    assert guard.supervisor.reason == reason
    assert given == guard.output == (safe if names else safe[0])


def test_nan_in_a_row_is_counted_for_its_axis_and_nothing_is_answered():
    machine = Machine(THREE)
    machine.step()
    state = machine.state()
    bad = Rows((state[0], state[1]._replace(x=(math.nan, 0.0)), state[2]))
    assert machine.step(state=bad) is None
    assert machine.controller.state_guard.rejected() == {'not finite (axis sway)': 1}
    assert machine.step() is not None
    v = machine.actuator.output
    rows = Rows(Command(2, 2 * T, item, 1, T) for item in (1.0, 1.0, math.inf))
    assert machine.actuator.command(rows.numbers(), 2, 2 * T) is None
    assert machine.actuator.output == v
    assert machine.actuator.guard.rejected() == {'not finite (axis yaw)': 1}


def test_a_stream_of_nan_in_one_row_ends_like_silence():
    machine = Machine({**THREE, 'loop.timing': 'realtime', 'safety.state_hold': 3,
                       'safety.fault_after': 20})
    machine.step()
    machine.step()
    for _ in range(30):
        machine.k += 1
        state = machine.state()
        bad = Rows((state[0], state[1], state[2]._replace(x=(0.0, math.nan))))
        assert machine.controller.take(bad.numbers(), machine.k * T) is None
        machine.controller.poll(machine.k * T)
    assert machine.controller.supervisor.mode is Mode.FAULT
    assert machine.controller.supervisor.reason == 'no state'
    assert machine.controller.state_guard.rejected() == {'not finite (axis yaw)': 30}


def test_limits_are_those_of_each_axis_and_one_saturated_holds_back_no_other():
    machine = Machine({**THREE, 'axes.yaw.safety.command_limit': 0.3,
                       'axes.sway.safety.safe_command': 0.1})
    alone = simulate_axes(machine.c)
    yaw = []
    for k in range(80):
        command, terms = machine.step()
        assert command[0].v == alone['surge'].v[k]
        assert command[1].v == alone['sway'].v[k]
        yaw.append((command[2].v, terms[2].status))
    assert max(abs(v) for v, _ in yaw) == 0.3
    assert any(status & 2 for _, status in yaw)
    assert machine.actuator.estop(80 * T) == (0.0, 0.1, 0.0)


def test_reset_and_estimates_are_those_of_every_axis():
    machine = Machine({**THREE, 'safety.estimates': 'reset'})
    for _ in range(20):
        machine.step()
    law = machine.controller.controller.law
    assert machine.controller.controller.memory != law.initial_memory()
    answer = machine.controller.estop()
    assert answer[0].v == (0.0, 0.0, 0.0)
    assert machine.controller.reset(0.1) == 'the e-stop is still pressed'
    machine.controller.estop(False)
    assert machine.controller.reset(0.1) == ''
    machine.step()
    assert machine.begun[-1] == (21, law.initial_memory())


def test_a_driver_that_fails_is_named():
    c = Configuration.from_flat({**THREE, 'loop.timing': 'realtime', 'driver.name': 'mock',
                                 'axes.sway.driver.script': ['3 raise broken wire']})
    hosted = host(c)
    assert isinstance(hosted, HostedDrivers)
    hosted.open()
    hosted.enable()
    faults = []
    for k in range(6):
        hosted.command((0.0, 0.0, 0.0), k * T)
        hosted.advance(k * T, k)
        hosted.measure(k * T)
        faults.append(hosted.fault())
    assert faults[0] == ''
    assert faults[-1].startswith('axis sway: ')
    assert 'broken wire' in faults[-1]
    assert hosted.disable((0.0, 0.0, 0.0), 0.1) == '' or 'sway' in hosted.fault()
    hosted.close()


def test_where_one_cannot_be_enabled_none_is():
    calls = []

    class Driver:
        def __init__(self, name):
            self.name = name

        def __getattr__(self, step):
            def call(*_):
                calls.append((self.name, step))
                if (self.name, step) == ('c', 'enable'):
                    raise ValueError('no power')
            return call

    class Hosted:
        def __init__(self, name):
            self.driver, self.safe_command = Driver(name), 0.0

    hosted = HostedDrivers(Configuration.from_flat(THREE))
    for item, name in zip(hosted.each, 'abc', strict=True):
        for step in ('open', 'enable', 'disable', 'close'):
            setattr(item.driver, step, getattr(Driver(name), step))
    hosted.open()
    with pytest.raises(Exception, match='axis yaw: enable: ValueError: no power'):
        hosted.enable()
    assert ('a', 'disable') in calls
    assert ('b', 'disable') in calls
    assert not any(item.enabled for item in hosted.each)
    hosted.close()
    assert [call for call in calls if call[1] == 'close'] == [('a', 'close'), ('b', 'close'),
                                                              ('c', 'close')]


def test_the_lifecycle_of_all_axes_is_one():
    machine = Machine(THREE)
    machine.step()
    answers = machine.controller.transition('deactivate')
    assert all(answer[0].v == (0.0, 0.0, 0.0) for answer in answers)
    assert machine.controller.supervisor.lifecycle_state is LifecycleState.INACTIVE
    assert machine.actuator.transition('deactivate', 0.1) == (0.0, 0.0, 0.0)
