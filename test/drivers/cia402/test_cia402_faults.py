"""Faults of drive and bus: told once, latched, the drive stopped, left by recover."""

import pytest

from dz_ros.core import schema
from dz_ros.drivers.cia402.emulator import Cia402Emulator, EmulatedParameters, FAULTS
from dz_ros.drivers.cia402.states import DriveState
from dz_ros.drivers.emulators import Fault
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files import load_configuration

S = DriveState


def moving(d, until, **overrides):
    """Return an enabled driver under a command that acts."""
    driver = d.enabled(**overrides)
    walk = driver._cycle._walk
    until(lambda: driver.command(2.0, 0.0) or (d.node._motor.target == 400 and walk._arrived))
    return driver


def back(d, driver, until):
    """Recover and drive again."""
    driver.recover()
    assert driver.trouble() == ''
    driver.command(2.0, 0.0)
    until(lambda: d.node.device.state is S.ENABLED and d.node._motor.target == 400)
    until(lambda: driver.measure() is not None)


@pytest.mark.parametrize(('fault', 'trouble', 'state'), [
    ('emcy', 'EMCY 2310h (Current), error register 01h', S.FAULT),
    ('heartbeat', 'no heartbeat for 1 s', S.QUICK_STOP),
    ('torque-off', 'the drive has left operation enabled by itself: switch on disabled',
     S.DISABLED)])
def test_a_fault_is_latched_until_recover(drive, until, fault, trouble, state):
    d = drive()
    driver = moving(d, until)
    d.fault(fault, duration=5.0)
    # The loop goes on commanding until it is told; that must not move the drive.
    until(lambda: driver.command(2.0, 0.0) or driver.trouble())
    assert driver.trouble() == trouble
    until(lambda: driver.command(2.0, 0.0) or d.node.device.state is state)
    assert driver.trouble() == trouble
    back(d, driver, until)


def test_a_drive_that_restarts(drive, until):
    d = drive(driver__heartbeat_hold=20.0)
    driver = moving(d, until)
    d.fault('restart', duration=0.0)
    until(driver.trouble)
    assert driver.trouble() == 'the drive has restarted'
    assert d.node._node.sdo[0x1017].raw == 0            # it has forgotten what it was told
    until(lambda: driver.measure() is None)
    back(d, driver, until)
    assert d.node._node.sdo[0x1017].raw == 50


def test_a_drive_that_restarts_where_nobody_hears_it(drive, until):
    d = drive(driver__absolute_encoder=False)
    driver = moving(d, until)
    d.fault('restart', duration=2.0)
    until(driver.trouble)
    assert driver.trouble() == 'no heartbeat for 1 s'
    until(lambda: not d.node._off)
    driver._bus.restarted = False       # the boot-up message was lost
    with pytest.raises(DriverError, match='has restarted and has lost its position'):
        driver.recover()
    assert driver.trouble()


def test_bus_off_of_the_drive(drive, until):
    d = drive(driver__answer_limit=0.05)
    driver = moving(d, until)
    d.fault('bus-off', duration=2.5)
    until(driver.trouble)
    assert driver.trouble() == 'no heartbeat for 1 s'
    with pytest.raises(DriverError, match='no answer within'):
        driver.recover()
    assert driver.trouble()
    until(lambda: 'end of fault bus-off' in d.said)
    assert d.node.device.state in (S.FAULT, S.REACTING)    # its own watchdog: EMCY 8250h, unheard
    assert d.node.device.error_code in (0x8250, 0x8130)
    back(d, driver, until)


def test_bus_off_of_our_own_interface_is_an_error_frame(drive, until):
    import can
    d = drive()
    driver = moving(d, until)
    with can.Bus(interface='virtual',
                 channel=d.configuration.driver_parameters.channel) as other:
        other.send(can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8, data=bytes(8)))
        until(driver.trouble)
    assert driver.trouble() == 'bus off: too many errors on the CAN bus'
    old = driver._bus
    back(d, driver, until)
    assert driver._bus is not old


def test_an_adapter_that_is_pulled_out_and_put_in_again(drive, until, monkeypatch):
    import can
    d = drive()
    driver = moving(d, until)
    real = can.Bus

    def gone(*_words, **_more):
        raise can.CanOperationError('No such device')

    driver._bus._network.bus.send = gone
    until(driver.trouble)
    assert driver.trouble() == 'the bus has gone: No such device'
    monkeypatch.setattr(can, 'Bus', gone)
    with pytest.raises(DriverError, match='no CAN bus at driver'):
        driver.recover()
    assert 'has gone' in driver.trouble()
    driver.command(1.0, 0.0)            # nothing of this may raise or wait
    assert driver.measure() is None
    monkeypatch.setattr(can, 'Bus', real)
    back(d, driver, until)


def lose_the_bus(driver, until):
    """Have our adapter go bus off."""
    driver._bus._on_error_frame(0x40)
    until(driver.trouble)
    assert driver._bus.broken


def beyond_the_wrap(d, driver, until):
    """Have driver and drive past the end of the 32 bits of the position; return x of a whole."""
    whole = 2 ** 32 * abs(driver._scaling.position)
    driver._bus._unwrap._last += 2 ** 32        # as after so many turns
    until(lambda: (driver.measure() or (0.0,))[0] > 0.9 * whole)
    return whole


def test_the_turns_are_not_forgotten_where_the_drive_did_not_restart(drive, until):
    d = drive()
    driver = moving(d, until)
    driver.safe(0.0, 0.0)
    whole = beyond_the_wrap(d, driver, until)
    before = driver.measure()[0]
    lose_the_bus(driver, until)
    back(d, driver, until)
    until(driver.measure)
    assert driver.measure()[0] == pytest.approx(before, abs=0.1 * whole)


def test_the_turns_of_a_drive_that_restarts_are_gone(drive, until):
    d = drive()
    driver = moving(d, until)
    driver.safe(0.0, 0.0)
    whole = beyond_the_wrap(d, driver, until)
    lose_the_bus(driver, until)
    driver._bus.restarted = True
    back(d, driver, until)
    until(driver.measure)
    assert abs(driver.measure()[0]) < 0.1 * whole


def test_receiving_that_fails_is_trouble_too(drive, until):
    import can
    d = drive()
    driver = moving(d, until)

    def gone(_timeout):
        raise can.CanOperationError('read failed')

    driver._bus._network.bus.recv = gone
    until(driver.trouble)
    assert driver.trouble() == 'the bus has gone: read failed'
    back(d, driver, until)


def test_a_fault_that_lasts(drive, until):
    d = drive(driver__transition_limit=0.2)
    driver = moving(d, until)
    d.fault('stuck', value=0x7305, duration=1.0)
    until(driver.trouble)
    with pytest.raises(DriverError, match=r'remains in fault; error code \(603Fh\) 7305h'):
        driver.recover()
    assert driver.trouble() == 'the drive remains in fault'
    until(lambda: 'end of fault stuck' in d.said)
    back(d, driver, until)


def test_pdos_that_stay_away_are_no_measurement(drive, until):
    d = drive()
    driver = moving(d, until)
    d.fault('no-pdo', duration=0.5)
    until(lambda: driver.measure() is None)
    until(lambda: driver.command(2.0, 0.0) or driver.measure() is not None)
    assert driver.trouble() == ''


def test_the_drive_stops_by_itself_when_our_process_is_gone(drive, until):
    d = drive()
    driver = moving(d, until)
    cycle, driver._cycle = driver._cycle, None
    cycle.stop()                        # as a process that is frozen: no command, no heartbeat
    until(lambda: d.node.device.state is S.FAULT)
    assert d.node.device.error_code in (0x8250, 0x8130)


def test_a_drive_that_is_told_to_leave_operational_is_trouble(drive, until):
    d = drive()
    driver = moving(d, until)
    driver._bus.nmt(0x80)
    until(driver.trouble)
    assert driver.trouble() == 'the drive has left NMT state operational: pre-operational'
    back(d, driver, until)


def test_nonsense_on_the_bus_is_no_trouble(drive, until):
    import can
    d = drive()
    driver = moving(d, until)
    with can.Bus(interface='virtual',
                 channel=d.configuration.driver_parameters.channel) as other:
        for identifier in (0x81, 0x181, 0x281, 0x701, 0x581, 0x0, 0x80, 0x201, 0x77F):
            for data in (b'', b'\x05', b'\x7f' * 2):
                if (identifier, data[:1]) != (0x701, b'\x7f'):
                    other.send(can.Message(arbitration_id=identifier, data=data,
                                           is_extended_id=False))
        other.send(can.Message(arbitration_id=0x81, data=bytes(8), is_extended_id=False))
    driver.command(1.0, 0.0)
    until(lambda: d.node._motor.target == 200)
    assert driver.trouble() == ''


def test_faults_on_a_script_begin_with_the_first_command_that_moves(drive, until):
    script = [Fault.parse('emcy@0.05=9040', FAULTS)]
    d = drive()
    d.emulator._pending = script
    driver = d.enabled()
    assert not d.node.moved
    driver.command(2.0, 0.0)
    until(driver.trouble)
    assert driver.trouble().startswith('EMCY 2350h')
    assert 'fault emcy' in d.said


def test_any_master_asks_for_a_fault_by_sdo(drive, until):
    import can
    d = drive()
    driver = moving(d, until)
    with can.Bus(interface='virtual',
                 channel=d.configuration.driver_parameters.channel) as other:
        # 2001h = 4210h, then 2000h = 1, as expedited downloads.
        for frame in ('2b01200010420000', '2f00200001000000'):
            other.send(can.Message(arbitration_id=0x601, data=bytes.fromhex(frame),
                                   is_extended_id=False))
    until(driver.trouble)
    assert driver.trouble() == 'EMCY 4210h (Temperature), error register 01h'


def test_an_emulator_needs_the_driver_section():
    configuration = load_configuration('servo')
    with pytest.raises(ConfigurationError, match="'simulated': must be cia402"):
        Cia402Emulator(schema.build(EmulatedParameters, {}), configuration)
