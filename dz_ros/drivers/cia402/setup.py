# SPDX-License-Identifier: Apache-2.0
"""Settings of a drive before it is used, all by SDO (CiA 301, CiA 402), and read again.

What the drive holds already is not written, what it refuses is found by reading it again: drives
differ in what may be written, and a refusal is no error where the value is the wanted one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time

from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.objects import NO_RTR, NOT_VALID, Object, Pdo
from dz_ros.drivers.cia402.scaling import WHOLE
from dz_ros.drivers.cia402.sdo import Sdo
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.drivers.cia402.states import Controlword, DriveState, state_of
from dz_ros.errors import DriverError

SERVO_PROFILE = 402
RATED_TOLERANCE = 0.01
"""Largest relative difference from the rated torque of the drive."""
_STAYS_OPERATIONAL = 1
"""Error behaviour (1029h): the NMT state is kept, so that commands are still taken."""
_PAUSE = 0.005
"""Between two looks at what a drive takes time for [s]."""


@dataclass(frozen=True)
class Found:
    """What was found out about a drive.

    Attributes:
        first: Its first answer to SYNC.
        second: Its second one, None = none.
        polls_mode: Whether its mode is in no PDO.
        mode: Mode of operation it is in.
        modulus: Number of values of its position counter.
        remarks: Permitted differences from its settings.
    """

    first: Pdo
    second: Pdo | None
    polls_mode: bool
    mode: int
    modulus: int
    remarks: tuple[str, ...]


def configure(sdo: Sdo, p: Cia402Parameters, place: str, period: float,
              pdos: tuple[Pdo, Pdo, Pdo | None]) -> Found:
    """Check what the drive is and write PDOs, mode, limits, reactions and watchdogs into it.

    Args:
        sdo: The drive, in NMT state pre-operational.
        p: The settings.
        place: Where it is, for messages.
        period: Loop period [s].
        pdos: What is exchanged; every other one is switched off.

    Raises:
        DriverError: No answer, another device, another motor, a mode it lacks, a refusal, no
            reaction of its own to a host that is gone.
    """
    _identify(sdo, p, place)
    _stop(sdo, p, place)
    remarks: list[str] = []
    mode = _set_mode(sdo, p, place)
    _set_limits(sdo, p, place, remarks)
    # The cycle in units of 10^-4 s fits its 8 bits down to 40 Hz; slower loops in ms.
    exponent = -4 if period < 0.0255 else -3
    sdo.hold(objects.CYCLE_EXPONENT, exponent)
    sdo.hold(objects.CYCLE, min(255, round(period * 10.0 ** -exponent)))
    _set_sync(sdo, place)
    command, first, second = pdos
    for direction in (objects.RECEIVE, objects.TRANSMIT):
        used = {pdo.number for pdo in pdos if pdo is not None and pdo.direction is direction}
        for number in range(4):
            if number not in used:
                _switch_off(sdo, Pdo(number, direction, 255, ()), remarks)
    timer = set_pdo(sdo, p, place, command)
    polls_mode = False
    try:
        set_pdo(sdo, p, place, first)
    except DriverError:
        # Not every drive lets its mode be mapped.
        first = Pdo(first.number, first.direction, first.kind, first.objects[:2])
        set_pdo(sdo, p, place, first)
        polls_mode = True
    if second is not None:
        set_pdo(sdo, p, place, second)
    _set_reactions(sdo, p, place, timer, remarks)
    heartbeat = round(1000.0 * p.heartbeat)
    if sdo.hold(objects.PRODUCER_HEARTBEAT, heartbeat) != heartbeat:
        raise DriverError(f'{place}: does not send heartbeats every {heartbeat} ms: '
                          f'{objects.PRODUCER_HEARTBEAT}')
    return Found(first, second, polls_mode, mode, _modulus(sdo, p, place), tuple(remarks))


def _identify(sdo: Sdo, p: Cia402Parameters, place: str) -> None:
    """Check profile, mode and motor."""
    profile = sdo.read(objects.DEVICE_TYPE) & 0xFFFF
    if profile != SERVO_PROFILE:
        raise DriverError(f'{place}: is no servo drive: its device profile is {profile}, '
                          f'not {SERVO_PROFILE}')
    modes = sdo.read_optional(objects.SUPPORTED_MODES)
    if modes is not None and not modes >> (objects.MODES[p.mode] - 1) & 1:
        raise DriverError(f'{place}: cannot do cyclic synchronous {p.mode}: supported drive '
                          f'modes (6502h) = {modes:#x}')
    rated = sdo.read_optional(objects.RATED_TORQUE)
    if rated and p.mode == 'torque' and abs(rated / 1000.0 / p.rated_torque
                                            - 1.0) > RATED_TOLERANCE:
        raise DriverError(f'driver.rated_torque = {p.rated_torque:g} N m: the drive reports '
                          f'{rated / 1000.0:g} N m (6076h)')


def _stop(sdo: Sdo, p: Cia402Parameters, place: str) -> None:
    """Stop a drive that was left enabled: in pre-operational it takes SDOs alone."""
    def enabled() -> bool:
        return state_of(sdo.read(objects.STATUSWORD)) is DriveState.ENABLED

    if enabled():
        sdo.write(objects.CONTROLWORD, Controlword.QUICK_STOP)
        if not _wait(lambda: not enabled(), p.transition_limit):
            raise DriverError(f'{place}: was found enabled and does not take a quick stop by SDO')


def _set_mode(sdo: Sdo, p: Cia402Parameters, place: str) -> int:
    """Ask for the mode of operation and wait until the drive is in it."""
    wanted = objects.MODES[p.mode]
    sdo.write(objects.MODE, wanted)
    shown = [sdo.read(objects.MODE_DISPLAY)]

    def there() -> bool:
        shown[0] = sdo.read(objects.MODE_DISPLAY)
        return shown[0] == wanted

    if not _wait(there, p.transition_limit):
        raise DriverError(f'{place}: does not go into mode {wanted}, cyclic synchronous {p.mode}: '
                          f'{objects.MODE_DISPLAY} = {shown[0]}')
    return shown[0]


def _set_limits(sdo: Sdo, p: Cia402Parameters, place: str, remarks: list[str]) -> None:
    """Set the largest torque or speed, and a target of 0."""
    item, limit, target, key = (
        (objects.MAX_TORQUE, int(1000.0 * p.max_torque), objects.TARGET_TORQUE, 'max_torque')
        if p.mode == 'torque' else
        (objects.MAX_SPEED, int(p.max_speed), objects.TARGET_VELOCITY, 'max_speed'))
    held = sdo.hold(item, limit)
    if held is not None and held < limit:
        raise DriverError(f'{place}: holds itself to less than driver.{key}: {item} = {held}, not '
                          f'{limit}')
    if held is not None and held > limit:
        remarks.append(f'{item} is {held}, not {limit}: only the host holds to it')
    sdo.write(target, 0)


def _set_sync(sdo: Sdo, place: str) -> None:
    """See to it that our SYNC, COB-ID 80h without counter, is the one the drive takes."""
    found = sdo.look(objects.SYNC_ID)
    if found is not None and found & 0x4000_07FF != 0x80:
        sdo.offer(objects.SYNC_ID, 0x80)
        found = sdo.look(objects.SYNC_ID)
        if found is None or found & 0x4000_07FF != 0x80:
            raise DriverError(f'{place}: takes another SYNC, or sends it: {objects.SYNC_ID} = '
                              f'{found or 0:08X}h, not 00000080h')
    counter = sdo.look(objects.SYNC_COUNTER)
    if counter:
        refusal = sdo.offer(objects.SYNC_COUNTER, 0)
        if refusal:
            raise DriverError(f'{place}: expects SYNC with a counter: {objects.SYNC_COUNTER} = '
                              f'{counter}: {refusal}')


def _switch_off(sdo: Sdo, pdo: Pdo, remarks: list[str]) -> None:
    """Switch off a PDO that is not used; its COB-ID stays."""
    record = _record(pdo, 1)
    cob_id = sdo.look(record)
    if cob_id is not None and not cob_id & NOT_VALID:
        refusal = sdo.offer(record, cob_id | NOT_VALID)
        if refusal:
            remarks.append(f'{record} cannot be switched off: {refusal}')


def set_pdo(sdo: Sdo, p: Cia402Parameters, place: str, pdo: Pdo) -> int:
    """Have a PDO be what is wanted; return the time it is waited for [ms], 0 = for ever.

    The bit of the COB-ID that forbids remote requests stays as the drive has it.

    Raises:
        DriverError: No answer, or the drive wants it otherwise.
    """
    wait = round(1000.0 * p.command_hold) if pdo.direction is objects.RECEIVE else 0
    no_rtr = sdo.read(_record(pdo, 1)) & NO_RTR
    if not _differs(sdo, p, pdo, no_rtr) and (not wait or sdo.look(_record(pdo, 5)) == wait):
        return wait
    refusals: list[str] = []
    for kept in (no_rtr, no_rtr ^ NO_RTR):
        for index, sub, value in pdo.records(p.node_id, wait, kept):
            item = _record(pdo, sub, index)
            refusal = sdo.offer(item, value)
            if refusal:
                refusals.append(f'{item}: {refusal}')
        different = _differs(sdo, p, pdo, kept)
        if not sdo.read(_record(pdo, 1)) & NOT_VALID:
            break       # else it reports one bit and takes the other
    if different:
        raise DriverError(f'{place}: {different}' + (f'; {refusals[0]}' if refusals else ''))
    if not wait:
        return 0
    return sdo.read_optional(_record(pdo, 5)) or 0


def _differs(sdo: Sdo, p: Cia402Parameters, pdo: Pdo, kept: int) -> str:
    """Return in what a PDO of the drive's is another than the wanted one, or ''."""
    wanted = pdo.cob_id(p.node_id) | kept
    cob_id = sdo.read(_record(pdo, 1))
    if cob_id != wanted:
        return f'{_record(pdo, 1)} is {cob_id:08X}h, not {wanted:08X}h'
    kind = sdo.read(_record(pdo, 2))
    if kind != pdo.kind and {kind, pdo.kind} != {254, 255}:    # both: at arrival
        return f'{_record(pdo, 2)} is {kind}, not {pdo.kind}'
    number = sdo.read(_record(pdo, 0, pdo.mapping))
    found = [sdo.read(_record(pdo, place + 1, pdo.mapping)) for place in range(min(number, 8))]
    if found == pdo.mappings:
        return ''
    return (f'{pdo.name} carries {" ".join(f"{item:08X}h" for item in found) or "nothing"}, not '
            f'{", ".join(map(str, pdo.objects))}')


def _set_reactions(sdo: Sdo, p: Cia402Parameters, place: str, timer: int,
                   remarks: list[str]) -> None:
    """Set what the drive does by itself, and check that it would stop without a host.

    `timer` is how long it waits for a command [ms], 0 = for ever.
    """
    for item, wanted in ((objects.QUICK_STOP_CODE, p.quick_stop),
                         (objects.FAULT_REACTION, p.fault_reaction),
                         (objects.ERROR_BEHAVIOUR, _STAYS_OPERATIONAL)):
        held = sdo.hold(item, wanted)
        if held is not None and held != wanted:
            remarks.append(f'{item} is {held}, not {wanted}')
    consumer = p.master_id << 16 | round(1000.0 * p.heartbeat_hold)
    watches = sdo.hold(objects.CONSUMER_HEARTBEAT, consumer) == consumer
    lacks = []
    reaction = sdo.hold(objects.ABORT_CONNECTION, p.abort_connection)
    if not reaction:
        state = 'is missing' if reaction is None else 'stays 0'
        lacks.append(f'{objects.ABORT_CONNECTION} {state}')
    elif reaction != p.abort_connection:
        remarks.append(f'{objects.ABORT_CONNECTION} is {reaction}, not {p.abort_connection}')
    if not watches and not timer:
        lacks.append(f'it takes neither {objects.CONSUMER_HEARTBEAT} nor the event timer of its '
                     'RPDO')
    if lacks:
        words = 'would not stop by itself when host, bus or NMT is gone: ' + ' and '.join(lacks)
        if not p.unsupervised:
            raise DriverError(f'{place}: {words}; driver.unsupervised = true drives it all the '
                              'same')
        remarks.append(words)


def _modulus(sdo: Sdo, p: Cia402Parameters, place: str) -> int:
    """Return the number of values of the position counter."""
    if p.position_range:
        return p.position_range
    lowest, highest = sdo.look(objects.RANGE_LOWEST), sdo.look(objects.RANGE_HIGHEST)
    if lowest is None or highest is None or lowest >= highest:
        return WHOLE
    span = highest - lowest
    if span >= WHOLE - 2:
        return WHOLE
    # Whether the highest value is still used differs among drives: one turn is a whole one.
    for modulus in (span + 1, span):
        if modulus % p.counts_per_rev == 0:
            return modulus
    raise DriverError(f'{place}: its position begins again after {lowest} … {highest} (607Bh), no '
                      f'whole number of driver.counts_per_rev = {p.counts_per_rev}: state how '
                      f'many in driver.position_range ({span + 1} or {span}), or set 607Bh to 0')


def _wait(done: Callable[[], bool], limit: float) -> bool:
    """Wait until something the drive is asked for holds; return whether it does."""
    end = time.monotonic() + limit
    while not done():
        if time.monotonic() > end:
            return False
        time.sleep(_PAUSE)
    return True


def _record(pdo: Pdo, sub: int, index: int = 0) -> Object:
    """Return an entry of a PDO's records, named for messages."""
    what = 'mapping' if index == pdo.mapping else {1: 'COB-ID', 2: 'transmission type',
                                                   5: 'event timer'}[sub]
    kind = objects.U32 if index == pdo.mapping or sub == 1 else objects.U8
    return Object(index or pdo.communication, sub, f'{pdo.name} {what}', kind)
