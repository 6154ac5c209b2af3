# SPDX-License-Identifier: Apache-2.0
"""The serial driver on a port with nothing, or another device, behind it."""

import itertools
import threading

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.serial.framing import pack
from dz_ros.drivers.serial.protocol import (
    Command,
    Hello,
    Info,
    Mode,
    MotorInfo,
    Request,
    State,
)
from dz_ros.errors import ConfigurationError, DriverError, MissingDependencyError

pytest.importorskip('serial', reason="pyserial is not installed: pip install 'dz_ros[serial]'")

COUNT = itertools.count(1)


def polite(frame, values=(1, 2), limit=1000, mode=Mode.DISABLED, fault=0, motors=1):
    """Answer as a device that does nothing; the fault is of its last motor."""
    count = next(COUNT)
    motor = MotorInfo(limit, 1.0, (1.0,) * len(values))
    yield pack(Info(frame.session, (motor,) * motors, 'fake').body())
    yield pack(State(frame.session, count, 1000 * count, getattr(frame, 'seq', 0), mode, 0,
                     (*(0,) * (motors - 1), fault), (values,) * motors).body())


@pytest.fixture
def opening(make):
    """Return the function that opens, enables and closes a driver."""
    def attempt(port, **parameters):
        driver = make(port, patience=0.5, **parameters)
        try:
            driver.open()
            driver.enable()
        finally:
            driver.close()

    return attempt


def test_no_port_is_named(tmp_path, opening):
    with pytest.raises(DriverError, match=r"driver.port = '.*/none': there is no such port"):
        opening(tmp_path / 'none')


def test_no_device_is_reported_with_the_speed_of_the_line(fake, opening):
    with pytest.raises(DriverError, match=r'nothing that speaks the protocol answers within 0\.5 '
                                          's at 115200 baud'):
        opening(fake().port, baudrate=115200, device_rate=200)


def test_a_port_in_use_is_reported(fake, make, opening):
    port = fake(polite).port
    first = make(port)
    first.open()
    try:
        with pytest.raises(DriverError, match='in use by another program'):
            opening(port)
    finally:
        first.close()


def test_another_version_is_reported(fake, opening):
    answer = fake(lambda frame: [pack(b'\x03' + Hello(1, 1).body()[1:])])
    with pytest.raises(DriverError, match='speaks version 3 of the protocol, not 1 or 2'):
        opening(answer.port)


def test_a_device_that_measures_too_little_is_reported(fake, opening):
    port = fake(lambda frame: polite(frame, values=(1,))).port
    with pytest.raises(DriverError, match="'fake' measures 1 of the 2 values wanted: set "
                                          r'driver\.measured to 1'):
        opening(port)


@pytest.mark.parametrize(('mode', 'words'), [
    (Mode.DISABLED, 'does not take power: the device is in mode disabled, asked for safe'),
    (Mode.FAULT, 'does not leave its fault: the device reports fault 5'),
    (Mode.ESTOP, 'e-stop of the device is latched: release it, then reset'),
])
def test_a_device_that_takes_no_power_is_reported(fake, mode, words, opening):
    with pytest.raises(DriverError, match=words):
        opening(fake(lambda frame: polite(frame, mode=mode,
                                          fault=5 * (mode is Mode.FAULT))).port)


def test_an_e_stop_is_lifted_by_a_reset_alone(fake, make):
    there = fake(lambda frame: polite(frame, mode=Mode.ESTOP))
    driver = make(there.port)
    driver.open()
    try:
        with pytest.raises(DriverError, match='e-stop'):
            driver.enable()
        assert not [frame for frame in there.received if isinstance(frame, Command)]
        with pytest.raises(DriverError, match='does not leave its fault'):
            driver.recover()
    finally:
        driver.close()
    commands = {frame.request for frame in there.received if isinstance(frame, Command)}
    assert commands == {Request.RESET}      # and no power without having had it


def test_another_device_after_a_reconnection_is_not_taken(fake, make, until):
    limit = [1000]
    other = fake(lambda frame: polite(frame, limit=limit[0], mode=Mode.SAFE))
    driver = make(other.port)
    driver.open()
    try:
        driver.enable()
        limit[0] = 2000
        # It reports nothing by itself, so it is greeted again.
        until(lambda: 'another device answers' in driver.fault())
        with pytest.raises(DriverError, match="another device answers: 'fake'"):
            driver.recover()
    finally:
        driver.close()


@pytest.mark.slow
def test_nothing_waits_for_a_line_that_takes_nothing(fake, make, until):
    there = fake(lambda frame: polite(frame, mode=Mode.SAFE))
    driver = make(there.port, silence=300.0)
    driver.open()
    driver.enable()
    there.stop()
    # Each write that does not fit takes 0.1 s of the writer: a caller that waited for it would
    # need hours for these.
    for k in range(200_000):
        driver.command(float(k), 0.0)
    until(lambda: driver.link.refused.counts['frames not written'] > 0, driver, 3.0)
    assert driver.measure() is None
    driver.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith(there.port)]


def test_the_newest_command_is_the_one_that_is_sent(fake, make, until):
    there = fake(lambda frame: polite(frame, mode=Mode.SAFE if getattr(
        frame, 'request', None) is Request.SAFE else Mode.RUN))
    driver = make(there.port)
    driver.open()
    driver.enable()
    for k in range(500):
        driver.command(float(k), 0.0)
    until(lambda: there.received[-1].v == (499,))
    driver.disable()
    driver.close()
    commands = [frame for frame in there.received if isinstance(frame, Command)]
    seqs = [frame.seq for frame in commands]
    assert seqs == sorted(set(seqs))
    assert {frame.hold_ms for frame in commands} == {15}    # safety.command_hold, 3 samples


@pytest.mark.parametrize(('parameters', 'key'), [
    ({'device_rate': 100.0}, 'driver.device_rate'),
    ({'baudrate': 115200}, 'driver.device_rate'),
    ({'measured': 3}, 'driver.measured'),
    ({'state_scales': '[1.0]'}, 'driver.state_scales'),
    ({'watchdog': 2.0}, 'driver.watchdog'),
    ({'baudrate': 9}, 'driver.baudrate'),
])
def test_mistakes_are_named(parameters, key, make):
    with pytest.raises(ConfigurationError) as caught:
        make('/dev/null', **parameters)
    assert caught.value.key == key


def test_without_pyserial_the_extra_is_named(monkeypatch, make):
    monkeypatch.setitem(__import__('sys').modules, 'serial', None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'dz_ros\[serial\]'"):
        make('/dev/null').open()


def test_limits_change_while_it_runs(make):
    driver = make('/dev/null', limit=4.0)
    flat = driver.configuration.to_flat()
    driver.configure(Configuration.from_flat({**flat, 'driver.limit': 2.0,
                                              'safety.command_hold': 8}))
    assert driver.limit == 2.0
    assert driver.hold_ms == 40


def test_a_command_wished_before_the_line_broke_moves_nothing_after_it(fake, make, until):
    there = fake(lambda frame: polite(frame, mode=Mode.SAFE))
    driver = make(there.port, silence=30.0)
    driver.open()
    driver.enable()
    with driver.link._news:        # the writer waits until the line has broken
        driver.command(5.0, 0.0)
        driver.link._break('the line has gone')
    until(lambda: driver.link.newest() is not None)
    before = there.received[-1].session
    until(lambda: isinstance(there.received[-1], Command), driver, 5.0)
    driver.close()
    assert driver.fault() == 'the line has gone'
    assert before == there.received[-1].session
    # That is a session without power.
    assert {frame.request for frame in there.received if isinstance(frame, Command)
            and frame.session == before} == {Request.DISABLE}
