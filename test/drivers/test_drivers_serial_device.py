# SPDX-License-Identifier: Apache-2.0
"""The device's machine: its table of modes, its watchdog."""

from dataclasses import replace
import itertools

import pytest

from dz_ros.drivers.serial.device import Device, IDLE_PERIOD_US, MIN_PERIOD_US
from dz_ros.drivers.serial.framing import pack, Receiver
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    Hello,
    Info,
    Mode,
    MotorInfo,
    Request,
)

MOTORS = (MotorInfo(500, 0.5, (0.25, 2.0)), MotorInfo(300, 1.0, (0.5, 4.0)),
          MotorInfo(2 ** 31 - 1, 1e-3, (1e-6, 1e-6)))
SESSION = 77


def info(motors):
    """Return what a device of this number of motors is; they repeat after three."""
    return Info(0, tuple(MOTORS[place % 3] for place in range(motors)), 'bench')


def each(v, motors):
    """Return a command of each motor: of the next one the negative one less."""
    return tuple(v if place % 2 == 0 else -v - 1 for place in range(motors))


class Bench:
    """A device on a bench: receives what the test sends, keeps what it sends and actuates.

    Attributes:
        fault: Code of the last motor.
        actuated: What the first motor was given, in order; None = no power.
        others: What the others were given at the same times.
    """

    def __init__(self, motors=1):
        self.motors, self.fault, self.actuated, self.others = motors, 0, [], []
        self.now = 1000
        self.device = Device(info(motors), self.measure, self.actuate)
        self._receiver = Receiver()

    def measure(self):
        return [(3, -4 - place) for place in range(self.motors)], [
            *[0] * (self.motors - 1), self.fault]

    def actuate(self, v):
        self.actuated.append(None if v is None else v[0])
        self.others.append(None if v is None else v[1:])

    def step(self, *frames, after=1000):
        self.now += after
        sent = self.device.step(b''.join(pack(frame.body()) for frame in frames), self.now)
        return [decode(body) for body in self._receiver.feed(sent)]

    def ask(self, request, seq, v=0, safe=0, hold=50, session=SESSION, after=1000):
        return self.step(Command(session, seq, each(v, self.motors), each(safe, self.motors), hold,
                                 request), after=after)


@pytest.fixture(params=[1, 2, 8])
def cold(request):
    """A device of one motor or several that has been greeted, without power."""
    made = Bench(request.param)
    found, *_ = made.step(Hello(SESSION, 1000, request.param))
    assert found == replace(info(request.param), session=SESSION)
    return made


@pytest.fixture
def bench(cold):
    """A device with power."""
    (state,) = cold.ask(Request.SAFE, 2 ** 32 - 1000)
    assert state.mode is Mode.SAFE
    return cold


@pytest.mark.parametrize('motors', [1, 3])
def test_before_a_greeting_it_reports_it_and_takes_nothing(motors):
    bench = Bench(motors)
    states = [frame for _ in range(250) for frame in bench.ask(Request.RUN, 5, v=9, session=0)]
    assert [state.session for state in states] == [0] * len(states)
    assert len(states) == 1 + 250 * 1000 // IDLE_PERIOD_US
    assert bench.actuated == [None]


@pytest.mark.parametrize(('path', 'mode', 'actuated'), [
    ((Request.RUN,), Mode.DISABLED, None),
    ((Request.SAFE,), Mode.SAFE, -2),
    ((Request.SAFE, Request.RUN), Mode.RUN, 7),
    ((Request.SAFE, Request.RUN, Request.SAFE), Mode.SAFE, -2),
    ((Request.SAFE, Request.RUN, Request.DISABLE), Mode.DISABLED, None),
    ((Request.SAFE, Request.DISABLE, Request.RUN), Mode.DISABLED, None),
    ((Request.SAFE, Request.DISABLE), Mode.DISABLED, None),
    ((Request.SAFE, Request.RUN, Request.ESTOP), Mode.ESTOP, None),
    ((Request.ESTOP, Request.RUN), Mode.ESTOP, None),
    ((Request.ESTOP, Request.SAFE), Mode.ESTOP, None),
    ((Request.ESTOP, Request.DISABLE), Mode.ESTOP, None),
    ((Request.ESTOP, Request.RESET), Mode.DISABLED, None),
    ((Request.SAFE, Request.RUN, Request.RESET), Mode.RUN, 7),
    ((Request.ESTOP, Request.RESET, Request.RUN), Mode.DISABLED, None),
    ((Request.ESTOP, Request.RESET, Request.SAFE, Request.RUN), Mode.RUN, 7),
])
def test_table_of_modes(cold, path, mode, actuated):
    for seq, request in enumerate(path):
        (state,) = cold.ask(request, seq, v=7, safe=-2)
    assert (state.mode, state.echo) == (mode, len(path) - 1)
    assert state.values == tuple((3, -4 - place) for place in range(cold.motors))
    assert cold.actuated[-1] == actuated
    assert cold.others[-1] == (None if actuated is None else each(actuated, cold.motors)[1:])


def test_commands_are_clipped_to_the_limit(bench):
    for seq, (v, safe) in enumerate([(501, 0), (-2 ** 31, 0), (2 ** 31 - 1, 0)]):
        bench.ask(Request.RUN, seq, v, safe)
        assert abs(bench.actuated[-1]) == 500
        assert [abs(given) for given in bench.others[-1][:1]] == [300][:bench.motors - 1]
    bench.ask(Request.SAFE, 9, 0, -900)
    assert bench.actuated[-1] == -500
    assert bench.others[-1][:2] == (300, -900)[:bench.motors - 1]


def test_commands_for_another_number_of_motors_are_not_taken(bench):
    bench.ask(Request.RUN, 1, v=7)
    for motors in {1, 2, 3, 8} - {bench.motors}:
        v = (9,) * motors
        for frame in (Hello(SESSION + 1, 1000, motors),
                      Command(SESSION, 5, v, v, 50, Request.ESTOP)):
            (state,) = bench.step(frame)
            assert (state.session, state.echo, state.mode) == (SESSION, 1, Mode.RUN)
    assert bench.actuated[-1] == 7


def test_watchdog_takes_the_safe_command_once_and_a_new_command_wakes_it(bench):
    bench.ask(Request.RUN, 1, v=7, safe=-2, hold=5)
    for _ in range(4):
        (state,) = bench.step()
        assert state.mode is Mode.RUN
    for _ in range(10):
        (state,) = bench.step()
        assert (state.mode, state.trips) == (Mode.SAFE, 1)
    assert bench.actuated[-1] == -2
    (state,) = bench.ask(Request.RUN, 2, v=8)
    assert (state.mode, bench.actuated[-1]) == (Mode.RUN, 8)


def test_old_repeated_and_foreign_commands_are_not_taken(bench):
    bench.ask(Request.RUN, 2 ** 32 - 1, v=1)
    for seq, session in ((2 ** 32 - 1, SESSION), (2 ** 32 - 9, SESSION), (5, SESSION + 1), (5, 0)):
        (state,) = bench.ask(Request.RUN, seq, v=99, session=session)
        assert (state.echo, bench.actuated[-1]) == (2 ** 32 - 1, 1)
    (state,) = bench.ask(Request.RUN, 0, v=2)
    assert (state.echo, bench.actuated[-1]) == (0, 2)


def test_what_is_not_taken_does_not_feed_the_watchdog(bench):
    bench.ask(Request.RUN, 1, v=7, hold=5)
    for _ in range(6):
        (state,) = bench.ask(Request.RUN, 1, v=7, hold=5)
    assert state.mode is Mode.SAFE


def test_a_fault_is_latched_until_reset_and_back_while_it_lasts(bench):
    bench.ask(Request.RUN, 1, v=7)
    bench.fault = 9
    (state,) = bench.step()
    none = (0,) * bench.motors
    latched = (*none[1:], 9)        # of the last motor, and the power of all is off
    assert (state.mode, state.faults) == (Mode.FAULT, latched)
    assert bench.actuated[-1] is bench.others[-1] is None
    (state,) = bench.ask(Request.RESET, 2)
    assert (state.mode, state.faults) == (Mode.FAULT, latched)
    bench.fault = 0
    (state,) = bench.ask(Request.RUN, 3, v=7)
    assert (state.mode, state.faults) == (Mode.FAULT, latched)
    (state,) = bench.ask(Request.RESET, 4)
    assert (state.mode, state.faults) == (Mode.DISABLED, none)


def test_a_new_session_takes_power_away_the_same_one_changes_nothing(bench):
    bench.ask(Request.RUN, 5, v=7)
    info, state = bench.step(Hello(SESSION, 1000, bench.motors))
    assert (state.mode, state.echo) == (Mode.RUN, 5)
    info, state = bench.step(Hello(SESSION + 1, 1000, bench.motors))
    assert (info.session, state.session, state.mode) == (SESSION + 1, SESSION + 1, Mode.DISABLED)
    assert bench.actuated[-1] is None
    bench.ask(Request.SAFE, 1, session=SESSION + 1)         # counts begin again
    bench.ask(Request.RUN, 2, v=7, session=SESSION + 1)
    assert bench.actuated[-1] == 7


def test_states_come_at_the_period_asked_for_never_two_at_once(bench):
    bench.step(Hello(SESSION, 5000, bench.motors))
    times = [frame.time_us for _ in range(40) for frame in bench.step()]
    assert {b - a for a, b in itertools.pairwise(times)} == {5000}
    assert len(bench.step(after=23_000)) == 1
    bench.step(Hello(SESSION, 1, bench.motors))
    times = [frame.time_us for _ in range(50) for frame in bench.step(after=50)]
    assert {b - a for a, b in itertools.pairwise(times)} == {MIN_PERIOD_US}
