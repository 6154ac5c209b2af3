# SPDX-License-Identifier: Apache-2.0
"""The driver against the simulated drive: lifecycle, commands, measurements, what it refuses."""

import builtins
from dataclasses import replace
import math
import threading

import pytest

from dz_ros.core.safety.health import Report
from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.states import DriveState
from dz_ros.drivers.conformance.driver_checks import check_contract
from dz_ros.errors import ConfigurationError, DriverError, MissingDependencyError
from dz_ros.files.configurations import load_configuration

S = DriveState


def test_from_nothing_to_a_moving_axis_and_back(drive, until):
    d = drive()
    driver = d.driver()
    driver.open()
    assert d.node.device.state is S.DISABLED
    driver.enable()
    assert d.node.device.state is S.ENABLED
    assert d.node.motor.target == 0            # enabled, but not driven
    until(lambda: driver.command(3.0, 0.0) or d.node.motor.target == 600)  # 3 A × 1 N m/A of 5 N m
    until(lambda: driver.command(3.0, 0.0) or (driver.measure() or (0.0, 0.0))[1] > 0.1)
    assert driver.applied_command() == pytest.approx(3.0)
    driver.safe(0.0, 0.0)
    until(lambda: d.node.device.state is S.QUICK_STOP and d.node.device.standing)
    assert driver.applied_command() == 0.0
    until(lambda: driver.command(-3.0, 0.0) or (
        d.node.device.state is S.ENABLED and d.node.motor.target == -600))
    driver.safe(0.0, 0.0)
    driver.disable()
    assert d.node.device.state is S.DISABLED
    driver.close()
    until(lambda: d.node.canopen.nmt.state == 'PRE-OPERATIONAL')
    assert driver.fault() == 'not connected'
    assert driver.measure() is None


def test_what_the_drive_was_commanded(drive):
    d = drive(driver__quick_stop=5, driver__max_torque=2.0)
    d.driver().open()
    sdo = d.node.canopen.sdo

    def value(index, sub=0):
        found = sdo[index]
        return (found[sub] if hasattr(found, 'keys') else found).raw

    assert value(0x6060) == 10
    assert value(0x605A) == 5
    assert value(0x6072) == 2000
    assert value(0x1016, 1) == 127 << 16 | 1000
    assert value(0x1017) == 50
    assert (value(0x60C2, 1), value(0x60C2, 2)) == (50, -4)     # 5 ms
    assert value(0x1400, 5) == 1000
    assert [value(0x1600, sub) for sub in range(3)] == [2, 0x60400010, 0x60710010]
    assert value(0x1801, 1) == objects.NO_RTR | 0x281       # the drive's bit is kept
    assert value(0x1400, 1) == 0x201
    assert [value(0x1A00, sub) for sub in range(4)] == [3, 0x60410010, 0x60640020, 0x60610008]
    assert (value(0x6007), value(0x605E), value(0x1029, 1)) == (1, 2, 1)
    assert value(0x1802, 1) & objects.NOT_VALID


def test_velocity_mode_and_commands_at_sync(drive, until):
    d = drive(driver__mode='velocity', driver__act_at='sync', driver__speed_per_command=0.1,
              driver__velocity_counts=3600.0)
    driver = d.enabled()
    assert d.node.canopen.sdo[0x6060].raw == 9
    assert d.node.canopen.sdo[0x1400][2].raw == 1
    # 0.2 rad/s of 3600/(2π) per rad/s
    until(lambda: driver.command(2.0, 0.0) or d.node.motor.target == 115)
    until(lambda: driver.command(2.0, 0.0) or (driver.measure() or (0.0, 0.0))[1] > 0.1)


def test_position_alone(drive, until):
    d = drive(driver__velocity_measured=False)
    driver = d.enabled()
    assert driver.measured == 1
    until(lambda: driver.measure() == pytest.approx((0.1,), abs=0.05))
    assert d.node.canopen.sdo[0x1801][1].raw & objects.NOT_VALID


@pytest.mark.parametrize('extrapolate', [True, False])
def test_the_position_is_that_of_the_sample(drive, until, monkeypatch, extrapolate):
    d = drive()
    driver = d.driver(driver__extrapolate=extrapolate)
    driver.open()
    until(driver.measure)
    driver.cycle.stop()
    until(lambda: driver.bus.measurement.synced_at == driver.bus.synced_at)
    d.node.off = True                           # nothing comes any more but what follows
    driver.bus.position.forget()
    monkeypatch.setattr('dz_ros.drivers.cia402.driver.time.monotonic', lambda: 100.0)
    driver.shared.sync([driver.bus])
    receive = driver.bus.network.notify
    receive(0x281, bytearray(bytes.fromhex('000002000000')), 0.0)      # 2 turns/s
    receive(0x181, bytearray(bytes.fromhex('3712000001000a')), 0.0)    # 1 turn
    x = 2.0 * math.pi
    more = 4.0 * math.pi * 0.0015 if extrapolate else 0.0
    monkeypatch.setattr('dz_ros.drivers.cia402.driver.time.monotonic', lambda: 100.003)
    driver.sample_at = 100.0015
    assert driver.measure() == pytest.approx((x + more, 4.0 * math.pi))
    driver.sample_at = 90.0                    # an old one: now is meant
    assert driver.measure() == pytest.approx((x + 2.0 * more, 4.0 * math.pi))
    driver.bus.measurement = replace(driver.bus.measurement, speed=math.nan)
    assert driver.measure()[0] == pytest.approx(x)
    monkeypatch.setattr('dz_ros.drivers.cia402.driver.time.monotonic', lambda: 100.02)
    assert driver.measure() is None


def test_a_command_that_is_not_finite_stops(drive, until):
    d = drive()
    driver = d.enabled()
    until(lambda: driver.command(1.0, 0.0) or d.node.motor.target == 200)
    driver.command(math.nan, 0.0)
    until(lambda: d.node.device.state is S.QUICK_STOP)


def test_a_command_beyond_the_limit_is_held_and_the_limit_is_known(drive, until):
    d = drive()
    driver = d.enabled()
    assert driver.limit == pytest.approx(15.0)
    until(lambda: driver.command(-99.0, 0.0) or d.node.motor.target == -3000)


def test_a_loop_that_falls_silent_is_stopped_and_may_go_on(drive, until):
    d = drive(driver__command_hold=0.02)
    driver = d.enabled()
    assert d.node.device.state is S.ENABLED     # enabled, no command yet: nothing to watch
    driver.command(2.0, 0.0)
    until(lambda: d.node.device.state is S.QUICK_STOP)
    assert driver.fault() == ''
    until(lambda: driver.command(2.0, 0.0) or d.node.device.state is S.ENABLED)
    report = Report()
    driver.report(report)
    assert int(report.values['loop silent']) >= 1
    assert float(report.values['bus round trip p50 [ms]']) > 0.0


@pytest.mark.parametrize('mode', ['torque', 'velocity'])
def test_the_conformance_kit_finds_nothing(drive, mode):
    d = drive(driver__mode=mode, safety__state_hold=200)
    results = {item.name: item for item in check_contract(d.configuration, 1.0, True)}
    for name in ('declaration', 'opens', 'no fault', 'safe command', 'limit', 'stop and reset',
                 'restart', 'reconnect'):       # the others are about time
        assert results[name].passed, results[name]


def test_stops_and_commands_in_quick_turns_are_no_fault(drive, until):
    d = drive()
    driver = d.enabled()
    for _ in range(200):
        driver.command(1.0, 0.0)
        driver.safe(0.0, 0.0)
        assert driver.fault() == ''
    until(lambda: driver.command(1.0, 0.0) or d.node.motor.target == 200)
    assert driver.fault() == ''


def test_a_drive_in_fault_from_before_is_enabled(drive):
    d = drive()
    d.node.fault(0x7500)
    driver = d.enabled()
    assert d.node.device.state is S.ENABLED
    assert driver.fault() == ''


def test_no_drive_there(drive):
    d = drive()
    driver = d.driver(driver__node_id=9, driver__answer_limit=0.05)
    with pytest.raises(DriverError) as caught:
        driver.open()
    assert 'node 9: no answer within 0.05 s: is the drive on' in str(caught.value)


def test_another_motor(drive):
    d = drive(emulated__rated_torque=2.0)
    with pytest.raises(DriverError,
                       match=r'rated_torque = 5 N m: the drive reports 2 N m \(6076h\)'):
        d.driver().open()


def test_another_device_and_a_drive_without_the_mode(drive):
    d = drive()
    d.node.canopen.object_dictionary[0x6502].default = 1
    with pytest.raises(DriverError, match=r'cannot do cyclic synchronous torque: .* = 0x1'):
        d.driver().open()
    d.node.canopen.object_dictionary[0x1000].default = 401
    with pytest.raises(DriverError, match='is no servo drive: its device profile is 401'):
        d.driver().open()


def test_objects_that_a_drive_may_lack_are_reported(drive):
    d = drive()
    for index in (0x60C2, 0x6502, 0x605A, 0x6072):
        del d.node.canopen.object_dictionary[index]
    driver = d.enabled()
    report = Report()
    driver.report(report)
    assert 'quick stop option code (605Ah)' in report.values['objects the drive lacks']
    driver.close()
    del d.node.canopen.object_dictionary[0x6060]
    with pytest.raises(DriverError, match=r'modes of operation \(6060h\): Code 0x06020000'):
        d.driver().open()


def test_no_such_bus():
    pytest.importorskip('can', reason='python-can is not installed')
    for overrides, text in (
            ({'driver.interface': 'nonsense'}, "driver.interface = 'nonsense'"),
            ({'driver.interface': 'udp_multicast', 'driver.channel': '1.2.3.4'}, '1.2.3.4'),
            ({'driver.interface': 'socketcan', 'driver.channel': 'can-99',
              'driver.bus_options': []}, 'can-99')):
        driver = load_configuration('cia402').replace(**overrides).make_driver()
        with pytest.raises(DriverError) as caught:
            driver.open()
        assert text in str(caught.value)
        assert '\n' not in str(caught.value)
        driver.disable()
        driver.close()


def test_without_canopen(monkeypatch):
    real = builtins.__import__

    def refuse(name, *rest, **more):
        if name.split('.')[0] == 'canopen':
            raise ModuleNotFoundError("No module named 'canopen'", name='canopen')
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, '__import__', refuse)
    driver = load_configuration('cia402').make_driver()
    with pytest.raises(MissingDependencyError, match=r"pip install 'dz_ros\[cia402\]'"):
        driver.open()


def test_plants_of_a_higher_order_are_refused():
    configuration = load_configuration('cia402')
    driver = type(configuration.make_driver())

    class Third:
        order = 3

    class Fake:
        plant = Third()

    with pytest.raises(ConfigurationError, match='measures position and velocity'):
        driver(configuration.driver_parameters, Fake())


def test_calls_from_many_threads_at_once(drive, until):
    d = drive()
    driver = d.enabled()
    failures, seen = [], set()

    def hammer(number):
        try:
            for i in range(300):
                if i % 7 == number:
                    driver.safe(0.0, i * 0.005)
                else:
                    driver.command(1.0 + number, i * 0.005)
                driver.advance(i * 0.005, i)
                measured = driver.measure()
                if measured is not None:
                    seen.add(len(measured))
                driver.report(Report())
                assert driver.fault() == ''
        except Exception as error:  # noqa: BLE001  any is a failure
            failures.append(error)

    threads = [threading.Thread(target=hammer, args=(number,)) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert seen <= {2}
    until(lambda: driver.command(0.5, 0.0) or d.node.motor.target == 100)
