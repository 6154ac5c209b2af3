# SPDX-License-Identifier: Apache-2.0
"""The serial driver against devices that are processes: ours in Python, the firmware in C.

Over 300 lines: each fault is tried on both devices by the same fixtures.
"""

import threading
import time

import pytest

from dz_ros.core.safety.health import Report
from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.drivers.serial.framing import CHECKSUM, LONG, NO_CODE, SHORT
from dz_ros.drivers.serial.protocol import Mode, Request
from dz_ros.drivers.serial.state_monitor import Wish
from dz_ros.errors import DriverError
from dz_ros.files.configurations import load_configuration

pytest.importorskip('serial', reason="pyserial is not installed: pip install 'dz_ros[serial]'")
pytestmark = pytest.mark.slow


@pytest.fixture
def driver(serial_device, make):
    """Return a function that gives an open driver with power on."""
    made = []

    def give(**parameters):
        # A machine that others use as well stalls for longer than the defaults allow.
        found = make(serial_device.port, **{'fresh': 400, 'silence': 5.0, 'patience': 30.0,
                                            'watchdog': 1.0, **parameters})
        made.append(found)
        found.open()
        found.enable()
        return found

    yield give
    for item in made:
        item.close()
    assert not [thread for thread in threading.enumerate()
                if thread.name.startswith(str(serial_device.port))]


def mode(driver):
    found = driver.link.newest()
    return found and found[0].mode


def recovered(driver):
    """Return whether an operator's reset works."""
    try:
        driver.recover()
    except DriverError:
        return False
    return True


def refusal(driver):
    """Return why a driver cannot be enabled."""
    try:
        driver.enable()
    except DriverError as error:
        return str(error)
    return ''


def test_it_opens_moves_measures_and_lets_go(serial_device, driver, until):
    serial_device()
    found = driver()
    assert found.limit == pytest.approx(30.0)
    until(lambda: found.measure() is not None)
    assert found.measure() == pytest.approx((0.1, 0.0))
    assert mode(found) is Mode.SAFE
    until(lambda: found.measure()[0] > 0.12, found, 2.0)
    assert mode(found) is Mode.RUN
    assert found.applied_command() == pytest.approx(2.0)
    speed = found.measure()[1]
    assert 0.0 < speed < 5.0
    found.safe(0.0, 1.0)
    until(lambda: mode(found) is Mode.SAFE)
    assert found.applied_command() == 0.0
    report = Report()
    found.report(report)
    assert report.level == 0
    assert report.values['device mode'] == 'safe'
    found.disable()
    assert mode(found) is Mode.DISABLED


def test_dead_zone_and_friction_hold_what_the_limit_lets_through(serial_device, driver, until):
    serial_device()
    found = driver()
    for _ in range(100):        # 1.4 A would accelerate against 1 N m, 1.4 - 0.5 A creep
        found.command(1.4, 0.0)
        time.sleep(0.002)
    assert 0.0 < found.measure()[1] < 0.02
    until(lambda: found.measure()[1] > 0.5, found, 1e300)


def test_silence_of_the_host_trips_the_devices_own_watchdog(serial_device, driver, until):
    serial_device()
    found = driver(watchdog=0.3)
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    trips = found.link.newest()[0].trips   # a slow machine may have caused some
    until(lambda: found.link.newest()[0].trips > trips)
    assert mode(found) is Mode.SAFE
    assert found.fault() == ''
    until(lambda: mode(found) is Mode.RUN, found, 1.0)


@pytest.mark.parametrize(('fault', 'words'), [
    ('unplug@0.2+0.4', 'the line has gone'),
    ('mute@0.2+1.5', 'has sent nothing for 0.5 s'),
    ('freeze@0.2+1.5', 'has sent nothing for 0.5 s'),
    ('restart@0.2', 'has restarted'),
    ('trip@0.2+1.5', 'reports fault 7'),
])
def test_a_fault_lasts_until_the_operator_resets(serial_device, driver, fault, words, until):
    process = serial_device(fault)
    found = driver(watchdog=0.05, silence=0.5)
    until(found.fault, found, 1.0)
    first = found.fault()
    # A device that fell out of touch may be known by its silence first.
    assert any(text in first for text in (words, 'has tripped', 'has sent nothing'))
    name = fault.partition('@')[0]
    if name in ('unplug', 'trip') and recovered(found):
        time.sleep(0.2)     # until its line is read: it has ended while this machine stood still
        assert f'{name} ends' in process.output
        return
    process.wait_for_line(f'{name} ends')
    until(lambda: found.link.newest() is not None)
    for _ in range(20):         # what comes back by itself gets no power by itself
        found.command(1.0, 0.0)
        assert found.fault()
        assert mode(found) in (None, Mode.DISABLED, Mode.SAFE, Mode.FAULT)
        time.sleep(0.005)
    until(lambda: recovered(found))
    assert found.fault() == ''
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    assert found.measure() is not None


def test_a_fault_from_before_is_reset_by_a_host_that_starts_again(serial_device, driver, make,
                                                                  until):
    process = serial_device('trip@0.2+1.5')
    first = driver()
    until(lambda: first.fault() == 'the device reports fault 7', first, 1.0)
    first.disable()
    first.close()
    second = make(serial_device.port, fresh=400, silence=5.0, patience=30.0, watchdog=1.0)
    second.open()
    try:
        refused = refusal(second)
        if not refused:         # the fault has ended meanwhile
            process.wait_for_line('trip ends')
        else:
            assert 'does not leave its fault: the device reports fault 7' in refused
            process.wait_for_line('trip ends')
            assert mode(second) is Mode.FAULT       # latched
            until(lambda: not refusal(second))
        assert second.fault() == ''
        assert mode(second) is Mode.SAFE
        until(lambda: mode(second) is Mode.RUN, second, 1.0)
        second.disable()
    finally:
        second.close()


def test_an_e_stop_is_left_by_a_reset_without_power_and_then_enabled(serial_device, driver, make,
                                                                     until):
    serial_device()
    first = driver()
    first.link.send(Wish(Request.ESTOP, (0,), (0,), first.hold_ms))
    until(lambda: mode(first) is Mode.ESTOP)
    first.close()
    second = make(serial_device.port, fresh=400, silence=5.0, patience=30.0, watchdog=1.0)
    second.open()
    try:
        with pytest.raises(DriverError, match='e-stop of the device is latched'):
            second.enable()
        assert mode(second) is Mode.ESTOP
        second.recover()
        assert mode(second) is Mode.DISABLED
        second.enable()
        until(lambda: mode(second) is Mode.RUN, second, 1.0)
        second.disable()
    finally:
        second.close()


def test_it_can_be_closed_and_opened_again_and_what_happened_between_is_forgotten(
        serial_device, driver, until):
    serial_device()
    found = driver()
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    found.disable()
    found.link.broken = 'the line has gone'    # between two looks
    found.enable()
    assert found.fault() == ''
    found.disable()
    found.close()
    assert found.measure() is None
    found.open()
    found.enable()
    until(lambda: mode(found) is Mode.RUN, found, 1.0)


@pytest.mark.parametrize(('fault', 'words'), [
    ('deaf@0.2+3', 'has tripped'),
    ('intermittent@0.2+3', ''),
    ('repeat@0.2+3', 'repeats its last state'),
    ('replay@1+3=100', 'sends older states again'),
    ('clock@0.2+1', 'clock stands still'),
    ('echo@0.2+1', 'has taken no command for 0.5 s'),
    ('unsent@0.2+1', 'which was not sent to it'),
    ('mode@0.2+1=0', 'is in mode disabled, asked for run'),
    ('mode@0.2+1', 'is in mode safe, asked for run'),
    ('swap@0.2+1', 'a'),    # 'has restarted', then 'another device answers'
])
def test_a_device_that_lies_or_is_cut_off_runs_again_after_a_reset_alone(
        serial_device, driver, fault, words, until):
    process = serial_device(fault)
    found = driver(watchdog=0.05, silence=0.5, fresh=20)
    name = fault.partition('@')[0]
    until(lambda: f'{name} begins' in process.output, found, 1.0)
    until(found.fault, found, 1.0)
    first = found.fault()
    # On a busy machine it may be known first by what a stall does.
    assert any(text in first for text in (words, 'do not reach it', 'sent nothing')), first

    def modes():
        return [line for line in process.output.splitlines() if line.startswith('mode ')]

    until(lambda: modes()[-1] != 'mode run', found, 1.0)
    until(lambda: f'{name} ends' in process.output, found, 1.0)
    until(lambda: found.link.newest() is not None, found, 1.0)
    # A device that stood still still reads what was on the line when it was tripped.
    until(lambda: modes()[-1] != 'mode run', found, 1.0)
    runs = process.output.count('mode run')
    states = found.link.counts['states']
    until(lambda: found.link.counts['states'] > states + 200, found, 1.0)
    assert found.fault()
    assert process.output.count('mode run') == runs
    until(lambda: recovered(found))
    assert found.fault() == ''
    until(lambda: process.output.count('mode run') > runs, found, 1.0)


def test_states_that_come_twice_are_taken_once(serial_device, driver, until):
    process = serial_device('double@0.1+1')
    found = driver(watchdog=1.0)
    until(lambda: 'double ends' in process.output, found, 0.6)
    assert found.fault() == ''
    assert found.link.refused.counts['repeated states'] > 100
    assert mode(found) is Mode.RUN


@pytest.mark.parametrize('fault', ['corrupt@0.1+1=0.02', 'lose@0.1+1=0.02', 'garbage@0.1=5000'])
def test_damage_is_thrown_away_and_never_measured(serial_device, driver, fault, until):
    process = serial_device(fault)
    found = driver(watchdog=1.0)
    until(lambda: mode(found) is Mode.RUN, found, 0.6)
    seen = []
    while f'{fault.partition("@")[0]} ends' not in process.output:
        found.command(0.6, 0.0)
        seen.append(found.measure())
        time.sleep(0.002)
    values = [x for x in seen if x is not None]
    assert values
    # At v = 0.6 a servo with this friction creeps: a wrong number would stand out.
    assert all(0.099 < x < 0.2 and abs(speed) < 0.1 for x, speed in values)
    until(lambda: any(found.refused[cause] for cause in (NO_CODE, SHORT, CHECKSUM, LONG)),
          found, 0.6)         # the last of it may still be on the line
    until(lambda: found.measure() is not None, found, 0.6)
    assert found.fault() == ''


def test_measured_positions_only(serial_device, driver, make, until):
    serial_device()
    found = driver(measured=1, state_scales='[2e-6]', command_scale=2e-3)
    assert found.measured == 1
    until(lambda: found.measure() is not None)
    assert found.measure() == pytest.approx((0.2,))     # the user's scale, not the device's
    assert found.limit == pytest.approx(60.0)
    assert make(serial_device.port, limit=5.0).limit == 5.0


@pytest.mark.parametrize('fault', ['corrupt@0.1+1=0.01', 'lose@0.1+1=0.01', 'double@0.1+1'])
def test_three_motors_are_measured_through_damage_and_never_wrongly(serial_device, fault, until):
    process = serial_device(fault, motors=3)
    c = load_configuration('servo', [
        'loop.axes=[x, y, z]', 'driver.name=serial', f'driver.port={serial_device.port}',
        'driver.fresh=400', 'driver.silence=5.0', 'driver.patience=30.0', 'driver.watchdog=1.0'])
    hosted = HostedDrivers(c)
    hosted.open()
    try:
        hosted.enable()
        link, seen = hosted.driver.link, []

        def given():
            hosted.command((0.6, 1.0, -0.7), 0.0)   # creep, creep faster, creep back
            seen.append(hosted.measure(0.0))
            return f'{fault.partition("@")[0]} ends' in process.output
        until(given)
        rows = [row for row in seen if row is not None]
        assert rows
        # At such commands servos with this friction creep: a wrong number would stand out.
        assert all(0.0 < x < 0.3 and abs(speed) < 0.1 for row in rows for x, speed in row)
        assert any(link.refused.counts[cause] for cause in (
            NO_CODE, SHORT, CHECKSUM, LONG, 'repeated states'))
        until(lambda: given() and hosted.measure(0.0) is not None)
        assert hosted.fault() == ''
        assert link.newest()[0].mode is Mode.RUN
        (x, _), (y, _), (z, _) = hosted.measure(0.0)
        assert z < 0.1 <= x < y
    finally:
        hosted.disable((0.0,) * 3, 0.0)
        hosted.close()
