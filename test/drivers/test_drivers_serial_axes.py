# SPDX-License-Identifier: Apache-2.0
"""Several axes at one serial device: on a real port, before a device of the package that lies.

Over 300 lines: all of it needs the same device of several motors.
"""

from dataclasses import replace
import itertools
import json
from pathlib import Path
import time

import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.rules import check
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.safety.health import Report
from dz_ros.drivers.beside import Beside, beside_others
from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.drivers.serial.protocol import Mode, Request, State
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files.configurations import load_configuration

pytest.importorskip('serial', reason="pyserial is not installed: pip install 'dz_ros[serial]'")

TIME_OUT = 60.0
SERVO = Path(__file__).parents[2] / 'config' / 'servo.yaml'
AXES = ('x', 'y', 'z')
PATIENT = {'fresh': 400, 'silence': 20.0, 'watchdog': 1.0, 'patience': 30.0, 'device_rate': 400.0}
"""A machine that others use as well stalls for longer than the defaults allow."""


def machine(port, axes=AXES, **keys):
    """Return the configuration of axes with a serial driver; keys with __ for dots."""
    flat = {'loop.axes': list(axes), 'driver.name': 'serial', 'driver.port': port,
            **{f'driver.{key}': value for key, value in PATIENT.items()},
            **{key.replace('__', '.'): value for key, value in keys.items()}}
    return load_configuration(SERVO, [f'{key}={str(value).replace(chr(39), "")}'
                                      for key, value in flat.items()])


class Machine:
    """Hosted drivers of some axes, driven as a node drives them; v is what the law wants."""

    def __init__(self, port, **keys):
        self.hosted = HostedDrivers(machine(port, **keys))
        self.v = tuple(1.0 + place for place in range(len(self.hosted.each)))
        self.rows = []

    @property
    def link(self):
        return self.hosted.driver.link

    def until(self, condition, samples=True):
        """Drive until a condition holds."""
        deadline = time.monotonic() + TIME_OUT
        while not condition():
            assert time.monotonic() < deadline, (self.hosted.fault(), self.link.newest())
            if samples:
                self.rows.append(self.hosted.measure(0.0))
                self.hosted.command(self.v, 0.0)
            time.sleep(0.004)

    def start(self):
        self.hosted.open()
        self.hosted.enable()
        return self

    def recovered(self):
        return not self.hosted.recover()


@pytest.fixture
def machines(liars):
    """Return a function that gives a device and the machine that it runs."""
    made = []

    def give(motors=3, **keys):
        liar = liars(motors)
        found = Machine(liar.port, axes=AXES[:motors], **keys)
        made.append(found)
        found.start()
        found.until(lambda: liar.device.mode is Mode.RUN)
        return liar, found

    yield give
    for item in made:
        item.hosted.disable((0.0,) * len(item.v), 0.0)
        item.hosted.close()


def passed(liar, count=100):
    """Return a condition: this number of more commands have come."""
    goal = len(liar.commands) + count
    return lambda: len(liar.commands) >= goal


def test_all_motors_are_commanded_by_one_frame_and_measured_by_one(machines):
    liar, found = machines()
    found.until(passed(liar))
    running = [frame for frame in liar.commands if frame.request is Request.RUN]
    assert {frame.v for frame in running} == {(1000, 2000, 3000)}
    assert len({frame.seq for frame in running}) == len(running)
    assert (1000, 2000, 3000) in liar.given
    assert [item.driver.applied_command() for item in found.hosted.each] == pytest.approx(
        [1.0, 2.0, 3.0])
    count = itertools.count()       # each state has another measurement, one of all motors
    values = [0]

    def measured(motor):
        values[0] = next(count) if motor == 0 else values[0]
        return values[0] + motor, 0
    liar.measured = measured
    start, states = len(found.rows), found.link.counts['states']
    found.until(lambda: found.link.counts['states'] > states + 200)
    rows = [row for row in found.rows[start:] if row is not None]
    assert len({row[0] for row in rows}) > 20
    for x, y, z in rows[1:]:
        assert (y[0] - x[0], z[0] - x[0]) == pytest.approx((1e-3, 2e-3))


def test_axes_choose_their_motors(machines):
    liar, found = machines(axes__x__driver__motor=2, axes__z__driver__motor=0)
    found.until(lambda: (3000, 2000, 1000) in liar.given)
    assert [row[0] for row in found.hosted.measure(0.0)] == pytest.approx([0.102, 0.101, 0.1])


def test_each_motor_has_its_own_scale_and_limit(machines):
    liar, found = machines(axes__y__driver__command_scale=2e-3, axes__y__driver__limit=1.5,
                           axes__z__driver__state_scales='[1.0, 1.0]')
    found.v = (100.0, 100.0, 0.0)
    found.until(lambda: (30000, 750, 0) in liar.given)
    assert [item.limit for item in found.hosted.each] == pytest.approx([30.0, 1.5, 30.0])
    assert found.hosted.measure(0.0)[2] == pytest.approx((102.0, 0.0))


def test_a_trip_of_one_motor_takes_the_power_of_all_and_names_its_axis(machines):
    liar, found = machines()
    liar.faults[1] = 7
    found.until(found.hosted.fault)
    assert found.hosted.fault() == 'axis y: the device reports fault 7'
    assert liar.given[-1] is None
    given = len(liar.given)
    found.until(passed(liar, 20))
    assert set(liar.given[given:]) == {None}
    refused = found.hosted.recover()
    assert refused.startswith('axis y: ')
    assert refused.endswith('the device does not leave its fault: the device reports fault 7')
    liar.faults[1] = 0
    found.until(found.recovered)
    assert found.hosted.fault() == ''
    found.until(lambda: liar.device.mode is Mode.RUN)


def test_a_motor_in_fault_from_before_is_named_by_its_axis_when_power_is_refused(liars):
    liar = liars(3)
    liar.faults[2] = 4
    found = Machine(liar.port)
    found.hosted.open()
    try:
        with pytest.raises(DriverError, match=r'axis z: .*does not leave its fault: the device '
                                              'reports fault 4'):
            found.hosted.enable()
        assert not any(item.enabled for item in found.hosted.each)
        assert set(liar.given) == {None}
        liar.faults[2] = 0
        found.hosted.enable()
        found.until(lambda: liar.device.mode is Mode.RUN)
    finally:
        found.hosted.disable((0.0,) * 3, 0.0)
        found.hosted.close()
    assert liar.device.mode is Mode.DISABLED


def test_what_is_of_the_device_is_stated_once_for_all_axes(machines):
    liar, found = machines(driver__silence=0.5, driver__watchdog=0.2)
    liar.change = lambda state: []
    found.until(found.hosted.fault)
    found.until(lambda: 'sent nothing' in found.hosted.fault())
    assert found.hosted.fault() == 'axes x, y, z: the device has sent nothing for 0.5 s'
    found.until(lambda: liar.device.mode is not Mode.RUN)     # its own watchdog
    liar.change = lambda state: [state]
    found.until(lambda: found.link.newest() is not None)
    given = len(liar.given)
    found.until(passed(liar, 20))
    assert set(liar.given[given:]) <= {None}      # no power before the reset
    found.until(found.recovered)
    found.until(lambda: liar.device.mode is Mode.RUN)


def test_one_axis_that_stops_stops_all_at_once(machines):
    liar, found = machines()
    count = len(liar.commands)
    found.hosted.each[1].safe(0.5, 0.0)         # and no other axis is asked anything
    found.until(lambda: liar.device.mode is Mode.SAFE and liar.given[-1] == (0, 500, 0),
                samples=False)
    # One command may have been on its way.
    assert Request.SAFE in [item.request for item in liar.commands[count:count + 2]]
    found.until(lambda: liar.device.mode is Mode.RUN)


def test_an_axis_that_commands_nothing_lets_no_command_through(machines):
    liar, found = machines(driver__watchdog=0.2)
    x, y, _ = found.hosted.each
    last = [frame.seq for frame in liar.commands][-1]

    def silent():
        x.command(9.0, 0.0)
        y.command(9.0, 0.0)
        return liar.device.mode is Mode.SAFE
    found.until(silent, samples=False)          # the device's watchdog
    assert all(frame.v == (1000, 2000, 3000) for frame in liar.commands if frame.seq > last)
    found.until(lambda: liar.device.mode is Mode.RUN)
    assert (9000, 9000, 3000) not in liar.given


def test_nan_for_one_axis_is_its_fault_and_nothing_is_sent(machines):
    liar, found = machines()
    last = liar.commands[-1].seq
    found.v = (1.0, float('nan'), 3.0)
    for _ in range(20):
        found.hosted.command(found.v, 0.0)
    assert found.hosted.fault().startswith('axis y: command: ValueError: ')
    found.v = (1.0, 2.0, 3.0)
    found.until(passed(liar, 5))
    assert {frame.v for frame in liar.commands if frame.seq > last and
            frame.request is Request.RUN} <= {(1000, 2000, 3000)}
    assert found.recovered()


def test_what_is_left_of_an_earlier_sample_is_not_sent(machines):
    liar, found = machines()
    found.hosted.each[2].command(9.0, 0.0)      # out of its turn, then in order again
    found.until(passed(liar, 20))
    assert {frame.v for frame in liar.commands if frame.request is Request.RUN} == {
        (1000, 2000, 3000)}


@pytest.mark.parametrize(('lie', 'words'), [
    (lambda s: replace(s, faults=(0, 9, 0)), 'reports fault 9 of motor 1 in mode run'),
    (lambda s: replace(s, mode=Mode.SAFE), 'is in mode safe, asked for run'),
    (lambda s: replace(s, trips=(s.trips + 1) % 256), 'has tripped'),
    (lambda s: replace(s, echo=s.echo + 10 ** 6), 'which was not sent to it'),
    (lambda s: replace(s, faults=s.faults[:2], values=s.values[:2]),
     'another number of axes: the device has 2 motors (version 2 of the protocol), at this port '
     'are 3 axes'),
    (lambda s: replace(s, faults=s.faults[:1], values=s.values[:1]),
     'another number of axes: the device has 1 motor (version 1 of the protocol), at this port '
     'are 3 axes'),
])
def test_a_lie_stops_every_axis_until_the_operator_resets(machines, lie, words):
    liar, found = machines()
    liar.change = lambda state: [lie(state)]
    found.until(lambda: words in found.hosted.fault())
    assert found.hosted.fault().startswith('axes x, y, z: ')
    found.until(lambda: liar.device.mode is not Mode.RUN)
    liar.change = lambda state: [state]
    given = len(liar.given)
    found.until(lambda: found.link.newest() is not None)
    found.until(passed(liar, 20))
    assert (1000, 2000, 3000) not in liar.given[given:]
    found.until(found.recovered)
    found.until(lambda: liar.device.mode is Mode.RUN)


@pytest.mark.parametrize(('motors', 'axes', 'words'), [
    (3, 2, '3 motors (version 2 of the protocol), at this port are 2 axes'),
    (8, 2, '8 motors (version 2 of the protocol), at this port are 2 axes'),
    (1, 2, '1 motor (version 1 of the protocol), at this port are 2 axes'),
    (2, 1, '2 motors (version 2 of the protocol), at this port is 1 axis'),
    (8, 1, '8 motors (version 2 of the protocol), at this port is 1 axis'),
])
def test_another_number_of_motors_is_refused(liars, motors, axes, words):
    liar = liars(motors)
    found = machine(liar.port, axes=AXES[:axes]).make_drivers()
    try:
        with pytest.raises(DriverError) as caught:
            found[0].open()
        assert str(caught.value) == f'{liar.port}: another number of axes: the device has {words}'
    finally:
        found[0].close()
    assert liar.device.mode is Mode.DISABLED
    assert set(liar.given) == {None}
    assert liar.commands == []


def test_a_device_of_several_motors_that_measures_too_little_names_the_axis(liars):
    liar = liars(2)
    liar.measured = lambda motor: (motor,)
    liar.change = lambda item: [item]
    found = Machine(liar.port, axes=('x', 'y'), axes__x__driver__measured=1)
    restart = liar.restart

    def one_value():
        restart()
        info = liar.device._info
        liar.device._info = replace(info, each=tuple(
            replace(motor, state_scales=motor.state_scales[:1]) for motor in info.each))
    one_value()
    with pytest.raises(DriverError, match=r"axis y: .*'bench' measures 1 of the 2 values wanted"):
        found.hosted.open()
    found.hosted.close()


@pytest.mark.parametrize(('keys', 'key', 'words'), [
    ({'axes__y__driver__motor': 0}, 'axes.y.driver.motor', 'is the motor of axis x as well'),
    ({'axes__x__driver__motor': 1}, 'axes.y.driver.motor', 'is the motor of axis x as well'),
    ({'axes__z__driver__motor': 3}, 'axes.z.driver.motor', 'must be below 3, the number of axes'),
    ({'driver__motor': 8}, 'driver.motor', 'must be'),
    ({'axes__z__driver__baudrate': 115200}, 'axes.z.driver.baudrate', 'must be 921600, as of'),
    ({'axes__y__driver__measured': 3}, 'axes.y.driver.measured', 'must be at most 2'),
    ({'axes__y__driver__state_scales': '[1.0]'}, 'axes.y.driver.state_scales', 'must have 2'),
    ({'axes__z__driver__silence': 3.0}, 'axes.z.driver.silence', 'must be 20.0, as of'),
    ({'axes__y__driver__port': '/dev/other', 'axes__y__driver__motor': 1}, 'axes.y.driver.motor',
     'must be below 1'),
    ({'driver__device_rate': 1000.0, 'driver__baudrate': 460800}, 'driver.device_rate',
     'needs 126% of a line'),
    ({'axes': tuple(f'a{k}' for k in range(9))}, 'axes.a8.driver.port', 'that of 9 axes'),
])
def test_axes_that_do_not_go_together_are_named(keys, key, words):
    with pytest.raises(ConfigurationError) as caught:
        machine('/dev/null', **keys)
    assert caught.value.key == key
    assert str(caught.value).startswith(f'{key} = ')
    assert words in str(caught.value)


def test_axes_at_two_ports_are_two_devices(liars):
    first, second = liars(2), liars(1)
    found = Machine(first.port, axes__y__driver__port=second.port)
    found.start()
    try:
        found.until(lambda: (1000, 3000) in first.given and (2000,) in second.given)
        second.change = lambda state: [replace(state, mode=Mode.SAFE)]
        found.until(lambda: 'axis y: the device is in mode safe' in found.hosted.fault())
    finally:
        found.hosted.disable((0.0,) * 3, 0.0)
        found.hosted.close()
    assert first.device.mode is second.device.mode is Mode.DISABLED


def test_the_device_is_reported_once(machines):
    _, found = machines(2)
    report = Report()
    found.hosted.report(report)
    assert [key for key in report.values if key.endswith('device mode')] == ['x: device mode']
    assert {key for key in report.values if key.endswith('device fault')} == {
        'x: device fault', 'y: device fault'}
    assert report.level == 0
    liar_states = found.link.refused.counts
    assert set(found.hosted.refused()) == {f'x: {cause}' for cause in liar_states}


def test_the_shortest_hold_of_the_axes_is_that_of_the_device(machines):
    liar, found = machines(2)
    found.until(passed(liar, 5))
    assert liar.commands[-1].hold_ms == 1000
    flat = found.hosted.each[0].driver.configuration.to_flat()
    found.hosted.each[1].configure(Configuration.from_flat({**flat, 'driver.watchdog': 0.3}))
    found.until(lambda: liar.commands[-1].hold_ms == 300)
    assert isinstance(found.link.newest()[0], State)


def test_an_axis_of_any_motor_is_asked_alone_and_opened_with_the_others(tmp_path):
    c = machine(tmp_path / 'none', ('pan', 'tilt'), axes__pan__driver__motor=1,
                axes__tilt__driver__motor=0)
    assert all(check(item) for item in c.each)
    assert set(simulate_axes(c.replace(**{'loop.duration': 0.1}))) == {'pan', 'tilt'}
    alone = c.axis('pan').make_driver()
    assert alone.measured == 2
    with pytest.raises(DriverError, match=r'^driver.motor = 1: must be below 1, the number of'):
        alone.open()


def test_one_motor_is_commanded_beside_the_others_at_their_safe_command(liars):
    liar = liars(3)
    hosted = beside_others(machine(liar.port, axes__z__safety__safe_command=0.5), 'y',
                           all_faults=True)
    assert hosted.others == ('x', 'z')
    hosted.open()
    hosted.enable()
    try:
        def until(condition):
            deadline = time.monotonic() + TIME_OUT
            while not condition():
                assert time.monotonic() < deadline, hosted.fault()
                hosted.measure(0.0)
                assert hosted.command(99.0, 0.0) == 30.0        # its limit
                time.sleep(0.004)

        until(lambda: (0, 30000, 500) in liar.given)
        assert hosted.measure(0.0)[0] == pytest.approx(0.101)
        assert {item for item in liar.given if item} == {(0, 0, 500), (0, 30000, 500)}
        liar.faults[2] = 7
        until(hosted.fault)
        assert hosted.fault() == 'axis z: the device reports fault 7'
        assert hosted.own.fault() == ''
        assert hosted.recover().startswith('axis z: ')
        liar.faults[2] = 0
        until(lambda: not hosted.recover())
    finally:
        assert hosted.disable(0.0, 0.0) == ''
        hosted.close()
    assert liar.device.mode is Mode.DISABLED


def test_the_kit_wants_the_faults_of_the_axis_itself(liars):
    liar = liars(2)
    every = HostedDrivers(machine(liar.port, AXES[:2]))
    hosted = Beside(every, 0)
    hosted.open()
    hosted.enable()
    try:
        liar.faults[1] = 7
        deadline = time.monotonic() + TIME_OUT
        while not every.fault():
            assert time.monotonic() < deadline
            hosted.command(1.0, 0.0)
            time.sleep(0.004)
        assert hosted.fault() == ''
        assert hosted.recover() == ''
    finally:
        hosted.disable(0.0, 0.0)
        hosted.close()


def test_an_axis_of_one_device_needs_no_others(liars):
    first, second = liars(2), liars(1)
    c = machine(first.port, axes__y__driver__port=second.port)
    assert beside_others(c, 'y') is None
    assert beside_others(c, 'x').others == ('z',)       # y is at the other port
    assert beside_others(c, None) is None
    assert beside_others(c.axis('x'), 'x') is None


def test_identifying_one_board_gives_another_no_power(liars):
    alone, shared = liars(1), liars(2)
    held = beside_others(machine(shared.port, axes__x__driver__port=alone.port), 'y', True)
    assert held.others == ('z',)
    held.open()
    held.enable()
    try:
        deadline = time.monotonic() + TIME_OUT
        while shared.device.mode is not Mode.RUN:
            assert time.monotonic() < deadline, held.fault()
            held.command(1.0, 0.0)
            time.sleep(0.004)
    finally:
        assert held.let_go(0.0, 0.0) == ''
    assert shared.device.mode is Mode.DISABLED
    assert alone.device.mode is Mode.DISABLED
    assert alone.commands == []


@pytest.mark.parametrize('latched', [Mode.FAULT, Mode.ESTOP])
def test_without_an_operator_a_trip_or_an_e_stop_lasts(liars, latched):
    liar = liars(2)
    held = beside_others(machine(liar.port, AXES[:2]), 'y', True)
    held.open()
    held.enable()

    def until(condition):
        deadline = time.monotonic() + TIME_OUT
        while not condition():
            assert time.monotonic() < deadline, held.fault()
            held.command(1.0, 0.0)
            time.sleep(0.004)

    try:
        until(lambda: liar.device.mode is Mode.RUN)
        assert held.resume() == ''
        if latched is Mode.FAULT:
            liar.faults[1] = 7
            until(held.fault)
            assert held.fault() == 'axis y: the device reports fault 7'     # its own
            liar.faults[1] = 0
        else:
            liar.device.mode = Mode.ESTOP
            until(held.fault)
        requests = len(liar.commands)
        assert held.resume()
        until(lambda: len(liar.commands) > requests + 20)
        assert liar.device.mode is latched
        assert Request.RESET not in {item.request for item in liar.commands[requests:]}
        until(lambda: not held.recover())       # the operator's
        until(lambda: liar.device.mode is Mode.RUN)
    finally:
        held.let_go(0.0, 0.0)
    assert liar.device.mode is Mode.DISABLED


def test_the_kit_checks_one_axis_of_a_board(liars, capsys, monkeypatch):
    monkeypatch.setattr('dz_ros.cli.driver.check.find_spec', lambda _name: None)
    monkeypatch.setattr('dz_ros.cli.driver.stop_requests.find_spec', lambda _name: None)
    monkeypatch.setattr('dz_ros.drivers.conformance.driver_checks.RUN_DURATION', 0.3)
    liar = liars(2)
    keys = (f'driver.port={liar.port}', 'driver.name=serial', 'loop.axes=[x, y]',
            *(f'driver.{key}={value}' for key, value in PATIENT.items()))
    main(['driver', 'check', '--config', str(SERVO), '--axis', 'y', '--yes', '--json',
          *(word for key in keys for word in ('--set', key))])
    printed, beside = capsys.readouterr()
    assert 'its device is that of x too: enabled with it, at the safe command\n' in beside
    found = {item['name']: item for item in map(json.loads, printed.splitlines())}
    for name in ('opens', 'safe command', 'stop and reset', 'restart', 'reconnect'):
        assert found[name]['passed'], found[name]
    assert found['as a node']['words'] == 'its device is that of other axes too'
    assert {item[0] for item in liar.given if item} == {0}
    assert len({item[1] for item in liar.given if item}) > 1
