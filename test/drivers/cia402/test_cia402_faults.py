# SPDX-License-Identifier: Apache-2.0
"""Faults of drive and bus: reported once, latched, the drive stopped, left by recover.

Over 300 lines: one test for each fault that drive or bus can have.
"""

import itertools

import pytest

from dz_ros.core import schema
from dz_ros.core.safety.health import Level, Report
from dz_ros.drivers.cia402.emulator import Cia402Emulator, EmulatedParameters, FAULTS
from dz_ros.drivers.cia402.objects import ERROR_BEHAVIOUR, POSITION, VELOCITY
from dz_ros.drivers.cia402.states import DriveState
from dz_ros.drivers.emulators import Fault
from dz_ros.errors import ConfigurationError, DriverError
from dz_ros.files.configurations import load_configuration

S = DriveState


def moving(d, until, **overrides):
    """Return an enabled driver under a command that acts."""
    driver = d.enabled(**overrides)
    walk = driver.cycle.walk
    until(lambda: driver.command(2.0, 0.0) or (d.node.motor.target == 400 and walk.arrived))
    return driver


def back(d, driver, until):
    """Recover and drive again."""
    driver.recover()
    assert driver.fault() == ''
    until(lambda: driver.command(2.0, 0.0) or (
        d.node.device.state is S.ENABLED and d.node.motor.target == 400))
    until(lambda: driver.measure() is not None)


@pytest.mark.parametrize(('fault', 'words', 'state'), [
    ('emcy', 'EMCY 2310h (Current), error register 01h', S.FAULT),
    ('heartbeat', 'no heartbeat for 1 s', S.QUICK_STOP),
    ('torque-off', 'the drive has left operation enabled by itself: switch on disabled',
     S.DISABLED)])
def test_a_fault_is_latched_until_recover(drive, until, fault, words, state):
    d = drive()
    driver = moving(d, until)
    d.fault(fault, duration=5.0)
    # The loop goes on commanding until the fault reaches it; that must not move the drive.
    until(lambda: driver.command(2.0, 0.0) or driver.fault())
    assert driver.fault() == words
    until(lambda: driver.command(2.0, 0.0) or d.node.device.state is state)
    assert driver.fault() == words
    back(d, driver, until)


def test_a_drive_that_restarts(drive, until):
    d = drive(driver__heartbeat_hold=20.0)
    driver = moving(d, until)
    d.fault('restart', duration=0.0)
    until(driver.fault)
    assert driver.fault() == 'the drive has restarted'
    assert d.node.canopen.sdo[0x1017].raw == 0            # its settings are forgotten
    until(lambda: driver.measure() is None)
    back(d, driver, until)
    assert d.node.canopen.sdo[0x1017].raw == 50


def test_a_drive_that_restarts_unnoticed(drive, until):
    d = drive(driver__absolute_encoder=False)
    driver = moving(d, until)
    d.fault('restart', duration=2.0)
    until(driver.fault)
    assert driver.fault() == 'no heartbeat for 1 s'
    until(lambda: not d.node.off)
    driver.bus.restarted = False       # the boot-up message was lost
    with pytest.raises(DriverError, match='has restarted and has lost its position'):
        driver.recover()
    assert driver.fault()


def test_bus_off_of_the_drive(drive, until):
    d = drive(driver__answer_limit=0.05)
    driver = moving(d, until)
    d.fault('bus-off', duration=2.5)
    until(driver.fault)
    assert driver.fault() == 'no heartbeat for 1 s'
    with pytest.raises(DriverError, match='no answer within'):
        driver.recover()
    assert driver.fault()
    until(lambda: 'end of fault bus-off' in d.reported)
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
        until(driver.fault)
    assert driver.fault() == 'bus off: too many errors on the CAN bus'
    old = driver.bus.network.bus
    back(d, driver, until)
    assert driver.bus.network.bus is not old


def test_an_adapter_that_is_pulled_out_and_put_in_again(drive, until, monkeypatch):
    import can
    d = drive()
    driver = moving(d, until)
    real = can.Bus

    def gone(*_words, **_more):
        raise can.CanOperationError('No such device')

    driver.bus.network.bus.send = gone
    until(driver.fault)
    assert driver.fault() == 'the bus has gone: No such device'
    monkeypatch.setattr(can, 'Bus', gone)
    with pytest.raises(DriverError, match='no CAN bus at driver'):
        driver.recover()
    assert 'has gone' in driver.fault()
    driver.command(1.0, 0.0)            # nothing of this may raise or wait
    assert driver.measure() is None
    monkeypatch.setattr(can, 'Bus', real)
    back(d, driver, until)


def go_on(d, driver, until):
    """Have the loop go on as after a stall of this machine, and drive again."""
    until(lambda: d.node.device.state is S.FAULT)
    driver.resume()
    assert driver.fault() == ''
    until(lambda: driver.command(2.0, 0.0) or (
        d.node.device.state is S.ENABLED and d.node.motor.target == 400))


def mute(driver):
    """Have our messages not reach the bus, as in a stall; return a call that ends it."""
    bus = driver.bus.network.bus
    send, bus.send = bus.send, lambda *_words, **_more: None

    def end():
        bus.send = send
    return end


def test_a_drive_that_missed_our_messages_goes_on_after_a_stall(drive, until):
    d = drive()
    driver = moving(d, until)
    end = mute(driver)
    until(driver.fault)
    end()
    assert driver.fault().startswith(('EMCY 8130h', 'EMCY 8250h'))
    go_on(d, driver, until)


def test_so_does_one_whose_complaint_was_lost(drive, until):
    d = drive()
    driver = moving(d, until)
    d.fault('bus-off', duration=2.5)
    until(driver.fault)
    until(lambda: 'end of fault bus-off' in d.reported)
    go_on(d, driver, until)


@pytest.mark.parametrize('fault', ['emcy', 'torque-off', 'restart', 'mode', 'local'])
def test_what_no_stall_has_caused_waits_for_the_operator(drive, until, fault):
    d = drive()
    driver = moving(d, until)
    d.fault(fault, duration=0.5)
    until(lambda: driver.command(2.0, 0.0) or driver.fault())
    held = driver.fault()
    with pytest.raises(DriverError):
        driver.resume()
    assert driver.fault() == held


@pytest.mark.parametrize(('code', 'register'), [(0x2310, 1), (0x8210, 1), (0x8130, 3)])
def test_a_complaint_beside_missed_messages_waits_for_the_operator(drive, until, code, register):
    import can
    d = drive()
    driver = moving(d, until)
    end = mute(driver)
    until(driver.fault)
    p = d.configuration.driver_parameters
    with can.Bus(interface='virtual', channel=p.channel) as other:
        received = []
        driver.bus.network.subscribe(0x80 + p.node_id, lambda *words: received.append(words))
        other.send(can.Message(arbitration_id=0x80 + p.node_id, is_extended_id=False,
                               data=code.to_bytes(2, 'little') + bytes((register, 0, 0, 0, 0, 0))))
        until(lambda: received)
    end()
    with pytest.raises(DriverError, match='EMCY 8'):
        driver.resume()
    assert d.node.device.state in (S.FAULT, S.REACTING)
    if code == 0x2310:
        back(d, driver, until)


def test_a_drive_that_lost_its_voltage_waits_though_it_missed_messages_too(drive, until):
    import can
    d = drive()
    driver = moving(d, until)
    d.fault('torque-off', duration=0.5)
    until(lambda: driver.command(2.0, 0.0) or driver.fault())
    p = d.configuration.driver_parameters
    with can.Bus(interface='virtual', channel=p.channel) as other:
        received = []
        driver.bus.network.subscribe(0x80 + p.node_id, lambda *words: received.append(words))
        other.send(can.Message(arbitration_id=0x80 + p.node_id, is_extended_id=False,
                               data=bytes((0x50, 0x82, 1, 0, 0, 0, 0, 0))))
        until(lambda: received)
    with pytest.raises(DriverError, match='by itself'):
        driver.resume()


def lose_the_bus(driver, until):
    """Have our adapter go bus off."""
    driver.shared.error_frame(0x40)
    until(driver.fault)
    assert driver.bus.broken


def beyond_the_wrap(d, driver, until):
    """Have driver and drive past the end of the 32 bits of the position; return x of a whole."""
    whole = 2 ** 32 * abs(driver.scaling.position)
    position = driver.bus.position             # as after this number of turns
    position.last = (position.last[0] + 2 ** 32, *position.last[1:])
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
    driver.bus.restarted = True
    back(d, driver, until)
    until(driver.measure)
    assert abs(driver.measure()[0]) < 0.1 * whole


def test_receiving_that_fails_is_a_fault_too(drive, until):
    import can
    d = drive()
    driver = moving(d, until)

    def gone(_timeout):
        raise can.CanOperationError('read failed')

    driver.bus.network.bus.recv = gone
    until(driver.fault)
    assert driver.fault() == 'the bus has gone: read failed'
    back(d, driver, until)


def test_a_fault_that_lasts(drive, until):
    d = drive(driver__transition_limit=0.2)
    driver = moving(d, until)
    d.fault('stuck', value=0x7305, duration=1.0)
    until(driver.fault)
    with pytest.raises(DriverError, match=r'remains in fault; error code \(603Fh\) 7305h'):
        driver.recover()
    assert driver.fault() == 'the drive remains in fault'
    until(lambda: 'end of fault stuck' in d.reported)
    back(d, driver, until)


def test_pdos_that_stay_away_are_no_measurement(drive, until):
    d = drive()
    driver = moving(d, until)
    d.fault('no-pdo', duration=0.5)
    until(lambda: driver.measure() is None)
    until(lambda: driver.command(2.0, 0.0) or driver.measure() is not None)
    assert driver.fault() == ''


def test_the_drive_stops_by_itself_when_our_process_is_gone(drive, until):
    d = drive()
    driver = moving(d, until)
    cycle, driver.cycle = driver.cycle, None
    cycle.stop()                        # as a process that is frozen: no command, no heartbeat
    until(lambda: d.node.device.state is S.FAULT)
    assert d.node.device.error_code in (0x8250, 0x8130)


def test_a_drive_commanded_to_leave_operational_is_a_fault(drive, until):
    d = drive()
    driver = moving(d, until)
    driver.bus.nmt(0x80)
    until(driver.fault)
    assert driver.fault() == ('the drive has left NMT state operational: pre-operational; it '
                              'takes no commands, the safe one included')
    back(d, driver, until)


def test_nonsense_on_the_bus_is_no_fault(drive, until):
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
        for identifier in (0x181, 0x281, 0x701, 0x81, 0x0, 0x601, 0x201):   # of 29 bits
            for data in (bytes(8), b'\x02\x01', b'\x10\x23\x01'):
                for _ in range(4):
                    other.send(can.Message(arbitration_id=identifier, data=data,
                                           is_extended_id=True))
    until(lambda: driver.command(1.0, 0.0) or d.node.motor.target == 200)
    assert driver.fault() == ''


def test_faults_on_a_script_begin_with_the_first_command_that_moves(drive, until):
    script = [Fault.parse('emcy@0.05=9040', FAULTS)]
    d = drive()
    d.emulator.pending = script
    driver = d.enabled()
    assert not d.node.moved
    driver.command(2.0, 0.0)
    until(driver.fault)
    assert driver.fault().startswith('EMCY 2350h')
    assert 'fault emcy' in d.reported


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
    until(driver.fault)
    assert driver.fault() == 'EMCY 4210h (Temperature), error register 01h'


def test_an_emulator_needs_the_driver_section():
    configuration = load_configuration('servo')
    with pytest.raises(ConfigurationError, match="'simulated': must be cia402"):
        Cia402Emulator(schema.build(EmulatedParameters, {}), configuration)


LEFT = 'the drive has left NMT state operational: '
DEAF = '; it takes no commands, the safe one included'


@pytest.mark.parametrize(('command', 'words', 'state'), [
    (0x02, 'stopped, commanded by another master', S.FAULT),
    (0x80, 'pre-operational, commanded by another master', S.QUICK_STOP),
    (0x81, 'boot-up, commanded by another master', S.DISABLED),
    (0x82, 'boot-up, commanded by another master', S.DISABLED)])
@pytest.mark.parametrize('node', [0, 1])
def test_another_master_takes_the_drive_out_of_operational(
        drive, until, command, node, words, state):
    import can
    d = drive(driver__heartbeat=1.0, driver__heartbeat_hold=20.0)    # received before a heartbeat
    driver = moving(d, until)
    with can.Bus(interface='virtual',
                 channel=d.configuration.driver_parameters.channel) as other:
        other.send(can.Message(arbitration_id=0, data=bytes((command, 9)), is_extended_id=False))
        other.send(can.Message(arbitration_id=0, data=bytes((command, node)),
                               is_extended_id=False))
        until(driver.fault)
    assert driver.fault() == LEFT + words + DEAF
    until(lambda: driver.command(2.0, 0.0) or d.node.device.state is state)
    until(lambda: driver.bus.state is state)       # asked by SDO
    assert not refusal(driver)
    back(d, driver, until)


def test_a_drive_that_was_reset_sends_the_heartbeats_of_its_new_state_alone(drive, until):
    import can
    d = drive(driver__heartbeat=0.02)
    driver = moving(d, until)
    with can.Bus(interface='virtual',
                 channel=d.configuration.driver_parameters.channel) as other:
        for _ in range(2):
            other.send(can.Message(arbitration_id=0, data=bytes((0x81, 1)), is_extended_id=False))
            until(driver.fault)
            back(d, driver, until)
            while other.recv(0.0) is not None:
                pass
            states = []
            while len(states) < 10:
                driver.command(2.0, 0.0)
                frame = other.recv(0.01)
                if frame is not None and frame.arbitration_id == 0x701:
                    states.append(frame.data[0])
            assert set(states) == {5}
            assert driver.fault() == ''


def refusal(driver):
    """Return what the diagnostics report of the safe command."""
    report = Report()
    driver.report(report)
    return report.message if report.level is Level.ERROR else ''


@pytest.mark.parametrize(('fault', 'state'), [('pre-operational', S.QUICK_STOP),
                                              ('stopped', S.FAULT)])
def test_a_drive_that_leaves_operational_by_itself_is_stopped(drive, until, fault, state):
    d = drive()
    driver = moving(d, until)
    d.fault(fault)
    until(lambda: driver.command(2.0, 0.0) or driver.fault())
    assert driver.fault() == LEFT + fault + DEAF
    until(lambda: driver.command(2.0, 0.0) or d.node.device.state is state)
    back(d, driver, until)


def test_a_drive_without_a_reaction_is_stopped_by_sdo(drive, until):
    d = drive(driver__unsupervised=True)
    del d.node.canopen.object_dictionary[0x6007]
    d.node.device.abort_connection = 0
    driver = d.driver()
    driver.open()
    d.node.device.abort_connection = 0
    driver.enable()
    until(lambda: driver.command(2.0, 0.0) or d.node.motor.target == 400)
    d.fault('stopped')
    until(driver.fault)
    until(lambda: d.node.device.state is S.QUICK_STOP)
    assert d.node.canopen.nmt.state == 'PRE-OPERATIONAL'      # where SDOs are taken again
    driver.disable()
    assert d.node.device.state is S.DISABLED


def test_a_drive_that_takes_no_safe_command_is_not_reported_to_have_it(drive, until):
    d = drive(driver__answer_limit=0.05)
    driver = moving(d, until)
    assert not refusal(driver)
    d.node.device.abort_connection = 0
    d.node.heartbeat_timeout = d.node.watched_command = 0.0     # nor does it stop by itself
    d.fault('bus-off', duration=60.0)
    until(driver.fault)
    driver.safe(0.0, 0.0)
    until(lambda: refusal(driver).startswith(
        'the safe command is not taken: the drive is silent for'))
    assert d.node.device.state is S.ENABLED
    with pytest.raises(DriverError, match='the safe command is not taken: the drive is silent'):
        driver.disable()
    d.node.network.notify, d.node.off = lambda *a: None, False
    driver.close()                  # it still has torque: its watchdogs, which it needs
    assert d.node.canopen.nmt.state == 'OPERATIONAL'    # operational for, are left to stop it


def test_the_safe_command_taken_before_the_drive_was_lost_is_taken(drive, until):
    d = drive(driver__answer_limit=0.05)
    driver = moving(d, until)
    driver.safe(0.0, 0.0)
    until(lambda: driver.bus.state is S.QUICK_STOP)
    d.fault('bus-off', duration=60.0)
    until(driver.fault)
    assert not refusal(driver)


def test_an_adapter_that_is_gone_takes_no_safe_command(drive, until):
    d = drive()
    driver = moving(d, until)
    lose_the_bus(driver, until)
    until(lambda: refusal(driver) == ('the safe command is not taken: there is no connection to '
                                      'the bus'))
    with pytest.raises(DriverError, match='the safe command is not taken: there is no connection'):
        driver.disable()
    driver._enabled = True
    back(d, driver, until)


def test_a_drive_that_does_not_obey_the_quick_stop(drive, until):
    d = drive()
    driver = moving(d, until)
    control = d.node.device.control
    d.node.device.control = lambda word: None if word == 0x02 else control(word)
    driver.safe(0.0, 0.0)
    until(driver.fault)
    assert driver.fault() == 'the drive does not take the command to stop: operation enabled'
    assert refusal(driver) == ('the safe command is not taken: the drive remains operation '
                               'enabled')
    d.node.device.control = control
    driver.disable()
    assert d.node.device.state is S.DISABLED


@pytest.mark.parametrize(('fault', 'value', 'words', 'state'), [
    ('mode', 0, 'the drive is in another mode: modes of operation display (6061h) = 1, not 10',
     S.QUICK_STOP),
    ('mode', 8, 'the drive is in another mode: modes of operation display (6061h) = 8, not 10',
     S.QUICK_STOP),
    ('local', 0, 'the drive reports operation enabled, but it is in local mode (statusword bit 9)',
     S.QUICK_STOP),
    ('frozen', 0, 'the drive repeats one answer: its position stands still at a velocity of',
     S.QUICK_STOP),
    ('twice', 0, 'more than one answer to each SYNC: does another node have the id 1?',
     S.QUICK_STOP),
    ('short', 0, 'TPDO 1 has 6 bytes, not 7: its mapping was changed', S.QUICK_STOP)])
def test_a_drive_that_contradicts_itself(drive, until, fault, value, words, state):
    d = drive()
    driver = moving(d, until)
    until(lambda: driver.command(2.0, 0.0) or (driver.measure() or (0.0, 0.0))[1] > 0.3)
    d.fault(fault, value, duration=600.0)
    until(lambda: driver.command(2.0, 0.0) or driver.fault())
    assert driver.fault().startswith(words)
    if fault == 'local':
        assert d.node.device.state is S.ENABLED     # it receives nothing
        until(lambda: refusal(driver))
    for _, end, _ in d.emulator.ends:
        end()
    until(lambda: driver.command(2.0, 0.0) or d.node.device.state is state)
    back(d, driver, until)


def test_a_drive_that_repeats_itself_at_rest(drive, until):
    """Nothing moves in its answers; that its torque does not follow the target shows it."""
    d = drive(plant__cogging_torque=0.0)        # which would have it creep
    driver = moving(d, until)
    targets = itertools.cycle([0.1, 0.2, 0.3, 0.15])     # inside of the dead-zone: it stands
    torques = set()

    def alive():
        driver.command(next(targets), 0.0)
        found = driver.bus.measurement
        torques.update(() if found is None else (found.torque,))
        return len(torques) > 3

    until(alive)
    until(lambda: driver.command(0.0, 0.0) or (driver.measure() and d.node.motor.velocity == 0))
    d.fault('frozen', duration=600.0)
    until(lambda: driver.command(0.0, 0.0) or d.node.frozen)
    assert driver.fault() == ''
    pushing = itertools.cycle([0.0, 3.0])
    until(lambda: driver.command(next(pushing), 0.0) or driver.fault())
    assert driver.fault().startswith('the drive repeats one answer: its torque does not change')
    until(lambda: d.node.device.state is S.QUICK_STOP)


def test_answers_in_another_order_are_joined_all_the_same(drive, until):
    """Position and velocity of each measurement are those the drive took at one SYNC."""
    d = drive()
    driver = moving(d, until)
    d.fault('disorder', duration=600.0)
    until(lambda: d.node.disordered)
    value, velocity, sent, found = d.node.value, [], set(), []

    def note(index):
        number = value(index)
        if index == VELOCITY.index:
            velocity[:] = [number]
        elif index == POSITION.index and velocity:
            sent.add((number, *velocity))
        return number

    d.node.value = note
    until(lambda: len(sent) > 20)           # of none before

    def look():
        driver.command(2.0, 0.0)
        measurement = driver.bus.measurement
        if measurement is not None and (not found or measurement is not found[-1]):
            found.append(measurement)
        return len(found) > 100

    until(look)
    assert driver.fault() == ''
    reported = [item.synced_at for item in found]
    assert reported == sorted(set(reported))
    scaling = driver.scaling
    assert {(scaling.counts(item.x), scaling.number(item.speed)) for item in found} <= sent


def test_another_master_that_changes_the_mode(drive, until):
    import can
    d = drive()
    driver = moving(d, until)
    with can.Bus(interface='virtual',
                 channel=d.configuration.driver_parameters.channel) as other:
        other.send(can.Message(arbitration_id=0x601, data=bytes.fromhex('2f60600008000000'),
                               is_extended_id=False))
        until(driver.fault)
    assert driver.fault().startswith('the drive is in another mode: ')
    assert d.node.motor.v == 0.0                   # in which its target is none
    back(d, driver, until)


@pytest.mark.parametrize(('option', 'state'), [(1, S.FAULT), (2, S.DISABLED),
                                               (3, S.QUICK_STOP)])
def test_the_emulated_drive_reacts_as_6007h_states(drive, until, option, state):
    d = drive(driver__abort_connection=option)
    driver = moving(d, until)
    cycle, driver.cycle = driver.cycle, None
    cycle.stop()
    until(lambda: d.node.device.state is state)
    assert d.node.canopen.nmt.state == 'OPERATIONAL'          # 1029h = 1


@pytest.mark.parametrize(('behaviour', 'state'), [(0, 'PRE-OPERATIONAL'), (2, 'STOPPED')])
def test_the_emulated_drive_leaves_operational_as_1029h_states(drive, until, behaviour, state):
    d = drive()
    driver = moving(d, until)
    driver.bus.sdo.write(ERROR_BEHAVIOUR, behaviour)
    driver.sdo_watch.stop()
    driver.cycle.stop()
    until(lambda: d.node.canopen.nmt.state == state)


def test_the_emulated_drive_coasts_where_605eh_reports_it(drive, until):
    d = drive(driver__fault_reaction=0)
    driver = moving(d, until)
    until(lambda: driver.command(2.0, 0.0) or (driver.measure() or (0.0, 0.0))[1] > 0.3)
    d.node.fault(0x2310)
    assert d.node.device.state is S.FAULT           # without waiting for it to stand
    assert not d.node.device.standing
