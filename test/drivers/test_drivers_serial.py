"""The serial driver against devices that are processes: ours in Python, the firmware in C."""

import os
from pathlib import Path
import pty
import threading
import time
import tty

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Report
from dz_ros.drivers.serial.framing import pack, Receiver
from dz_ros.drivers.serial.protocol import Command, decode, Hello, Info, Mode, Request, State
from dz_ros.errors import ConfigurationError, DriverError, MissingDependencyError
from dz_ros.files import load_configuration

pytest.importorskip('serial', reason="pyserial is not installed: pip install 'dz_ros[serial]'")

EMULATE = ('-m', 'dz_ros', 'driver', 'emulate', 'serial', 'servo')
TIME_OUT = 60.0
SERVO = Path(__file__).parents[2] / 'config' / 'servo.yaml'


def make(port, **driver):
    overrides = [f'driver.{key}={value}' for key, value in
                 {'name': 'serial', 'port': port, **driver}.items()]
    return load_configuration(SERVO, overrides).make_driver()


def until(condition, driver=None, v=0.0):
    """Command at about 200 Hz until a condition holds."""
    deadline = time.monotonic() + TIME_OUT
    while not condition():
        assert time.monotonic() < deadline, driver and (driver.trouble(), driver._link.counts,
                                                        driver._link.newest())
        if driver is not None:
            driver.command(v, 0.0)
        time.sleep(0.004)


@pytest.fixture(params=['emulated', 'firmware'])
def device(request, processes, tmp_path):
    """Return a function that starts a device with faults, and its port."""
    port = tmp_path / 'port'
    options = ['-o', f'link={port}']
    if request.param == 'firmware':
        options += ['-o', f'program={request.getfixturevalue("firmware")}']

    def start(*faults):
        process = processes(*EMULATE, *options, *(word for fault in faults
                                                  for word in ('--fault', fault)))
        process.wait_for_line('serial device on')
        return process

    start.port = port
    return start


@pytest.fixture
def driver(device, request):
    """Return a function that gives an open driver with power on."""
    made = []

    def give(**parameters):
        # A machine that others use as well stalls for longer than the defaults allow.
        found = make(device.port, **{'fresh': 400, 'silence': 5.0, 'patience': 30.0, **parameters})
        made.append(found)
        found.open()
        found.enable()
        return found

    yield give
    for item in made:
        item.close()
    assert not [thread for thread in threading.enumerate()
                if thread.name.startswith(str(device.port))]


def mode(driver):
    found = driver._link.newest()
    return found and found[0].mode


def recovered(driver):
    """Return whether an operator's reset works."""
    try:
        driver.recover()
    except DriverError:
        return False
    return True


def test_it_opens_moves_measures_and_lets_go(device, driver):
    device()
    found = driver()
    assert found.limit == pytest.approx(30.0)
    until(lambda: found.measure() is not None)
    assert found.measure() == pytest.approx((0.1, 0.0))
    assert mode(found) is Mode.SAFE
    until(lambda: found.measure()[0] > 0.12, found, 2.0)
    assert mode(found) is Mode.RUN
    speed = found.measure()[1]
    assert 0.0 < speed < 5.0
    found.safe(0.0, 1.0)
    until(lambda: mode(found) is Mode.SAFE)
    report = Report()
    found.report(report)
    assert report.level == 0
    assert report.values['device mode'] == 'safe'
    found.disable()
    assert mode(found) is Mode.DISABLED


def test_dead_zone_and_friction_hold_what_the_limit_lets_through(device, driver):
    device()
    found = driver()
    for _ in range(100):        # 1.4 A would accelerate against 1 N m, 1.4 - 0.5 A creep
        found.command(1.4, 0.0)
        time.sleep(0.002)
    assert 0.0 < found.measure()[1] < 0.02
    until(lambda: found.measure()[1] > 0.5, found, 1e300)


def test_silence_of_the_host_trips_the_devices_own_watchdog(device, driver):
    device()
    found = driver(watchdog=0.03)
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    trips = found._link.newest()[0].trips   # a slow machine may have caused some
    until(lambda: found._link.newest()[0].trips > trips)
    assert mode(found) is Mode.SAFE
    assert found.trouble() == ''
    until(lambda: mode(found) is Mode.RUN, found, 1.0)


@pytest.mark.parametrize(('fault', 'words'), [
    ('unplug@0.2+0.4', 'the line has gone'),
    ('mute@0.2+1.5', 'has said nothing for 0.5 s'),
    ('freeze@0.2+1.5', 'has said nothing for 0.5 s'),
    ('restart@0.2', 'has started anew'),
    ('trip@0.2+1.5', 'reports fault 7'),
])
def test_trouble_lasts_until_the_operator_resets(device, driver, fault, words):
    process = device(fault)
    found = driver(watchdog=0.05, silence=0.5)
    until(found.trouble, found, 1.0)
    first = found.trouble()
    # A device that fell out of touch may be known by its silence first.
    assert words in first or 'has said nothing' in first
    name = fault.partition('@')[0]
    if name in ('unplug', 'trip'):
        ended = f'{name} ends' in process.output
        assert ended or not recovered(found)
    process.wait_for_line(f'{name} ends')
    until(lambda: found._link.newest() is not None)
    for _ in range(20):         # what comes back by itself gets no power by itself
        found.command(1.0, 0.0)
        assert found.trouble()
        assert mode(found) in (None, Mode.DISABLED, Mode.SAFE, Mode.FAULT)
        time.sleep(0.005)
    until(lambda: recovered(found))
    assert found.trouble() == ''
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    assert found.measure() is not None


def test_it_can_be_closed_and_opened_again_and_what_happened_between_is_forgotten(device, driver):
    device()
    found = driver()
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    found.disable()
    found._link.broken = 'the line has gone'    # while nobody looked
    found.enable()
    assert found.trouble() == ''
    found.disable()
    found.close()
    assert found.measure() is None
    found.open()
    found.enable()
    until(lambda: mode(found) is Mode.RUN, found, 1.0)


def test_a_command_wished_before_the_line_broke_moves_nothing_after_it(fake):
    there = fake(lambda frame: polite(frame, mode=Mode.SAFE))
    driver = make(there.port, silence=30.0)
    driver.open()
    driver.enable()
    with driver._link._news:        # the writer waits until the line has broken
        driver.command(5.0, 0.0)
        driver._link._break('the line has gone')
    until(lambda: driver._link.newest() is not None)
    before = there.heard[-1].session
    until(lambda: isinstance(there.heard[-1], Command), driver, 5.0)
    driver.close()
    assert driver.trouble() == 'the line has gone'
    assert before == there.heard[-1].session
    assert {frame.request for frame in there.heard if isinstance(frame, Command)} == {Request.SAFE}


def test_a_device_that_hears_nothing_goes_to_the_safe_command(device, driver):
    process = device('deaf@0.2+0.4')
    found = driver(watchdog=0.05)
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    until(lambda: 'deaf begins' in process.output, found, 1.0)
    until(lambda: mode(found) is Mode.SAFE, found, 1.0)
    assert found._link.newest()[0].trips > 0
    until(lambda: 'deaf ends' in process.output, found, 1.0)
    until(lambda: mode(found) is Mode.RUN, found, 1.0)
    assert found.trouble() == ''


@pytest.mark.parametrize('fault', ['corrupt@0.1+1=0.02', 'lose@0.1+1=0.02', 'garbage@0.1=5000'])
def test_damage_is_thrown_away_and_never_measured(device, driver, fault):
    process = device(fault)
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
    assert sum(found._link.rejected().values()) > 0
    until(lambda: found.measure() is not None, found, 0.6)
    assert found.trouble() == ''


def test_measured_positions_only(device, driver):
    device()
    found = driver(measured=1, state_scales='[2e-6]', command_scale=2e-3)
    assert found.measured == 1
    until(lambda: found.measure() is not None)
    assert found.measure() == pytest.approx((0.2,))     # the user's scale, not the device's
    assert found.limit == pytest.approx(60.0)
    assert make(device.port, limit=5.0).limit == 5.0


# A port with nothing, or somebody else, behind it.

class Fake:
    """A pseudo-terminal at whose other end the test answers."""

    def __init__(self, answer=None):
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self.heard = []
        self._receiver = Receiver()
        self._answer = answer
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        if answer is not None:
            self._thread.start()

    def _serve(self):
        os.set_blocking(self._master, False)
        while not self._stop.wait(0.002):
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                data = b''
            for body in self._receiver.feed(data):
                self.heard.append(decode(body))
                for reply in self._answer(self.heard[-1]):
                    os.write(self._master, reply)

    def close(self):
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def fake():
    made = []

    def give(answer=None):
        made.append(Fake(answer))
        return made[-1]

    yield give
    for item in made:
        item.close()


def polite(frame, values=(1, 2), limit=1000, scales=(1.0, 1.0), mode=Mode.DISABLED, fault=0):
    """Answer as a device that does nothing."""
    yield pack(Info(frame.session, len(values), limit, 1.0, scales[:len(values)], 'fake').body())
    yield pack(State(frame.session, 1, 2, getattr(frame, 'seq', 0), mode, 0, fault,
                     values).body())


def opening(port, **parameters):
    driver = make(port, patience=0.5, **parameters)
    try:
        driver.open()
        driver.enable()
    finally:
        driver.close()


def test_no_port_is_named(tmp_path):
    with pytest.raises(DriverError, match=r"driver.port = '.*/none': there is no such port"):
        opening(tmp_path / 'none')


def test_no_device_is_said_with_the_speed_of_the_line(fake):
    with pytest.raises(DriverError, match=r'nothing that speaks the protocol answers within 0\.5 '
                                          's at 115200 baud'):
        opening(fake().port, baudrate=115200, device_rate=200)


def test_a_port_in_use_is_said(fake):
    port = fake(polite).port
    first = make(port)
    first.open()
    try:
        with pytest.raises(DriverError, match='in use by another program'):
            opening(port)
    finally:
        first.close()


def test_another_version_is_said(fake):
    answer = fake(lambda frame: [pack(b'\x02' + Hello(1, 1).body()[1:])])
    with pytest.raises(DriverError, match='speaks version 2 of the protocol, not 1'):
        opening(answer.port)


def test_a_device_that_measures_too_little_is_said(fake):
    port = fake(lambda frame: polite(frame, values=(1,))).port
    with pytest.raises(DriverError, match="'fake' measures 1 of the 2 values wanted: set "
                                          r'driver\.measured to 1'):
        opening(port)


@pytest.mark.parametrize(('mode', 'words'), [
    (Mode.DISABLED, 'does not take power: no answer'),
    (Mode.FAULT, 'reports fault 5'),
    (Mode.ESTOP, 'e-stop of the device is pressed'),
])
def test_a_device_that_takes_no_power_is_said(fake, mode, words):
    with pytest.raises(DriverError, match=words):
        opening(fake(lambda frame: polite(frame, mode=mode, fault=5)).port)


def test_another_device_after_a_reconnection_is_not_taken(fake):
    limit = [1000]
    other = fake(lambda frame: polite(frame, limit=limit[0], mode=Mode.SAFE))
    driver = make(other.port)
    driver.open()
    try:
        driver.enable()
        limit[0] = 2000
        # It says nothing by itself, so it is greeted anew.
        until(lambda: 'another device answers' in driver.trouble())
        with pytest.raises(DriverError, match="another device answers: 'fake'"):
            driver.recover()
    finally:
        driver.close()


def test_nobody_waits_for_a_line_that_takes_nothing(fake):
    port = fake()
    driver = make(port.port)
    driver._link._connect()
    driver._powered = True
    writer = threading.Thread(target=driver._link._write, daemon=True)
    writer.start()
    # Each write that does not fit takes 0.1 s of the writer: a caller that waited for it would
    # need hours for these.
    for k in range(200_000):
        driver.command(float(k), 0.0)
        assert driver.measure() is None
    until(lambda: driver._link.counts['not written'] > 0, driver, 3.0)
    driver.close()
    writer.join(TIME_OUT)
    assert not writer.is_alive()


def test_the_newest_command_is_the_one_that_is_sent(fake):
    there = fake(lambda frame: polite(frame, mode=Mode.RUN))
    driver = make(there.port)
    driver.open()
    driver.enable()
    for k in range(500):
        driver.command(float(k), 0.0)
    until(lambda: there.heard[-1].v == 499)
    driver.disable()
    driver.close()
    commands = [frame for frame in there.heard if isinstance(frame, Command)]
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
def test_mistakes_are_named(parameters, key):
    with pytest.raises(ConfigurationError) as caught:
        make('/dev/null', **parameters)
    assert caught.value.key == key


def test_without_pyserial_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__('sys').modules, 'serial', None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'dz_ros\[serial\]'"):
        make('/dev/null').open()


def test_limits_change_while_it_runs():
    driver = make('/dev/null', limit=4.0)
    flat = driver.configuration.to_flat()
    driver.configure(Configuration.from_flat({**flat, 'driver.limit': 2.0,
                                              'safety.command_hold': 8}))
    assert driver.limit == 2.0
    assert driver._hold_ms == 40
