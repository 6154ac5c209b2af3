# SPDX-License-Identifier: Apache-2.0
"""Messages between host and device, versions 1 and 2; little-endian, on `framing`'s frames (ours).

    HELLO    host → device   session, period of the states
    INFO     device → host   answer to HELLO: what it measures, limits, scales, name
    COMMAND  host → device   request, commands, what to hold when no further ones come, and when
    STATE    device → host   every period (0.1 s before the first HELLO): values, mode, faults, the
                             newest command taken

- **Session**: a number the host draws for each connection. A device that has restarted knows
  none (0), takes no command until it is greeted, and is seen to have restarted.
- **Level, not edge**: every COMMAND carries the whole request, so a lost one is healed by the
  next; only leaving FAULT or ESTOP needs a request of its own, RESET.
- **Watchdog**: a COMMAND is good for `hold` ms. Then the device takes `safe` by itself, and
  counts a trip.
- **Units**: commands and values are integers, in counts; INFO gives the size of a count. No NaN
  can travel.
- **Motors**: a device of one motor speaks version 1, one of 2 to 8 motors version 2. All motors
  share session, seq, clock, request, mode and watchdog; each has its commands, values, scales,
  limit and fault code.

`docs/serial.md` has the bytes in a table; `examples/firmware` the same in C.

Over 300 lines: every frame of both versions, made and read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import enum
import struct
from typing import Any, ClassVar

import numpy as np

ONE_MOTOR, MOTORS = 1, 2
"""Versions of the protocol: of a device of one motor, of one of several."""
MAX_MOTORS = 8
"""Motors of a device, at most."""
MAX_VALUES = 4
"""x, x', … at most this number."""
COUNT_LIMIT = 2 ** 31 - 1
"""Largest number of counts, either way."""
MAX_HOLD_MS = 1000
"""A device holds no command longer than this, whatever was asked [ms]."""


class Request(enum.IntEnum):
    """What the host wants of the device."""

    DISABLE = 0
    """No power to the actuator."""
    RUN = 1
    """Apply the command, if there is power."""
    SAFE = 2
    """Power on, hold the safe command; nothing else gives power."""
    ESTOP = 3
    """No power, latched until RESET."""
    RESET = 4
    """Leave FAULT or ESTOP for DISABLED, if the cause has gone."""


class Mode(enum.IntEnum):
    """What the device does."""

    DISABLED = 0
    RUN = 1
    SAFE = 2
    FAULT = 3
    ESTOP = 4


@dataclass(frozen=True)
class Hello:
    """Greeting of the host.

    Attributes:
        session: Number of this connection, not 0.
        period_us: Interval between states [µs].
        motors: Number of motors that the host commands.
    """

    session: int
    period_us: int
    motors: int = 1
    KIND: ClassVar[int] = 0x01
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBII')

    def body(self) -> bytes:
        """Return the body of its frame."""
        body = self.LAYOUT.pack(_version(self.motors), self.KIND, self.session, self.period_us)
        return body if self.motors == 1 else body + bytes([self.motors])


@dataclass(frozen=True)
class Command:
    """What the device is to do.

    Attributes:
        session: Of the connection it belongs to.
        seq: Count of commands, modulo 2^32; an older one than the newest is not taken.
        v: Command of each motor [counts], shape (motors,).
        safe: What to hold instead, on request and when commands stay away [counts], shape
            (motors,).
        hold_ms: For how long it is good [ms], 1 to 1000.
        request: What the host wants.
    """

    session: int
    seq: int
    v: tuple[int, ...]
    safe: tuple[int, ...]
    hold_ms: int
    request: Request
    KIND: ClassVar[int] = 0x02
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBIIiiHB')
    HEAD: ClassVar[struct.Struct] = struct.Struct('<BBIIHBB')

    @property
    def motors(self) -> int:
        """Number of motors it is for."""
        return len(self.v)

    def body(self) -> bytes:
        """Return the body of its frame."""
        if self.motors == 1:
            return self.LAYOUT.pack(ONE_MOTOR, self.KIND, self.session, self.seq, *self.v,
                                    *self.safe, self.hold_ms, self.request)
        return self.HEAD.pack(MOTORS, self.KIND, self.session, self.seq, self.hold_ms,
                              self.request, self.motors) + b''.join(
            map(struct.Struct('<ii').pack, self.v, self.safe))


@dataclass(frozen=True)
class MotorInfo:
    """What a motor of a device is.

    Attributes:
        limit: Largest |v| it takes [counts].
        command_scale: Actuator unit of a count of v.
        state_scales: Unit of a count of each value, shape (values,).
    """

    limit: int
    command_scale: float
    state_scales: tuple[float, ...]
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<if4f')

    def numbers(self) -> tuple[float, ...]:
        """Return the numbers of its layout."""
        return self.limit, self.command_scale, *(*self.state_scales,
                                                 *[0.0] * MAX_VALUES)[:MAX_VALUES]

    @classmethod
    def checked(cls, values: int, limit: int, *scales: float) -> MotorInfo:
        """Return what the numbers of a layout mean.

        Raises:
            ValueError: They mean nothing.
        """
        if limit <= 0:
            raise ValueError(f'limit {limit}, must be positive')
        used = scales[:1 + values]
        if not all(0.0 < item < float('inf') for item in used):
            raise ValueError(f'scales {used}, must be positive and finite')
        # The shortest decimal number that single precision holds so: 0.001, not 0.0010000000475.
        scale, *rest = (float(str(np.float32(item))) for item in used)
        return cls(limit, scale, tuple(rest))


@dataclass(frozen=True)
class Info:
    """What a device is.

    Attributes:
        session: Of the HELLO it answers.
        each: What its motors are; all measure the same number of values.
        name: Up to 16 bytes of UTF-8.
    """

    session: int
    each: tuple[MotorInfo, ...]
    name: str
    KIND: ClassVar[int] = 0x81
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBIBif4f16s')
    HEAD: ClassVar[struct.Struct] = struct.Struct('<BBIBB16s')

    @property
    def motors(self) -> int:
        """Number of its motors."""
        return len(self.each)

    @property
    def values(self) -> int:
        """How many of x, x', … it measures of each motor, 1 to 4."""
        return len(self.each[0].state_scales)

    @property
    def identity(self) -> tuple[object, ...]:
        """What must not change when a device comes back: all but the session."""
        return self.name, self.each

    def body(self) -> bytes:
        """Return the body of its frame."""
        name = self.name.encode()[:16]
        if self.motors == 1:
            return self.LAYOUT.pack(ONE_MOTOR, self.KIND, self.session, self.values,
                                    *self.each[0].numbers(), name)
        return self.HEAD.pack(MOTORS, self.KIND, self.session, self.motors, self.values,
                              name) + b''.join(
            MotorInfo.LAYOUT.pack(*motor.numbers()) for motor in self.each)


@dataclass(frozen=True)
class State:
    """What a device measures and does.

    Attributes:
        session: Of the connection; 0 = not greeted since it started.
        seq: Count of states, modulo 2^32.
        time_us: Device's clock at the measurement, modulo 2^32 [µs].
        echo: seq of the newest command taken.
        mode: What it does.
        trips: How often its watchdog has taken the safe command, modulo 256.
        faults: The device's own code for each motor, 0 = none, shape (motors,).
        values: x, x', … of each motor [counts], shape (motors, 1 … 4).
    """

    session: int
    seq: int
    time_us: int
    echo: int
    mode: Mode
    trips: int
    faults: tuple[int, ...]
    values: tuple[tuple[int, ...], ...]
    KIND: ClassVar[int] = 0x82
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBIIIIBBH')
    HEAD: ClassVar[struct.Struct] = struct.Struct('<BBIIIIBBBB')

    @property
    def motors(self) -> int:
        """Number of motors it is of."""
        return len(self.values)

    @classmethod
    def size(cls, motors: int, values: int) -> int:
        """Return the length of a body [bytes]."""
        return (cls.LAYOUT.size + 4 * values if motors == 1
                else cls.HEAD.size + motors * (2 + 4 * values))

    def body(self) -> bytes:
        """Return the body of its frame."""
        shared = self.KIND, self.session, self.seq, self.time_us, self.echo, self.mode, self.trips
        count = len(self.values[0])
        if self.motors == 1:
            return (self.LAYOUT.pack(ONE_MOTOR, *shared, *self.faults)
                    + struct.pack(f'<{count}i', *self.values[0]))
        row = struct.Struct(f'<H{count}i')
        return self.HEAD.pack(MOTORS, *shared, self.motors, count) + b''.join(
            row.pack(fault, *values)
            for fault, values in zip(self.faults, self.values, strict=True))


Frame = Hello | Command | Info | State
"""Whatever travels."""


class FrameError(ValueError):
    """A frame that came over whole and is not one of this protocol."""


class VersionError(FrameError):
    """A frame of another version."""

    def __init__(self, version: int) -> None:
        self.version = version
        super().__init__(f'speaks version {version} of the protocol, not {ONE_MOTOR} or {MOTORS}')


def decode(body: bytes) -> Frame:
    """Return the frame that a body is.

    Raises:
        VersionError: It is of another version.
        FrameError: It is of no kind, length or content that these versions know.
    """
    if len(body) < 2:
        raise FrameError('has no kind')
    if body[0] not in (ONE_MOTOR, MOTORS):
        raise VersionError(body[0])
    try:
        return _DECODERS[body[0], body[1]](body)
    except KeyError:
        raise FrameError(f'is of kind {body[1]:#04x}, which there is not') from None
    except (struct.error, ValueError) as error:
        raise FrameError(f'of kind {body[1]:#04x}: {error}') from None


def _version(motors: int) -> int:
    return ONE_MOTOR if motors == 1 else MOTORS


def _hello(body: bytes) -> Hello:
    motors = 1
    if body[0] == MOTORS:
        body, motors = body[:-1], _several(body[-1])
    _, _, session, period_us = Hello.LAYOUT.unpack(body)
    if session == 0 or period_us == 0:
        raise ValueError('session and period must not be 0')
    return Hello(session, period_us, motors)


def _command(body: bytes) -> Command:
    _, _, session, seq, v, safe, hold_ms, request = Command.LAYOUT.unpack(body)
    return _checked_command(session, seq, (v,), (safe,), hold_ms, request)


def _commands(body: bytes) -> Command:
    head = Command.HEAD.size
    _, _, session, seq, hold_ms, request, motors = Command.HEAD.unpack(body[:head])
    counts = struct.unpack(f'<{2 * _several(motors)}i', body[head:])
    return _checked_command(session, seq, counts[::2], counts[1::2], hold_ms, request)


def _checked_command(session: int, seq: int, v: tuple[int, ...], safe: tuple[int, ...],
                     hold_ms: int, request: int) -> Command:
    if not 1 <= hold_ms <= MAX_HOLD_MS:
        raise ValueError(f'good for {hold_ms} ms, must be 1 to {MAX_HOLD_MS}')
    return Command(session, seq, v, safe, hold_ms, Request(request))


def _info(body: bytes) -> Info:
    _, _, session, values, *numbers, name = Info.LAYOUT.unpack(body)
    return _checked_info(session, values, [numbers], name)


def _infos(body: bytes) -> Info:
    head = Info.HEAD.size
    _, _, session, motors, values, name = Info.HEAD.unpack(body[:head])
    rows = list(MotorInfo.LAYOUT.iter_unpack(body[head:]))
    if len(rows) != _several(motors):
        raise ValueError(f'{len(rows)} rows for {motors} motors')
    return _checked_info(session, values, rows, name)


def _checked_info(session: int, values: int, rows: Sequence[Sequence[Any]], name: bytes) -> Info:
    if not 1 <= values <= MAX_VALUES:
        raise ValueError(f'measures {values} values, must be 1 to {MAX_VALUES}')
    return Info(session, tuple(MotorInfo.checked(values, *row) for row in rows),
                name.rstrip(b'\0').decode(errors='replace'))


def _state(body: bytes) -> State:
    head = State.LAYOUT.size
    count, odd = divmod(len(body) - head, 4)
    if odd or not 1 <= count <= MAX_VALUES:
        raise ValueError(f'{len(body)} bytes long')
    _, _, session, seq, time_us, echo, mode, trips, fault = State.LAYOUT.unpack(body[:head])
    return State(session, seq, time_us, echo, Mode(mode), trips, (fault,),
                 (struct.unpack(f'<{count}i', body[head:]),))


def _states(body: bytes) -> State:
    head = State.HEAD.size
    _, _, session, seq, time_us, echo, mode, trips, motors, count = State.HEAD.unpack(body[:head])
    if not 1 <= count <= MAX_VALUES or len(body) != State.size(_several(motors), count):
        raise ValueError(f'{len(body)} bytes long')
    rows = list(struct.Struct(f'<H{count}i').iter_unpack(body[head:]))
    return State(session, seq, time_us, echo, Mode(mode), trips, tuple(row[0] for row in rows),
                 tuple(row[1:] for row in rows))


def _several(motors: int) -> int:
    """Return a number of motors that version 2 has.

    Raises:
        ValueError: It is another one.
    """
    if not 2 <= motors <= MAX_MOTORS:
        raise ValueError(f'{motors} motors, must be 2 to {MAX_MOTORS}')
    return motors


_DECODERS: Mapping[tuple[int, int], Callable[[bytes], Frame]] = {
    (ONE_MOTOR, Hello.KIND): _hello, (ONE_MOTOR, Command.KIND): _command,
    (ONE_MOTOR, Info.KIND): _info, (ONE_MOTOR, State.KIND): _state,
    (MOTORS, Hello.KIND): _hello, (MOTORS, Command.KIND): _commands,
    (MOTORS, Info.KIND): _infos, (MOTORS, State.KIND): _states}


def newer(seq: int, than: int) -> bool:
    """Return whether a count modulo 2^32 is ahead of another."""
    return 0 < (seq - than) % 2 ** 32 < 2 ** 31
