"""What a drive is told before it is used, all of it by SDO (CiA 301, CiA 402)."""

from __future__ import annotations

from collections.abc import Sequence

from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.objects import Object, Pdo
from dz_ros.drivers.cia402.sdo import Sdo
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.errors import DriverError

SERVO_PROFILE = 402
RATED_TOLERANCE = 0.01
"""The rated torque may differ by so much from what the drive says."""


def configure(sdo: Sdo, p: Cia402Parameters, place: str, period: float,
              pdos: Sequence[Pdo | None]) -> None:
    """Check what the drive is and write PDOs, mode, limits and watchdogs into it.

    Args:
        sdo: The drive, in NMT state pre-operational.
        p: What it is to be told.
        place: Where it is, for messages.
        period: Loop period [s].
        pdos: What is exchanged; every other one is switched off.

    Raises:
        DriverError: No answer, another device, another motor, a mode it lacks, a refusal.
    """
    profile = sdo.read(objects.DEVICE_TYPE) & 0xFFFF
    if profile != SERVO_PROFILE:
        raise DriverError(f'{place}: is no servo drive: its device profile is {profile}, '
                          f'not {SERVO_PROFILE}')
    mode = objects.CYCLIC_TORQUE if p.mode == 'torque' else objects.CYCLIC_VELOCITY
    modes = sdo.read_optional(objects.SUPPORTED_MODES)
    if modes is not None and not modes >> (mode - 1) & 1:
        raise DriverError(f'{place}: cannot do cyclic synchronous {p.mode}: supported drive '
                          f'modes (6502h) = {modes:#x}')
    rated = sdo.read_optional(objects.RATED_TORQUE)
    if rated and p.mode == 'torque' and abs(rated / 1000.0 / p.rated_torque
                                            - 1.0) > RATED_TOLERANCE:
        raise DriverError(f'driver.rated_torque = {p.rated_torque:g} N m: the drive says '
                          f'{rated / 1000.0:g} N m (6076h)')
    sdo.write(objects.MODE, mode)
    sdo.write(objects.QUICK_STOP_CODE, p.quick_stop, needed=False)
    if p.mode == 'torque':
        sdo.write(objects.MAX_TORQUE, int(1000.0 * p.max_torque), needed=False)
        sdo.write(objects.TARGET_TORQUE, 0)
    else:
        sdo.write(objects.MAX_SPEED, int(p.max_speed), needed=False)
        sdo.write(objects.TARGET_VELOCITY, 0)
    # The cycle in units of 10^-4 s fits its 8 bits down to 40 Hz; slower loops tell it in ms.
    exponent = -4 if period < 0.0255 else -3
    sdo.write(objects.CYCLE_EXPONENT, exponent, needed=False)
    sdo.write(objects.CYCLE, min(255, round(period * 10.0 ** -exponent)), needed=False)
    for direction in (objects.RECEIVE, objects.TRANSMIT):
        used = {pdo.number for pdo in pdos if pdo is not None and pdo.direction is direction}
        for number in range(4):
            if number not in used:
                idle = Pdo(number, direction, 255, ())
                sdo.write(_record(idle.communication, 1),
                          idle.cob_id(p.node_id) | objects.NOT_VALID, needed=False)
    for pdo in pdos:
        if pdo is not None:
            write_pdo(sdo, p, pdo)
    sdo.write(objects.CONSUMER_HEARTBEAT, p.master_id << 16 | round(1000.0 * p.heartbeat_hold),
              needed=False)
    sdo.write(objects.PRODUCER_HEARTBEAT, round(1000.0 * p.heartbeat))


def write_pdo(sdo: Sdo, p: Cia402Parameters, pdo: Pdo) -> None:
    """Write one PDO's communication and mapping; its deadline may be missing.

    Raises:
        DriverError: No answer, or a refusal.
    """
    timer = round(1000.0 * p.command_hold) if pdo.direction is objects.RECEIVE else 0
    for index, sub, value in pdo.records(p.node_id, timer):
        sdo.write(_record(index, sub), value, needed=sub != 5)


def _record(index: int, sub: int) -> Object:
    """Return an entry of a PDO's records, named for messages."""
    return Object(index, sub, 'PDO', objects.U32)
