# SPDX-License-Identifier: Apache-2.0
"""State machine: statuswords, every transition of the profile, the way to a goal."""

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.cia402.device import Device
from dz_ros.drivers.cia402.states import (
    Controlword,
    DriveState,
    FOLLOWS,
    Goal,
    Promises,
    REMOTE,
    state_of,
    step_to,
    stopped,
    VOLTAGE,
    Walk,
)

S = DriveState

# Statuswords as drives send them, from the table of states of CiA 402; x is any bit.
STATUSWORDS = {
    'xxxxxxxxx0xx0000': S.NOT_READY, 'xxxxxxxxx1xx0000': S.DISABLED,
    'xxxxxxxxx01x0001': S.READY, 'xxxxxxxxx01x0011': S.SWITCHED_ON,
    'xxxxxxxxx01x0111': S.ENABLED, 'xxxxxxxxx00x0111': S.QUICK_STOP,
    'xxxxxxxxx0xx1111': S.REACTING, 'xxxxxxxxx0xx1000': S.FAULT}

# Controlword → transitions it causes, as the profile numbers them.
TRANSITIONS = {
    Controlword.SHUTDOWN: {S.DISABLED: S.READY, S.SWITCHED_ON: S.READY, S.ENABLED: S.READY},
    Controlword.SWITCH_ON: {S.READY: S.SWITCHED_ON, S.ENABLED: S.SWITCHED_ON},
    Controlword.ENABLE_OPERATION: {S.READY: S.SWITCHED_ON, S.SWITCHED_ON: S.ENABLED,
                                   S.QUICK_STOP: S.ENABLED},
    Controlword.DISABLE_VOLTAGE: {S.READY: S.DISABLED, S.SWITCHED_ON: S.DISABLED,
                                  S.ENABLED: S.DISABLED, S.QUICK_STOP: S.DISABLED},
    Controlword.QUICK_STOP: {S.READY: S.DISABLED, S.SWITCHED_ON: S.DISABLED,
                             S.ENABLED: S.QUICK_STOP},
    Controlword.FAULT_RESET: {S.FAULT: S.DISABLED, S.READY: S.DISABLED, S.SWITCHED_ON: S.DISABLED,
                              S.ENABLED: S.DISABLED, S.QUICK_STOP: S.DISABLED}}


def device(state, code=6):
    made = Device()
    made.state, made.quick_stop_code, made.standing = state, code, False
    return made


@pytest.mark.parametrize(('pattern', 'state'), STATUSWORDS.items())
@settings(deadline=None)
@given(rest=st.integers(0, 0xFFFF))
def test_statuswords_are_read_as_the_profile_writes_them(pattern, state, rest):
    fixed = int(''.join('0' if bit == 'x' else '1' for bit in pattern), 2)
    value = int(pattern.replace('x', '0'), 2)
    assert state_of((rest & ~fixed) | value) is state


def test_every_statusword_has_at_most_one_state_and_unknown_ones_have_none():
    def matches(word):
        bits = f'{word:016b}'
        return [state for pattern, state in STATUSWORDS.items()
                if all(a in ('x', b) for a, b in zip(pattern, bits, strict=True))]
    for word in range(0x80):
        found = matches(word)
        assert state_of(word) is (found[0] if found else None)
        assert len(found) <= 1
    assert state_of(0x01) is None


@pytest.mark.parametrize('state', list(S))
def test_the_device_reports_its_state_so_that_it_is_understood(state):
    made = device(state)
    for made.standing in (False, True):
        for made.limited in (False, True):
            assert state_of(made.statusword) is state


@pytest.mark.parametrize('word', list(Controlword))
@pytest.mark.parametrize('state', list(S))
def test_transitions_of_the_device(state, word):
    made = device(state)
    made.control(word)
    expected = TRANSITIONS[word].get(state, state)
    assert made.state is expected


def test_a_fault_is_reset_by_the_edge_alone_and_only_once_it_has_gone():
    made = device(S.ENABLED)
    made.fault(0x2310)
    assert made.state is S.REACTING
    made.control(Controlword.FAULT_RESET)
    assert made.state is S.REACTING
    made.standing = True
    made.settle()
    made.control(Controlword.FAULT_RESET)       # the bit was set already: no edge
    assert (made.state, made.error_code) == (S.FAULT, 0x2310)
    made.control(Controlword.DISABLE_VOLTAGE)
    made.stuck = True
    made.control(Controlword.FAULT_RESET)
    assert made.state is S.FAULT
    made.stuck = False
    made.control(Controlword.DISABLE_VOLTAGE)
    made.control(Controlword.FAULT_RESET)
    assert (made.state, made.error_code) == (S.DISABLED, 0)


@pytest.mark.parametrize(('code', 'standing', 'after'), [
    (0, False, S.DISABLED), (1, False, S.QUICK_STOP), (2, False, S.QUICK_STOP),
    (2, True, S.DISABLED), (5, True, S.QUICK_STOP), (6, True, S.QUICK_STOP)])
def test_what_a_quick_stop_ends_in(code, standing, after):
    made = device(S.ENABLED, code)
    made.control(Controlword.QUICK_STOP)
    made.standing = standing
    made.settle()
    assert made.state is after


def walk(made, goal, cycles=40, period=0.005, limit=1.0, patience=0.05):
    """Walk a device to a goal as the thread does; return (states, faults)."""
    way, states, faults = Walk(limit, 0.01, patience), [made.state], []
    for cycle in range(cycles):
        way.want(goal, 0.0)
        word, fault = way.look(state_of(made.statusword), cycle * period, cycle * period)
        if fault:
            faults.append(fault)
        made.control(word)
        made.settle()
        if made.state is not states[-1]:
            states.append(made.state)
    return states, faults


@pytest.mark.parametrize(('state', 'states'), [
    (S.DISABLED, [S.DISABLED, S.READY, S.SWITCHED_ON, S.ENABLED]),
    (S.READY, [S.READY, S.SWITCHED_ON, S.ENABLED]),
    (S.SWITCHED_ON, [S.SWITCHED_ON, S.ENABLED]),
    (S.ENABLED, [S.ENABLED]),
    (S.QUICK_STOP, [S.QUICK_STOP, S.ENABLED]),
    (S.FAULT, [S.FAULT]), (S.REACTING, [S.REACTING]), (S.NOT_READY, [S.NOT_READY])])
def test_the_way_to_operation_enabled(state, states):
    assert walk(device(state), Goal.ENABLED) == (states, [])


def test_a_drive_that_cannot_go_back_from_quick_stop_goes_round():
    states, faults = walk(device(S.QUICK_STOP, code=4), Goal.ENABLED)
    assert states == [S.QUICK_STOP, S.DISABLED, S.READY, S.SWITCHED_ON, S.ENABLED]
    assert faults == []


@pytest.mark.parametrize('state', [S.DISABLED, S.READY, S.SWITCHED_ON, S.ENABLED, S.QUICK_STOP])
def test_safe_and_off_take_the_torque_away_in_one_step(state):
    for goal, allowed in ((Goal.SAFE, (S.DISABLED, S.QUICK_STOP)), (Goal.OFF, (S.DISABLED,))):
        states, faults = walk(device(state), goal, cycles=1)
        assert states[-1] in allowed
        assert faults == []


@settings(deadline=None)
@given(st.sampled_from([*S, None]))
def test_no_step_resets_a_fault(state):
    for goal in Goal:
        assert not step_to(goal, state) & 0x80
    assert step_to(Goal.ENABLED, S.FAULT) is Controlword.DISABLE_VOLTAGE


def test_a_drive_that_drops_out_by_itself_is_not_switched_on_again():
    way = Walk(1.0, settle=0.1)
    way.want(Goal.ENABLED, 0.0)
    assert way.look(S.ENABLED, 0.2, 0.2)[1] == ''
    assert way.look(S.DISABLED, 0.3, 0.3)[1] == ('the drive has left operation enabled by itself: '
                                                 'switch on disabled')
    way.want(Goal.SAFE, 0.4)
    assert way.look(S.DISABLED, 0.4, 0.4) == (Controlword.QUICK_STOP, '')


@pytest.mark.parametrize('stopped', [S.QUICK_STOP, S.DISABLED])
def test_an_answer_to_the_goal_before_is_no_fault(stopped):
    way = Walk(1.0, settle=0.1)
    way.want(Goal.ENABLED, 0.0)
    assert way.look(S.ENABLED, 1.0, 1.0)[1] == ''
    way.want(Goal.SAFE, 1.0)        # a quick stop, taken back before the drive has reported a word
    way.look(S.ENABLED, 1.0, 1.0)
    way.want(Goal.ENABLED, 1.002)
    assert way.look(S.ENABLED, 1.0, 1.3) == (Controlword.ENABLE_OPERATION, '')    # reported before
    assert way.look(S.ENABLED, 1.05, 1.3) == (Controlword.ENABLE_OPERATION, '')
    assert way.look(stopped, 1.06, 1.1)[1] == ''
    assert way.look(S.ENABLED, 1.2, 1.2)[1] == ''
    assert way.look(stopped, 1.3, 1.3)[1] != ''


def test_a_drive_that_does_not_get_there_in_time_has_a_fault():
    way = Walk(1.0)
    way.want(Goal.ENABLED, 5.0)
    assert way.look(S.READY, 5.9, 5.9) == (Controlword.SWITCH_ON, '')
    assert way.look(S.READY, 6.1, 6.1)[1] == ('the drive does not reach operation enabled within '
                                              '1 s: ready to switch on')
    assert way.look(None, 0.0, 6.2)[1].endswith('unknown state')


def test_a_slow_drive_that_drops_out_by_our_detour_has_not_left_by_itself():
    way = Walk(5.0, settle=0.1, patience=0.2)
    way.want(Goal.ENABLED, 0.0)
    assert way.look(S.QUICK_STOP, 0.2, 0.25)[0] is Controlword.DISABLE_VOLTAGE
    assert way.look(S.ENABLED, 0.26, 0.26)[1] == ''     # it took the step, and then the detour
    assert way.look(S.DISABLED, 0.3, 0.3) == (Controlword.SHUTDOWN, '')
    assert way.look(S.ENABLED, 0.5, 0.5)[1] == ''
    assert 'by itself' in way.look(S.DISABLED, 0.6, 0.6)[1]


def test_a_drive_that_does_not_stop_is_reported_not_to_and_one_old_answer_is_not():
    for goal, state in ((Goal.SAFE, S.ENABLED), (Goal.OFF, S.QUICK_STOP), (Goal.OFF, S.ENABLED)):
        way = Walk(5.0, settle=0.1)
        way.want(goal, 1.0)
        for k in range(100):        # the same word, looked at again and again
            assert way.look(state, 1.2, 1.2 + k)[1] == ''
        reported = [way.look(state, 1.3 + k, 1.3 + k)[1] for k in range(Walk.REFUSALS)]
        assert reported[-2] in ('', reported[-1])
        assert reported[0] == ''
        assert reported[-1] == f'the drive does not take the command to stop: {state.value}'
        assert stopped(goal, S.DISABLED)
        assert way.look(S.DISABLED, 90.0, 90.0)[1] == ''
    assert stopped(Goal.SAFE, S.QUICK_STOP)
    assert not stopped(Goal.SAFE, None)


@pytest.mark.parametrize(('bit', 'words'), [(VOLTAGE, 'power is off (statusword bit 4)'),
                                            (REMOTE, 'in local mode (statusword bit 9)'),
                                            (FOLLOWS, 'follow the target (statusword bit 12)')])
def test_a_bit_that_a_drive_has_kept_and_drops_is_a_contradiction(bit, words):
    whole, promises = 0x27 | VOLTAGE | REMOTE | FOLLOWS, Promises()
    assert not any(promises.look(whole & ~bit) for _ in range(100))     # it never has it
    assert promises.look(whole) == ''
    assert promises.look(whole & ~bit) == ''            # once may be a moment
    assert promises.look(0x21) == ''                    # not enabled: nothing is promised
    reported = [promises.look(whole & ~bit) for _ in range(30)]
    assert reported[0] == ''
    assert reported[-1].startswith('the drive reports operation enabled, but it')
    assert words in reported[-1]


@pytest.mark.parametrize(('code', 'after', 'fault'), [
    (0, S.ENABLED, False), (1, S.REACTING, True), (2, S.DISABLED, False),
    (3, S.QUICK_STOP, False)])
def test_what_a_lost_connection_ends_in(code, after, fault):
    made = device(S.ENABLED)
    made.abort_connection = code
    assert made.lose_connection(0x8130) is fault
    assert made.state is after
    assert device(S.DISABLED).lose_connection(0x8130) is False


def test_a_fault_reaction_that_coasts_does_not_wait():
    made = device(S.ENABLED)
    made.fault_reaction = 0
    made.fault(0x2310)
    made.settle()
    assert made.state is S.FAULT
