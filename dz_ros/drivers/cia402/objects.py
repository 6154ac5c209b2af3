# SPDX-License-Identifier: Apache-2.0
"""The objects of a drive that are used here, as the profiles number them; no EDS is needed.

Communication objects: CiA 301. Drive objects: CiA 402 (IEC 61800-7-201). The same table makes the
object dictionary of the master and that of the simulated drive, which adds two of its own in the
manufacturer's range.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

BOOLEAN, I8, I16, I32, U8, U16, U32 = 1, 2, 3, 4, 5, 6, 7
"""Data types of CiA 301."""
BITS = {I8: 8, I16: 16, I32: 32, U8: 8, U16: 16, U32: 32}


@dataclass(frozen=True)
class Object:
    """One entry of the dictionary.

    Attributes:
        index, sub: Where; sub 0 where the object is a single variable.
        name: What.
        kind: Data type.
        access: ro, rw or const.
        default: Value after a start; None = without.
    """

    index: int
    sub: int
    name: str
    kind: int
    access: str = 'rw'
    default: int | None = None

    @property
    def bits(self) -> int:
        """Length in a PDO."""
        return BITS[self.kind]

    @property
    def mapping(self) -> int:
        """What stands for it in a mapping record."""
        return self.index << 16 | self.sub << 8 | self.bits

    def __str__(self) -> str:
        """Return name and address, for messages."""
        place = f'{self.index:04X}h' + (f':{self.sub:02X}' if self.sub else '')
        return f'{self.name} ({place})'


DEVICE_TYPE = Object(0x1000, 0, 'device type', U32, 'ro', 0x00020192)
ERROR_REGISTER = Object(0x1001, 0, 'error register', U8, 'ro', 0)
SYNC_ID = Object(0x1005, 0, 'COB-ID SYNC', U32, 'rw', 0x80)
CONSUMER_HEARTBEAT = Object(0x1016, 1, 'consumer heartbeat time', U32, 'rw', 0)
PRODUCER_HEARTBEAT = Object(0x1017, 0, 'producer heartbeat time', U16, 'rw', 0)
VENDOR = Object(0x1018, 1, 'vendor id', U32, 'ro', 0)
SYNC_COUNTER = Object(0x1019, 0, 'synchronous counter overflow value', U8, 'rw', 0)
ERROR_BEHAVIOUR = Object(0x1029, 1, 'error behaviour, communication error', U8, 'rw', 0)
ABORT_CONNECTION = Object(0x6007, 0, 'abort connection option code', I16, 'rw', 1)
ERROR_CODE = Object(0x603F, 0, 'error code', U16, 'ro', 0)
CONTROLWORD = Object(0x6040, 0, 'controlword', U16, 'rw', 0)
STATUSWORD = Object(0x6041, 0, 'statusword', U16, 'ro', 0)
QUICK_STOP_CODE = Object(0x605A, 0, 'quick stop option code', I16, 'rw', 2)
FAULT_REACTION = Object(0x605E, 0, 'fault reaction option code', I16, 'rw', 2)
MODE = Object(0x6060, 0, 'modes of operation', I8, 'rw', 0)
MODE_DISPLAY = Object(0x6061, 0, 'modes of operation display', I8, 'ro', 0)
POSITION = Object(0x6064, 0, 'position actual value', I32, 'ro', 0)
VELOCITY_DEMAND = Object(0x606B, 0, 'velocity demand value', I32, 'ro', 0)
VELOCITY = Object(0x606C, 0, 'velocity actual value', I32, 'ro', 0)
TARGET_TORQUE = Object(0x6071, 0, 'target torque', I16, 'rw', 0)
MAX_TORQUE = Object(0x6072, 0, 'max torque', U16, 'rw', 1000)
TORQUE_DEMAND = Object(0x6074, 0, 'torque demand', I16, 'ro', 0)
RATED_TORQUE = Object(0x6076, 0, 'motor rated torque', U32, 'ro', 1000)
TORQUE = Object(0x6077, 0, 'torque actual value', I16, 'ro', 0)
RANGE_LOWEST = Object(0x607B, 1, 'position range limit, lowest', I32, 'rw', 0)
RANGE_HIGHEST = Object(0x607B, 2, 'position range limit, highest', I32, 'rw', 0)
MAX_SPEED = Object(0x6080, 0, 'max motor speed', U32, 'rw', 3000)
CYCLE = Object(0x60C2, 1, 'interpolation time period', U8, 'rw', 1)
CYCLE_EXPONENT = Object(0x60C2, 2, 'interpolation time index', I8, 'rw', -3)
TARGET_VELOCITY = Object(0x60FF, 0, 'target velocity', I32, 'rw', 0)
SUPPORTED_MODES = Object(0x6502, 0, 'supported drive modes', U32, 'ro', 1 << 7 | 1 << 8 | 1 << 9)

STANDARD = (
    DEVICE_TYPE, ERROR_REGISTER, SYNC_ID, CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, VENDOR,
    SYNC_COUNTER, ERROR_BEHAVIOUR, ABORT_CONNECTION, ERROR_CODE, CONTROLWORD, STATUSWORD,
    QUICK_STOP_CODE, FAULT_REACTION, MODE, MODE_DISPLAY, POSITION, VELOCITY_DEMAND, VELOCITY,
    TARGET_TORQUE, MAX_TORQUE, TORQUE_DEMAND, RATED_TORQUE, TORQUE, RANGE_LOWEST, RANGE_HIGHEST,
    MAX_SPEED, CYCLE, CYCLE_EXPONENT, TARGET_VELOCITY, SUPPORTED_MODES)

FAULT = Object(0x2000, 0, 'emulated fault', U8, 'rw', 0)
FAULT_VALUE = Object(0x2001, 0, 'emulated fault value', U16, 'rw', 0)
FAULT_TIME = Object(0x2002, 0, 'emulated fault time', U16, 'rw', 1000)
EMULATED = (FAULT, FAULT_VALUE, FAULT_TIME)
"""Objects that only the simulated drive has, in the manufacturer's range."""

CYCLIC_VELOCITY, CYCLIC_TORQUE = 9, 10
"""Modes of operation; bit mode − 1 of the supported ones."""
MODES = {'torque': CYCLIC_TORQUE, 'velocity': CYCLIC_VELOCITY}

RECEIVE, TRANSMIT = (0x1400, 0x1600, 0x200), (0x1800, 0x1A00, 0x180)
"""First communication record, first mapping record, COB-ID without node id of RPDOs and TPDOs."""
NOT_VALID, NO_RTR, EXTENDED, IDENTIFIER = 1 << 31, 1 << 30, 1 << 29, 0x7FF
"""Parts of a PDO's COB-ID: switched off; no remote request; 29-bit frame; the identifier."""


@dataclass(frozen=True)
class Pdo:
    """One process data object.

    Attributes:
        number: 0 for the first of its direction.
        direction: `RECEIVE` or `TRANSMIT`, as the drive sees it.
        kind: Transmission type: 1 = with each SYNC, 255 = at arrival.
        objects: What is in it, first first.
    """

    number: int
    direction: tuple[int, int, int]
    kind: int
    objects: tuple[Object, ...]

    @property
    def communication(self) -> int:
        """Index of the communication record."""
        return self.direction[0] + self.number

    @property
    def mapping(self) -> int:
        """Index of the mapping record."""
        return self.direction[1] + self.number

    @property
    def form(self) -> str:
        """Format of its bytes for `struct`."""
        letters = {I8: 'b', I16: 'h', I32: 'i', U8: 'B', U16: 'H', U32: 'I'}
        return '<' + ''.join(letters[item.kind] for item in self.objects)

    def cob_id(self, node_id: int) -> int:
        """Return its identifier on the bus, of the predefined connection set."""
        return self.direction[2] + 0x100 * self.number + node_id

    @property
    def name(self) -> str:
        """Name for messages."""
        return f'{"RPDO" if self.direction is RECEIVE else "TPDO"} {self.number + 1}'

    @property
    def mappings(self) -> list[int]:
        """Entries of the mapping record."""
        return [item.mapping for item in self.objects]

    def records(self, node_id: int, event_timer: int = 0,
                kept: int = 0) -> list[tuple[int, int, int]]:
        """Return (index, sub, value) to write, in the order CiA 301 asks for.

        Args:
            node_id: Of the drive.
            event_timer: Of a PDO to be received: the longest time between two [ms], 0 = none.
            kept: Bits of the COB-ID that are the drive's: `NO_RTR` where it knows no request.
        """
        cob_id = self.cob_id(node_id) | kept
        found = [(self.communication, 1, cob_id | NOT_VALID),
                 (self.communication, 2, self.kind)]
        if event_timer:
            found.append((self.communication, 5, event_timer))
        found.append((self.mapping, 0, 0))
        found += [(self.mapping, place + 1, value) for place, value in enumerate(self.mappings)]
        return [*found, (self.mapping, 0, len(self.objects)), (self.communication, 1, cob_id)]


def layout(mode: str, at_sync: bool, velocity: bool,
           display: bool = True) -> tuple[Pdo, Pdo, Pdo | None]:
    """Return what is exchanged in each cycle: command; status and position; velocity, torque.

    Args:
        mode: torque or velocity.
        at_sync: Whether the drive applies a command at the next SYNC, not at its arrival.
        velocity: Whether the drive is to send its velocity.
        display: Whether it is to send its mode with the position.
    """
    target = TARGET_TORQUE if mode == 'torque' else TARGET_VELOCITY
    return (Pdo(0, RECEIVE, 1 if at_sync else 255, (CONTROLWORD, target)),
            Pdo(0, TRANSMIT, 1, (STATUSWORD, POSITION, *((MODE_DISPLAY,) if display else ()))),
            Pdo(1, TRANSMIT, 1, (VELOCITY, TORQUE)) if velocity else None)


def dictionary(more: tuple[Object, ...] = ()) -> Any:
    """Return the object dictionary for canopen, with four PDOs in each direction."""
    from canopen.objectdictionary import ObjectDictionary

    found = ObjectDictionary()
    items = [*STANDARD, *more]
    for communication, mapping, cob_id in (RECEIVE, TRANSMIT):
        for number in range(4):
            name = f'{"RPDO" if communication == RECEIVE[0] else "TPDO"}{number + 1}'
            record = communication + number
            items += [Object(record, 1, f'{name} COB-ID', U32, 'rw',
                             NOT_VALID | cob_id + 0x100 * number),
                      Object(record, 2, f'{name} transmission type', U8, 'rw', 255),
                      Object(record, 3, f'{name} inhibit time', U16, 'rw', 0),
                      Object(record, 5, f'{name} event timer', U16, 'rw', 0),
                      Object(mapping + number, 0, f'{name} mapped objects', U8, 'rw', 0)]
            items += [Object(mapping + number, place, f'{name} object {place}', U32, 'rw', 0)
                      for place in range(1, 9)]
    records = {item.index for item in items if item.sub}
    for item in items:
        _add(found, item, item.index in records)
    return found


def _add(found: Any, item: Object, in_record: bool) -> None:
    """Add an entry, and the record it belongs to."""
    from canopen.objectdictionary import ODRecord, ODVariable

    variable = ODVariable(item.name, item.index, item.sub)
    variable.data_type, variable.access_type = item.kind, item.access
    variable.default = item.default
    variable.pdo_mappable = True
    if not in_record:
        found.add_object(variable)
        return
    if item.index not in found:
        found.add_object(ODRecord(f'record {item.index:04X}h', item.index))
        if item.sub:
            highest = ODVariable('highest sub-index', item.index, 0)
            highest.data_type, highest.access_type, highest.default = U8, 'ro', 8
            found[item.index].add_member(highest)
    found[item.index].add_member(variable)
