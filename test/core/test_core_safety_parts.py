# SPDX-License-Identifier: Apache-2.0
"""Tables, limiter and guards of messages one by one."""

import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Command
from dz_ros.core.safety.command_limiter import CommandLimiter
from dz_ros.core.safety.controller_guard import ControllerGuard
from dz_ros.core.safety.message_guards import (
    FutureGuard,
    JUMP,
    plausible,
    RIVALS,
    SequenceGuard,
    Verdict,
)
from dz_ros.core.safety.modes import Action, Event, LATCHED, LIFECYCLE, LifecycleState, Mode, MODES
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.safety.supervisor import Supervisor

T = 0.005


@pytest.fixture
def started():
    """Return configuration and guard of an active controller in real time."""
    c = Configuration.from_flat({'loop.timing': 'realtime'})
    guard = ControllerGuard(c)
    guard.supervisor.transition('configure')
    guard.supervisor.transition('activate')
    return c, guard


# --- the tables

@pytest.mark.parametrize('mode', Mode)
def test_estop_and_fault_always_latch_and_the_safe_command_goes_out(mode):
    for event, goal in ((Event.ESTOP, Mode.ESTOP), (Event.FAULT, Mode.FAULT)):
        supervisor = Supervisor()
        supervisor.mode = mode
        action = supervisor.happen(event)
        assert supervisor.mode is (Mode.ESTOP if mode is Mode.ESTOP else goal)
        if mode not in LATCHED:
            assert action is Action.SAFE


def test_only_a_reset_leaves_a_latched_mode():
    for (mode, event), (following, _) in MODES.items():
        if mode in LATCHED and following not in LATCHED:
            assert event is Event.RESET
    for mode, event in MODES:
        assert event is not Event.RESET or mode in LATCHED


def test_the_law_starts_only_on_fresh_input():
    for (_, event), (following, action) in MODES.items():
        assert (following is Mode.RUNNING) == (event is Event.INPUT) == (action is Action.START)


def test_every_way_out_of_running_that_may_leave_the_actuator_moving_is_safe():
    for (mode, event), (following, action) in MODES.items():
        if mode is Mode.RUNNING and following is not Mode.RUNNING:
            assert action is Action.SAFE or event is Event.END


def test_the_lifecycle_follows_the_standard_and_a_latch_outlives_it():
    changes = []
    supervisor = Supervisor(changes.append)
    for name in ('configure', 'activate'):
        supervisor.transition(name)
    supervisor.happen(Event.INPUT)
    assert supervisor.running
    supervisor.happen(Event.FAULT, 'why')
    for name, state in (('deactivate', LifecycleState.INACTIVE),
                        ('cleanup', LifecycleState.UNCONFIGURED),
                        ('configure', LifecycleState.INACTIVE),
                        ('activate', LifecycleState.ACTIVE)):
        supervisor.transition(name)
        assert supervisor.lifecycle_state is state
        assert (supervisor.mode, supervisor.reason) == (Mode.FAULT, 'why')
    supervisor.transition('shutdown')
    assert supervisor.lifecycle_state is LifecycleState.FINALIZED
    with pytest.raises(LookupError):
        supervisor.transition('activate')
    assert [change.mode for change in changes] == [Mode.RUNNING, Mode.FAULT]
    assert {state for state, _ in LIFECYCLE} | {LifecycleState.FINALIZED} == set(LifecycleState)


# --- the limiter

def test_with_everything_off_the_very_number_comes_out():
    limiter = CommandLimiter(SafetySettings(), T)
    limiter.start(0.0)
    for k, v in enumerate((0.1, -1e300, 5e-324, -0.0, 16.734958)):
        out = limiter.apply(v, k * T)
        assert (out, math.copysign(1.0, out)) == (v, math.copysign(1.0, v))
    assert (limiter.limited, limiter.refused) == (0, 0)


@pytest.mark.parametrize('v', [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_comes_out_safe(v):
    for settings in (SafetySettings(safe_command=0.25),
                     SafetySettings(safe_command=0.25, command_limit=5.0, rate_limit=1.0)):
        limiter = CommandLimiter(settings, T)
        assert limiter.apply(v, 0.0) == limiter.output == 0.25
        assert limiter.refused == 1


@given(st.lists(st.tuples(st.floats(), st.floats())), st.floats(0.0, 1e300), st.floats(0.0, 10.0),
       st.sampled_from([0.0, 2.0]), st.floats(-1.0, 1.0))
def test_nothing_else_ever_comes_out(commands, rate, ramp, limit, safe):
    limiter = CommandLimiter(SafetySettings(rate_limit=rate, ramp=ramp, command_limit=limit,
                                            safe_command=safe), T)
    limiter.start(0.0)
    for v, t in commands:
        out = limiter.apply(v, t)
        assert math.isfinite(out)
        assert limit == 0.0 or abs(out) <= limit


def test_limits_on_value_and_rate_and_the_ramp():
    limiter = CommandLimiter(SafetySettings(command_limit=2.0), T)
    assert [limiter.apply(v, 0.0) for v in (1.0, 3.0, -3.0)] == [1.0, 2.0, -2.0]
    limiter = CommandLimiter(SafetySettings(rate_limit=100.0, safe_command=1.0), T)
    limiter.start(7.0)
    steps = [limiter.apply(10.0, 7.0 + k * T) for k in range(4)]
    assert steps == pytest.approx([1.5, 2.0, 2.5, 3.0])
    # After a long pause it moves by three samples' worth, not by the pause's.
    assert limiter.apply(10.0, 99.0) == pytest.approx(4.5)
    assert limiter.safe(99.1) == 1.0       # the way to the safe command has no limit
    limiter = CommandLimiter(SafetySettings(ramp=0.1, safe_command=1.0), T)
    limiter.start(2.0)
    assert limiter.apply(3.0, 2.0) == 1.0
    assert limiter.apply(3.0, 2.05) == pytest.approx(2.0)
    assert limiter.apply(3.0, 2.2) == 3.0


# --- guards of messages

def judge(guard, *numbers, now=0.0, resync=False):
    return guard.judge(numbers, now, resync)


def test_each_kind_of_bad_message_has_its_name_and_is_counted():
    guard = SequenceGuard()
    assert judge(guard, 5.0, 1.0) is Verdict.TAKEN
    expected = {(5.0, 1.0): Verdict.REPEATED, (5.0, 2.0): Verdict.CONFLICT,
                (4.0, 1.0): Verdict.BACK, (5.5, 1.0): Verdict.BAD_SEQ,
                (6.0, math.nan): Verdict.NOT_FINITE, (math.inf, 1.0): Verdict.NOT_FINITE,
                (-1.0, 0.0): Verdict.BAD_SEQ, (2.0 ** 53, 0.0): Verdict.BAD_SEQ,
                (6.0 + JUMP, 0.0): Verdict.JUMP}
    for numbers, verdict in expected.items():
        assert judge(guard, *numbers) is verdict, numbers
    assert judge(guard, 9.0, 0.0) is Verdict.TAKEN
    assert guard.skipped == 3
    assert sum(guard.rejected().values()) == len(expected)
    # Where a sender may have started again any seq is right, but only a seq.
    assert judge(guard, 0.0, 0.0, resync=True) is Verdict.TAKEN
    assert judge(guard, math.nan, 0.0, resync=True) is Verdict.NOT_FINITE


def test_two_senders_are_seen_by_their_numbers_duplicates_and_one_restart_are_not():
    guard = SequenceGuard()
    for k in range(3 * RIVALS):
        judge(guard, 1000.0 + k, 0.0, now=k * T)
        judge(guard, 1000.0 + k, 0.0, now=k * T)        # duplicated on the way
    assert not guard.rivalry(3 * RIVALS * T)
    for k in range(RIVALS):
        judge(guard, 1100.0 + k, 0.0, now=1.0 + k * T)
        judge(guard, 20.0 + k, 0.0, now=1.0 + k * T)
    assert guard.rivalry(1.0 + RIVALS * T)
    assert not guard.rivalry(5.0)
    guard.forget_rivals()
    assert not guard.rivalry(1.0 + RIVALS * T)


def test_a_stamp_from_the_future_is_one_ahead_of_the_quickest_transport():
    guard = FutureGuard()
    assert not guard.ahead(100.0, 5.0, 0.015)
    assert not guard.ahead(100.005, 5.001, 0.015)
    assert guard.ahead(100.035, 5.010, 0.015)
    assert not guard.ahead(100.035, 5.010, 0.0)         # off
    guard.restart()
    assert not guard.ahead(-3600.0, 5.2, 0.015)


def test_stamps_ahead_that_agree_show_that_the_one_before_was_late():
    """The plant measured, stalled for .1 s, sent, and left out the samples it had missed."""
    guard = FutureGuard()
    assert not guard.ahead(0.045, 0.145, 0.015)
    assert guard.ahead(0.140, 0.146, 0.015)
    assert not guard.ahead(0.145, 0.150, 0.015)
    assert not guard.ahead(0.150, 0.155, 0.015)
    assert guard.ahead(0.200, 0.160, 0.015)             # alone: it is the faulty one
    assert not guard.ahead(0.165, 0.170, 0.015)
    assert guard.ahead(0.210, 0.171, 0.015)
    assert guard.ahead(9.0, 0.172, 0.015)               # nor do these two agree


def test_a_clock_that_jumps_ahead_after_good_stamps_is_not_confirmed_by_itself():
    guard = FutureGuard()
    for k in range(1000):
        assert not guard.ahead(k * T, k * T + 0.001, 0.015)
    assert all(guard.ahead(k * T + 10.0, k * T + 0.001, 0.015) for k in range(1000, 1100))
    assert not guard.ahead(1100 * T, 1100 * T + 0.001, 0.015)


def test_a_state_refused_as_from_the_future_is_not_taken_when_it_is_repeated(started):
    c, guard = started
    for k in range(10):
        guard.reference((k, k * T, *c.trajectory(k * T)), k * T)
        state = guard.take((k, k * T, *c.x0, k - 1.0, 0.0, 0.0), k * T)
        guard.answer(state, k * T)
    early = (10.0, 30.0, *c.x0, 9.0, 0.0, 0.0)
    assert [guard.take(early, 10 * T) for _ in range(3)] == [None] * 3
    guard.poll(9 * T + c.safety.state_hold * T + 0.001)       # it fed no watchdog either
    assert guard.supervisor.mode is Mode.LOST
    assert guard.supervisor.reason == 'no state'


def test_a_late_state_does_not_turn_the_following_ones_away(started):
    c, guard = started
    numbers = [(5.0, 0.045, 0.145), *((6.0 + i, 0.140 + i * T, 0.146 + i * T) for i in range(20))]
    for seq, stamp, now in numbers:
        guard.reference((seq, stamp, *c.trajectory(stamp)), now)
        state = guard.take((seq, stamp, *c.x0, -1.0, 0.0, 0.0), now)
        assert (state is None) == (seq == 6.0)
        if state is not None:
            guard.answer(state, now)
        guard.poll(now + T)
        assert guard.supervisor.running
    assert guard.state_guard.rejected() == {'stamp from the future': 1}


# --- numbers of any origin

ODD = st.floats() | st.sampled_from([0.0, 1.0, 2.0, 0.5, -1.0, 1e308, 2.0 ** 53, 1e9, 1e10])


@given(st.lists(st.tuples(*[ODD] * 6), max_size=8), st.booleans())
def test_whatever_comes_is_judged_and_what_is_taken_is_a_record(messages, resync):
    guard = SequenceGuard(echo=3)
    for number, numbers in enumerate(messages):
        verdict = guard.judge(numbers, 0.01 * number, resync)
        if verdict in (Verdict.TAKEN, Verdict.REPEATED):
            command = Command.from_numbers(numbers)
            assert command[:3] + command[4:] == numbers[:3] + numbers[4:]
            assert command.echo_seq == numbers[3] >= -1
            assert abs(command.stamp) <= 1e9
            assert plausible(numbers, 3)
    assert sum(guard.counts) == len(messages)


@pytest.mark.parametrize(('numbers', 'reason'), [
    ((1e308, 0.0, 0.0, 0.0), 'seq is no count'), ((1.5, 0.0, 0.0, 0.0), 'seq is no count'),
    ((2.0, 1e10, 0.0, 0.0), 'stamp is no loop time'),
    ((2.0, 0.0, 0.0, 0.5), 'echo_seq is no count'),
    ((2.0, 0.0, 0.0, -2.0), 'echo_seq is no count'),
    ((2.0, 0.0, 0.0, 1e308), 'echo_seq is no count'), ((2.0, math.nan, 0.0, 0.0), 'not finite'),
])
def test_numbers_that_are_no_record_are_counted_by_cause(numbers, reason):
    guard = SequenceGuard(echo=3)
    for following in (False, True):     # as the first message, and as the one after seq 1
        if following:
            assert guard.judge((1.0, 0.0, 0.0, 0.0), 0.0, True) is Verdict.TAKEN
        guard.judge(numbers, 0.0, resync=False)
    assert guard.rejected() == {reason: 2}


def test_a_reference_from_the_future_is_not_followed(started):
    c, guard = started
    guard.reference((0.0, 1e8, 1.0, 0.0, 0.0), 0.0)
    state = guard.take((0.0, 0.0, *c.x0, -1.0, 0.0, 0.0), 0.0)
    assert not guard.ready(state)       # the one for now was not sent
    assert guard.reference((0.0, 0.0, *c.trajectory(0.0)), 0.0)
    assert guard.ready(state)
    honest = guard.answer(state, 0.0)
    assert guard.supervisor.running
    for stamp in (1e8, 1e308, 5.1):
        assert not guard.reference((1.0, stamp, 1e6, 0.0, 0.0), 0.001)
    assert guard.reference_guard.rejected() == {'stamp from the future': 2,
                                                'stamp is no loop time': 1}
    assert guard.controller.newest_reference() == 0.0
    assert guard.answer(state, 0.002) == honest
