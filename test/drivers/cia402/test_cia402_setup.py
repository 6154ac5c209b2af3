# SPDX-License-Identifier: Apache-2.0
"""Drives that are stricter or other than usual: taken as they are and verified, or refused.

Over 300 lines: one test for each way in which a drive is other than usual.
"""

import math

import pytest

from dz_ros.core.safety.health import Level, Report
from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.states import DriveState
from dz_ros.errors import DriverError

S = DriveState
READ_ONLY, OUT_OF_RANGE, NOT_MAPPABLE = 0x06010002, 0x06090030, 0x06040041


def refuse(d, matches, code):
    """Have a drive refuse to be written what matches (index, sub, value)."""
    from canopen.sdo import SdoAbortedError

    def look(index, subindex, od, data):
        if matches(index, subindex, int.from_bytes(data, 'little')):
            raise SdoAbortedError(code)

    d.node.canopen._write_callbacks.insert(0, look)


def lack(d, *indices):
    """Have a drive lack objects."""
    for index in indices:
        del d.node.canopen.object_dictionary[index]


def preset(d, item, value):
    """Have a drive hold a value before it is written."""
    entry = d.node.canopen.object_dictionary[item.index]
    (entry[item.sub] if item.sub else entry).default = value


def held(d, index, sub=0):
    found = d.node.canopen.sdo[index]
    return (found[sub] if hasattr(found, 'keys') else found).raw


def remarks(driver):
    report = Report()
    driver.report(report)
    return report


def moves(d, driver, until):
    """See that it measures and follows a command."""
    until(lambda: driver.command(2.0, 0.0) or d.node.motor.target == 400)
    until(lambda: driver.command(2.0, 0.0) or (driver.measure() or (0.0, 0.0))[1] > 0.05)
    assert driver.fault() == ''


# Communication.

@pytest.mark.parametrize('bit', [0, objects.NO_RTR])
def test_the_bit_for_remote_requests_stays_as_the_drive_has_it(drive, until, monkeypatch, bit):
    monkeypatch.setattr('dz_ros.drivers.cia402.node.DriveNode.request_bit',
                        lambda _node, index: bit if 0x1800 <= index < 0x1804 else 0)
    d = drive()
    moves(d, d.enabled(), until)
    assert held(d, 0x1800, 1) == bit | 0x181
    assert held(d, 0x1802, 1) == objects.NOT_VALID | bit | 0x381


@pytest.mark.parametrize('bit', [0, objects.NO_RTR])
def test_a_drive_that_reports_one_bit_and_takes_the_other(drive, until, monkeypatch, bit):
    monkeypatch.setattr('dz_ros.drivers.cia402.node.DriveNode.request_bit',
                        lambda _node, index: bit if 0x1800 <= index < 0x1804 else 0)
    d = drive()
    refuse(d, lambda index, sub, value: 0x1800 <= index < 0x1804 and sub == 1
           and value & objects.NO_RTR == bit, OUT_OF_RANGE)
    monkeypatch.setattr('dz_ros.drivers.cia402.node.DriveNode.request_bit',
                        lambda _node, index: 0)
    moves(d, d.enabled(), until)
    assert held(d, 0x1800, 1) == (bit ^ objects.NO_RTR) | 0x181


def test_pdos_that_are_fixed_as_they_are_wanted_are_taken(drive, until):
    d = drive()
    driver = d.driver()
    driver.open()
    driver.close()
    refuse(d, lambda index, sub, value: 0x1400 <= index < 0x1C00, READ_ONLY)
    moves(d, d.enabled(), until)


def test_pdos_that_are_fixed_otherwise_are_refused_by_name(drive):
    d = drive()
    refuse(d, lambda index, sub, value: index == 0x1A01, READ_ONLY)
    with pytest.raises(DriverError) as caught:
        d.driver().open()
    assert ('TPDO 2 carries nothing, not velocity actual value (606Ch), torque actual value '
            '(6077h); TPDO 2 mapping (1A01h): Code 0x06010002') in str(caught.value)


def test_a_mode_that_cannot_be_mapped_is_asked_for(drive, until):
    d = drive()
    refuse(d, lambda index, sub, value: 0x1A00 <= index < 0x1A04
           and value == objects.MODE_DISPLAY.mapping, NOT_MAPPABLE)
    driver = d.enabled()
    assert held(d, 0x1A00) == 2
    moves(d, driver, until)
    d.fault('mode', value=8)
    until(driver.fault)
    assert driver.fault() == ('the drive is in another mode: modes of operation display (6061h) '
                              '= 8, not 10')


def test_sync_with_a_counter_is_switched_off_or_refused(drive, until):
    d = drive()
    preset(d, objects.SYNC_COUNTER, 240)
    driver = d.enabled()
    assert held(d, 0x1019) == 0
    driver.disable()
    driver.close()
    d.node.canopen.data_store.pop(0x1019)
    refuse(d, lambda index, sub, value: index == 0x1019, READ_ONLY)
    with pytest.raises(DriverError, match=r'expects SYNC with a counter: .*\(1019h\) = 240'):
        d.driver().open()


def test_a_drive_that_sends_sync_itself_is_stopped_from_it(drive):
    d = drive()
    preset(d, objects.SYNC_ID, 0x40000080)
    driver = d.driver()
    driver.open()
    assert held(d, 0x1005) == 0x80
    driver.close()
    d.node.canopen.data_store.pop(0x1005)
    refuse(d, lambda index, sub, value: index == 0x1005, OUT_OF_RANGE)
    with pytest.raises(DriverError, match=r'takes another SYNC, or sends it: .* = 40000080h'):
        d.driver().open()


def test_an_answer_to_another_masters_request_is_waited_out(drive, until):
    import can
    d = drive()
    driver = d.driver()
    bus = can.Bus(interface='virtual', channel=d.configuration.driver_parameters.channel)
    bus.send(can.Message(arbitration_id=0x601, data=bytes.fromhex('4018100100000000'),
                         is_extended_id=False))
    driver.open()
    item = objects.STATUSWORD
    client = driver.bus.sdo._client
    send = client.send_request

    def between(request):       # another master's answer comes first, once
        client.send_request = send
        client.on_response(0x581, bytes.fromhex('4318100100000000'), 0.0)
        send(request)

    client.send_request = between
    assert driver.bus.sdo.read(item) == d.node.device.statusword
    client.send_request = lambda request: client.on_response(
        0x581, bytes.fromhex('4318100100000000'), 0.0)
    with pytest.raises(DriverError, match=r'statusword \(6041h\): answers what was not asked'):
        driver.bus.sdo.read(item)
    client.send_request = send
    bus.shutdown()


# Mode, limits, state.

@pytest.mark.parametrize('shown', [0, 1, -3])
def test_a_drive_in_another_mode_is_never_enabled(drive, monkeypatch, shown):
    d = drive(driver__transition_limit=0.1)
    value = d.node.value
    d.node.value = lambda index: shown if index == objects.MODE_DISPLAY.index else value(index)
    driver = d.driver()
    with pytest.raises(DriverError, match=r'does not go into mode 10, cyclic synchronous torque: '
                       rf'modes of operation display \(6061h\) = {shown}$'):
        driver.open()
    driver.close()
    assert d.node.device.state is S.DISABLED


def test_a_mode_that_is_taken_late_is_waited_for(drive, until):
    d = drive(driver__transition_limit=20.0)
    value, asked = d.node.value, []

    def slow(index):
        if index == objects.MODE_DISPLAY.index and len(asked) < 30:
            asked.append(index)
            return 0
        return value(index)

    d.node.value = slow
    moves(d, d.enabled(), until)
    assert len(asked) == 30


def test_a_mode_changed_between_open_and_enable_is_found(drive, until):
    d = drive()
    driver = d.driver()
    driver.open()
    d.fault('mode', value=8)
    until(driver.fault)
    with pytest.raises(DriverError, match=r'is not in mode 10 \(6061h = 8\): it is not enabled'):
        driver.enable()
    assert d.node.device.state is S.DISABLED
    driver.recover()        # asks for it again
    driver.enable()
    assert d.node.device.state is S.ENABLED


def test_a_drive_that_holds_itself_to_less_is_refused_and_to_more_is_reported(drive):
    d = drive()
    refuse(d, lambda index, sub, value: index == 0x6072, READ_ONLY)
    preset(d, objects.MAX_TORQUE, 2500)
    with pytest.raises(DriverError, match=r'holds itself to less than driver.max_torque: max '
                       r'torque \(6072h\) = 2500, not 3000'):
        d.driver().open()
    preset(d, objects.MAX_TORQUE, 5000)
    driver = d.driver()
    driver.open()
    assert 'max torque (6072h) is 5000, not 3000: only the host holds to it' in remarks(
        driver).message


def test_a_drive_found_enabled_is_stopped_before_any_setting(drive):
    d = drive()
    d.node.device.state = S.ENABLED
    d.driver().open()
    assert d.node.device.state is not S.ENABLED
    refusing = drive(driver__transition_limit=0.1)
    refusing.node.device.state, refusing.node.device.local = S.ENABLED, True
    with pytest.raises(DriverError, match='was found enabled and does not take a quick stop'):
        refusing.driver().open()


def test_a_drive_in_local_mode_is_not_enabled(drive):
    d = drive(driver__transition_limit=0.2)
    d.node.device.local = True
    driver = d.driver()
    driver.open()
    with pytest.raises(DriverError, match=r'in local mode \(statusword bit 9 is 0\)'):
        driver.enable()


# What it does by itself.

def test_its_own_reactions_are_written(drive):
    d = drive(driver__abort_connection=3, driver__fault_reaction=0, driver__quick_stop=5)
    driver = d.driver()
    driver.open()
    device = d.node.device
    assert (device.abort_connection, device.fault_reaction, device.quick_stop_code) == (3, 0, 5)
    assert held(d, 0x1029, 1) == 1
    assert 'the drive:' not in remarks(driver).message


@pytest.mark.parametrize(('missing', 'words'), [
    ((0x6007,), 'abort connection option code (6007h) is missing'),
    ((0x1016, 'timer'),
     'it takes neither consumer heartbeat time (1016h:01) nor the event timer')])
def test_a_drive_that_would_not_stop_by_itself_is_refused_or_warned_of(
        drive, until, missing, words):
    d = drive()
    lack(d, *(index for index in missing if index != 'timer'))
    if 'timer' in missing:
        refuse(d, lambda index, sub, value: (index, sub) == (0x1400, 5), OUT_OF_RANGE)
    with pytest.raises(DriverError) as caught:
        d.driver().open()
    assert 'would not stop by itself when host, bus or NMT is gone: ' + words in str(caught.value)
    assert 'driver.unsupervised = true drives it all the same' in str(caught.value)
    driver = d.enabled(driver__unsupervised=True)
    moves(d, driver, until)
    report = remarks(driver)
    assert words in report.message
    assert report.level is Level.WARN


def test_a_drive_whose_reaction_stays_off_is_refused(drive):
    d = drive()
    preset(d, objects.ABORT_CONNECTION, 0)
    refuse(d, lambda index, sub, value: index == 0x6007, OUT_OF_RANGE)
    with pytest.raises(DriverError, match=r'abort connection option code \(6007h\) stays 0'):
        d.driver().open()


def test_other_reactions_than_asked_for_are_reported(drive):
    d = drive()
    refuse(d, lambda index, sub, value: index in (0x6007, 0x605A, 0x605E, 0x1029), OUT_OF_RANGE)
    preset(d, objects.ABORT_CONNECTION, 2)
    driver = d.driver()
    driver.open()
    message = remarks(driver).message
    for words in ('quick stop option code (605Ah) is 2, not 6',
                  'error behaviour, communication error (1029h:01) is 0, not 1',
                  'abort connection option code (6007h) is 2, not 1'):
        assert words in message
    assert '605Eh' not in message               # it has what was asked for


# Counters.

TRIES = 5


def turns(start, until, number):
    """Drive an axis over this number of turns; return x at the end, and that of the plant.

    A stall of the machine is a fault of a narrow counter: with another axis it is tried again.
    """
    goal = 2.0 * math.pi * number
    for _ in range(TRIES):
        d = start()
        driver = d.enabled()
        until(lambda d=d, driver=driver: driver.command(8.0, 0.0) or driver.fault()
              or d.node.motor.plant.x[0] > goal)
        if not driver.fault().startswith('no position for '):
            break
        driver.close()
    assert driver.fault() == ''
    driver.safe(0.0, 0.0)
    until(lambda: d.node.device.standing and d.node.device.state is S.QUICK_STOP)
    until(lambda: abs((driver.measure() or (0.0, 1.0))[1]) < 0.05)
    x = d.node.motor.plant.x[0]       # it stands: a measurement that is a little older will do
    return driver.bus.measurement.x, x


@pytest.mark.slow
@pytest.mark.parametrize('counts', [65536, 65536 * 2])
def test_a_modulo_axis_is_followed_over_its_turns(drive, until, counts):
    measured, true = turns(lambda: drive(emulated__position_range=counts), until,
                           2.3 * counts / 65536)
    assert measured == pytest.approx(true, abs=0.05)
    assert measured > 2.0 * math.pi * counts / 65536 * 2


@pytest.mark.slow
def test_a_narrow_counter_not_configured_is_a_fault_and_can_be_configured(drive, until):
    d = drive(emulated__position_range=65536, emulated__reports_range=False)
    driver = d.enabled()
    until(lambda: driver.command(8.0, 0.0) or driver.fault())
    assert 'the position jumps by -6' in driver.fault()
    assert 'driver.position_range' in driver.fault()
    until(lambda: d.node.device.state is S.QUICK_STOP)
    until(lambda: driver.measure() is None)
    driver.close()
    measured, true = turns(lambda: drive(
        emulated__position_range=65536, emulated__reports_range=False,
        driver__position_range=65536), until, 2.3)
    assert measured == pytest.approx(true, abs=0.05)


def test_a_range_that_is_no_whole_turn_is_refused(drive):
    d = drive(emulated__position_range=50_000)
    with pytest.raises(DriverError) as caught:
        d.driver().open()
    assert 'its position begins again after 0 … 49999 (607Bh), no whole number of' in str(
        caught.value)
    assert 'driver.position_range (50000 or 49999), or set 607Bh to 0' in str(caught.value)
    d.driver(driver__position_range=50_000).open()


def test_a_range_of_all_32_bits_is_none(drive):
    d = drive()
    preset(d, objects.RANGE_LOWEST, -2 ** 31)
    d.node.canopen.set_data(0x607B, 2, (2 ** 31 - 1).to_bytes(4, 'little'))
    driver = d.driver()
    driver.open()
    assert not driver.bus.position.narrow


def test_a_narrow_counter_that_was_not_received_too_long_is_not_driven_on(drive, until):
    d = drive(emulated__position_range=65536, driver__answer_limit=1.0)
    driver = d.enabled()
    until(lambda: driver.command(8.0, 0.0) or (driver.measure() or (0.0, 0.0))[1] > 3.0)
    d.fault('restart', duration=0.0)
    until(driver.fault)
    with pytest.raises(DriverError, match=r'has restarted and has lost its position \(its counter '
                       r'has 65536 values\): home it'):
        driver.recover()
