# SPDX-License-Identifier: Apache-2.0
"""The states of a device: the serial driver on a real port before a device that lies.

Over 300 lines: a table of states that lie, and the honest ones beside them.
"""

from dataclasses import replace
import itertools
import time
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.core.safety.health import Report
from dz_ros.drivers.serial.device import Device
from dz_ros.drivers.serial.framing import pack, Receiver
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    Hello,
    Info,
    Mode,
    MotorInfo,
    Request,
    State,
)
from dz_ros.drivers.serial.state_monitor import StateMonitor, Wish
from dz_ros.errors import DriverError

pytest.importorskip('serial', reason="pyserial is not installed: pip install 'dz_ros[serial]'")

V = 2.0         # what the law wants, a count each 0.001
COUNTS = 2000


@pytest.fixture
def running(liar, make, until):
    """Return a function that gives a driver whose device runs."""
    made = []

    def give(**parameters):
        found = make(liar.port, **{'fresh': 40, 'silence': 2.0, 'watchdog': 1.0, 'patience': 30.0,
                                   'device_rate': 400.0, **parameters})
        made.append(found)
        found.open()
        found.enable()
        until(lambda: liar.device.mode is Mode.RUN, found, V)
        return found

    yield give
    for item in made:
        item.close()


def recovered(driver):
    try:
        driver.recover()
    except DriverError:
        return False
    return True


def refusal(call):
    """Return why a call is refused; it has to be."""
    with pytest.raises(DriverError) as caught:
        call()
    return str(caught.value)


def passed(liar, count=100):
    """Return a condition: this number of more commands have come."""
    goal = len(liar.commands) + count
    return lambda: len(liar.commands) >= goal


def held(field):
    """Return a change under which a field keeps its first value."""
    first = []

    def change(state):
        first.append(getattr(state, field))
        return [replace(state, **{field: first[0]})]
    return change


def repeating():
    """Return a change that sends the first state for ever."""
    first = []

    def change(state):
        first.append(state)
        return [first[0]]
    return change


def replaying():
    kept = []

    def change(state):
        if len(kept) < 50:
            kept.append(state)
            return [state]
        kept.append(kept.pop(0))
        return [kept[-1]]
    return change


def rewound():
    """Return a change by which seq begins at 1 again."""
    first = []

    def change(state):
        first.append(state.seq)
        return [replace(state, seq=state.seq - first[0] + 1)]
    return change


def once(**fields):
    """Return a change that adds to fields of one state alone."""
    done = []

    def change(state):
        if done:
            return [state]
        done.append(state)
        return [replace(state, **{name: getattr(state, name) + value
                                  for name, value in fields.items()})]
    return change


LIES = {
    'one frame for ever': (repeating, 'the device repeats its last state'),
    'the same frames in a loop': (replaying, 'the device sends older states again'),
    'seq stands still': (lambda: held('seq'), 'the device repeats its last state'),
    'counters begin again': (rewound, 'the device sends older states again'),
    'the clock stands still': (lambda: held('time_us'), "the device's clock stands still"),
    'the clock goes back': (lambda: lambda s: [replace(s, time_us=(s.time_us - 10 ** 7)
                                                       % 2 ** 32)],
                            "the device's clock stands still"),
    'the echo stands still': (lambda: held('echo'), 'has taken no command for 2 s'),
    'an echo of a command never sent': (lambda: once(echo=1000), 'which was not sent to it'),
    'an echo that goes back': (lambda: lambda s: [replace(s, echo=s.echo - 2)]
                               if s.seq % 50 == 0 else [s], 'which was not sent to it'),
    'another mode': (lambda: lambda s: [replace(s, mode=Mode.SAFE)],
                     'is in mode safe, asked for run'),
    'no power': (lambda: lambda s: [replace(s, mode=Mode.DISABLED)],
                 'is in mode disabled, asked for run'),
    'a trip between two states': (lambda: lambda s: [replace(s, trips=(s.trips + 1) % 256)],
                                  'has tripped'),
    'a fault without its mode': (lambda: lambda s: [replace(s, faults=(9,))],
                                 'reports fault 9 in mode run'),
    'another number of values': (lambda: lambda s: [replace(s, values=((1, 2, 3),))],
                                 'has sent nothing'),
    'another version': (lambda: lambda s: [SimpleNamespace(body=lambda: b'\3' + s.body()[1:])],
                        'speaks version 3 of the protocol'),
    'an earlier session': (lambda: lambda s: [replace(s, session=s.session ^ 1)],
                           'greeted by another host'),
}


@pytest.mark.parametrize('lie', LIES)
def test_a_lie_stops_the_law_until_the_operator_resets(liar, running, until, lie):
    make_change, words = LIES[lie]
    driver = running()
    liar.change = make_change()
    until(driver.fault, driver, V)
    until(lambda: words in driver.fault() or words in str(driver.link.broken), driver, V)
    until(lambda: liar.device.mode is not Mode.RUN, driver, V)
    liar.change = lambda state: [state]
    given = len(liar.actuated)
    until(lambda: driver.measure() is not None, driver, V)      # it is honest again
    until(passed(liar), driver, V)
    if driver.link.broken:     # what was only stale is latched by the host
        assert COUNTS not in liar.actuated[given:]
    until(lambda: recovered(driver), driver, V)
    assert driver.fault() == ''
    until(lambda: liar.device.mode is Mode.RUN, driver, V)
    assert driver.measure() == pytest.approx((0.1, 0.0))


def test_a_state_that_is_repeated_is_no_measurement_long_before_the_device_is_given_up(
        liar, running, until):
    driver = running(silence=30.0, fresh=20)
    liar.change = repeating()
    until(lambda: driver.measure() is None, driver, V)
    until(driver.fault, driver, V)
    assert driver.fault() == 'the device repeats its last state'
    report = Report()
    driver.report(report)
    assert int(driver.refused['repeated states']) > 0
    assert report.level == 2


def test_a_device_that_falls_silent_has_not_refused_the_command_on_its_way(liar, running, until):
    driver = running(silence=3.0)
    liar.receives = lambda frame: False
    until(passed(liar, 3), driver, V)       # none of which any state will answer
    liar.change = lambda state: []
    until(driver.fault, driver, V)
    assert driver.fault() == 'the device has sent nothing for 3 s'


def honest(liar, name, link):
    """Make of an honest device one with a peculiarity that is no fault."""
    if name == 'every state twice':
        liar.change = lambda state: [state, state]
    elif name == 'older ones again in between':
        kept = []
        liar.change = lambda state: [*kept[-5:], kept.append(state) or state]
    elif name == 'every second state lost':
        liar.change = lambda state: [state] * (state.seq % 2)
    elif name == 'states in bursts':
        kept = []

        def change(state):
            kept.append(state)
            if len(kept) < 8:
                return []
            found, kept[:] = list(kept), []
            return found
        liar.change = change
    elif name == 'every tenth command lost':
        number = itertools.count()
        liar.receives = lambda frame: isinstance(frame, Hello) or next(number) % 10 != 0
    elif name == 'a clock 5 % too fast':
        liar.drift = 1.05
    elif name == 'a clock 5 % too slow':
        liar.drift = 0.95
    elif name == 'a clock of milliseconds':
        liar.change = lambda state: [replace(state, time_us=state.time_us // 1000 * 1000)]
    elif name == 'counters that wrap':
        liar.device.seq = 2 ** 32 - 100
        liar.shift = 2 ** 32 - 500_000
        link.seq = 2 ** 32 - 60
        liar.device.trips = 255


@pytest.mark.parametrize('name', [
    'every state twice', 'older ones again in between', 'every second state lost',
    'states in bursts', 'every tenth command lost', 'a clock 5 % too fast',
    'a clock 5 % too slow', 'a clock of milliseconds', 'counters that wrap'])
def test_what_is_no_lie_is_no_fault(liar, make, until, name):
    driver = make(liar.port, fresh=400, silence=20.0, watchdog=1.0, patience=30.0,
                  device_rate=400.0)
    honest(liar, name, driver.link)
    driver.open()
    try:
        driver.enable()
        until(lambda: liar.device.mode is Mode.RUN, driver, V)
        states = driver.link.counts['states']
        until(lambda: driver.link.counts['states'] > states + 300, driver, V)
        assert driver.fault() == ''
        assert liar.device.mode is Mode.RUN
        if name == 'counters that wrap':
            found = driver.link.newest()[0]
            assert (found.seq < 2 ** 31, found.time_us < 2 ** 31, found.echo < 2 ** 31) == (
                True, True, True)
            trips = found.trips
            until(lambda: driver.link.newest()[0].trips != trips)      # this host is silent
            assert driver.link.newest()[0].trips == 0
            until(lambda: liar.device.mode is Mode.RUN, driver, V)
            assert driver.fault() == ''
    finally:
        driver.close()


def test_a_request_to_stop_is_repeated_until_it_is_taken(liar, running, until):
    driver = running(watchdog=1.0, silence=30.0)
    lost = []

    def receives(frame):
        if isinstance(frame, Command) and frame.request is Request.SAFE and len(lost) < 3:
            lost.append(frame)
            return False
        return True
    liar.receives = receives
    driver.safe(0.0, 0.0)       # once
    until(lambda: liar.device.mode is Mode.SAFE)
    assert len(lost) == 3
    count = len(liar.commands)
    until(lambda: driver.link.monitor.unanswered is None)
    assert len(liar.commands) <= count + 3      # and then no more
    assert driver.fault() == ''
    assert {frame.request for frame in liar.commands[-3:]} == {Request.SAFE}


def test_a_request_to_run_is_never_repeated(liar, running, until):
    driver = running(watchdog=0.05)
    until(lambda: liar.device.mode is Mode.SAFE)        # no command comes, and it trips
    count = len(liar.commands)
    states = driver.link.counts['states']
    until(lambda: driver.link.counts['states'] > states + 100)
    assert len(liar.commands) == count
    assert driver.fault() == ''       # it was this host that was silent


def test_no_session_but_the_operators_gives_power(liar, running, until):
    driver = running(silence=0.5)
    liar.restart()
    until(driver.fault, driver, V)
    until(lambda: driver.link.newest() is not None, driver, V)
    given = len(liar.actuated)
    for _ in range(50):         # an e-stop, an orderly end of the controller, a command
        driver.safe(0.5, 0.0)
        driver.command(V, 0.0)
        time.sleep(0.002)
    until(passed(liar, 10), driver, V)
    assert set(liar.actuated[given:]) <= {None}
    assert liar.device.mode is Mode.DISABLED
    driver.recover()
    assert liar.device.mode is Mode.SAFE


def test_a_device_is_not_measured_before_it_has_reported_what_it_is(liar, running, until):
    driver = running(silence=0.3)
    liar.info = False
    liar.restart()
    until(driver.fault, driver, V)
    until(passed(liar), driver, V)
    others = driver.link.refused.counts['states of another session']
    until(lambda: driver.link.refused.counts['states of another session'] > others + 20, driver, V)
    assert driver.measure() is None
    assert not recovered(driver)
    liar.info = True
    until(lambda: recovered(driver))


def test_another_device_of_the_same_kind_is_recognized_by_its_name(liar, running, until):
    driver = running(silence=0.3)
    liar.name = 'bench 2'
    liar.restart()
    until(lambda: 'another device answers' in driver.fault(), driver, V)
    assert not recovered(driver)
    assert driver.measure() is None
    liar.name = 'bench'         # the right one is back
    until(lambda: recovered(driver))


@pytest.mark.parametrize(('absolute', 'seen'), [(True, True), (False, True), (False, False)])
def test_a_restart_loses_the_position_of_an_incremental_encoder(liar, running, until, absolute,
                                                                seen):
    driver = running(silence=0.3, absolute_encoder=absolute)
    if not seen:        # the line is cut first, and back only once the device has been greeted
        liar.change = lambda state: []
        until(driver.fault, driver, V)
        liar.restart()
        liar.change = lambda state: [state] * (state.session != 0)
    else:
        liar.restart()
    until(driver.fault, driver, V)
    until(lambda: driver.link.newest() is not None)
    if absolute:
        driver.recover()
        return
    for again in (driver.recover, driver.enable):
        # A machine that stalls is silence before it is anything else: never is it power.
        until(lambda again=again:
              'its position is lost (driver.absolute_encoder' in refusal(again))
    driver.disable()
    driver.close()
    driver.open()       # the operator has homed it
    driver.enable()


def test_a_line_that_was_cut_does_not_lose_the_position(liar, running, until):
    driver = running(silence=0.3, absolute_encoder=False)
    liar.change = lambda state: []
    until(driver.fault, driver, V)
    liar.change = lambda state: [state]
    until(lambda: recovered(driver))


def test_a_hold_for_ever_is_as_long_as_a_device_permits(make):
    from dz_ros.core.configuration import Configuration
    driver = make('/dev/null')
    flat = driver.configuration.to_flat()
    driver.configure(Configuration.from_flat({**flat, 'safety.command_hold': 0}))
    assert driver.hold_ms == 1000


STEPS = st.lists(st.tuples(
    st.integers(0, 60),                     # ms until the next step
    st.sampled_from((None, Request.RUN, Request.RUN, Request.RUN, Request.SAFE)),
    st.booleans()),                         # whether its state arrives
    max_size=60)
COUNTERS = st.integers(0, 2 ** 32 - 1) | st.integers(2 ** 32 - 30, 2 ** 32 - 1)


@settings(max_examples=3 * settings.default.max_examples, deadline=None)
@given(STEPS, COUNTERS, COUNTERS.filter(bool), COUNTERS, st.sampled_from((1, 2, 8)))
def test_an_honest_device_is_never_blamed(steps, clock, seq, count, motors):
    """Whatever this host sends or leaves out, whatever states are lost, wherever counters wrap."""
    actuated, receiver, monitor = [], Receiver(), StateMonitor()
    none = (0,) * motors
    device = Device(Info(0, (MotorInfo(500, 1.0, (1.0,)),) * motors, ''),
                    lambda: ([(0,)] * motors, none), actuated.append)
    device.seq = count
    now = 0.0
    device.step(pack(Hello(7, 200, motors).body()), clock)
    for after, request, arrives in [(1, Request.SAFE, True), *steps]:
        now += after * 1e-3 + 3e-4
        sent = b''
        if request is not None:
            wish = Wish(request, (5,) * motors, none, 20)
            monitor.writing(seq, wish, now).ended = now
            sent = pack(Command(7, seq, (5,) * motors, none, 20, request).body())
            seq = seq % (2 ** 32 - 1) + 1
        for body in receiver.feed(device.step(sent, clock + round(now * 1e6))):
            frame = decode(body)
            if isinstance(frame, State) and frame.session and arrives:
                taken, difference = monitor.take(frame, now)
                assert taken
                assert difference == ''
                assert monitor.unanswered is None
                again = monitor.take(frame, now)
                assert again == (False, '')
                assert monitor.stale == 'the device repeats its last state'
