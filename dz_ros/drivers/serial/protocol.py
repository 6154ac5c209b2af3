# SPDX-License-Identifier: Apache-2.0
"""Messages between host and device, version 1; little-endian, on `framing`'s frames (ours).

    HELLO    host → device   session, period of the states
    INFO     device → host   answer to HELLO: what it measures, limit, scales, name
    COMMAND  host → device   request, command, what to hold when no further one comes, and when
    STATE    device → host   every period (0.1 s before the first HELLO): values, mode, fault, the
                             newest command taken

- **Session**: a number the host draws for each connection. A device that has restarted knows
  none (0), takes no command until it is greeted, and is seen to have restarted.
- **Level, not edge**: every COMMAND carries the whole request, so a lost one is healed by the
  next; only leaving FAULT or ESTOP needs a request of its own, RESET.
- **Watchdog**: a COMMAND is good for `hold` ms. Then the device takes `safe` by itself, and
  counts a trip.
- **Units**: commands and values are integers, in counts; INFO gives the size of a count. No NaN
  can travel.

`docs/serial.md` has the bytes in a table; `examples/firmware` the same in C.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import enum
import struct
from typing import ClassVar

import numpy as np

VERSION = 1
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
    """

    session: int
    period_us: int
    KIND: ClassVar[int] = 0x01
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBII')

    def body(self) -> bytes:
        """Return the body of its frame."""
        return self.LAYOUT.pack(VERSION, self.KIND, self.session, self.period_us)


@dataclass(frozen=True)
class Command:
    """What the device is to do.

    Attributes:
        session: Of the connection it belongs to.
        seq: Count of commands, modulo 2^32; an older one than the newest is not taken.
        v: Command [counts].
        safe: What to hold instead, on request and when commands stay away [counts].
        hold_ms: For how long it is good [ms], 1 to 1000.
        request: What the host wants.
    """

    session: int
    seq: int
    v: int
    safe: int
    hold_ms: int
    request: Request
    KIND: ClassVar[int] = 0x02
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBIIiiHB')

    def body(self) -> bytes:
        """Return the body of its frame."""
        return self.LAYOUT.pack(VERSION, self.KIND, self.session, self.seq, self.v, self.safe,
                                self.hold_ms, self.request)


@dataclass(frozen=True)
class Info:
    """What a device is.

    Attributes:
        session: Of the HELLO it answers.
        values: How many of x, x', … it measures, 1 to 4.
        limit: Largest |v| it takes [counts].
        command_scale: Actuator unit of a count of v.
        state_scales: Unit of a count of each value, shape (values,).
        name: Up to 16 bytes of UTF-8.
    """

    session: int
    values: int
    limit: int
    command_scale: float
    state_scales: tuple[float, ...]
    name: str
    KIND: ClassVar[int] = 0x81
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBIBif4f16s')

    @property
    def identity(self) -> tuple[object, ...]:
        """What must not change when a device comes back: all but the session."""
        return self.name, self.values, self.limit, self.command_scale, self.state_scales

    def body(self) -> bytes:
        """Return the body of its frame."""
        scales = (*self.state_scales, *[0.0] * MAX_VALUES)[:MAX_VALUES]
        return self.LAYOUT.pack(VERSION, self.KIND, self.session, self.values, self.limit,
                                self.command_scale, *scales, self.name.encode()[:16])


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
        fault: The device's own code, 0 = none.
        values: x, x', … [counts], shape (1 … 4,).
    """

    session: int
    seq: int
    time_us: int
    echo: int
    mode: Mode
    trips: int
    fault: int
    values: tuple[int, ...]
    KIND: ClassVar[int] = 0x82
    LAYOUT: ClassVar[struct.Struct] = struct.Struct('<BBIIIIBBH')

    def body(self) -> bytes:
        """Return the body of its frame."""
        return self.LAYOUT.pack(VERSION, self.KIND, self.session, self.seq, self.time_us,
                                self.echo, self.mode, self.trips, self.fault) \
            + struct.pack(f'<{len(self.values)}i', *self.values)


Frame = Hello | Command | Info | State
"""Whatever travels."""


class FrameError(ValueError):
    """A frame that came over whole and is not one of this protocol."""


class VersionError(FrameError):
    """A frame of another version."""

    def __init__(self, version: int) -> None:
        self.version = version
        super().__init__(f'speaks version {version} of the protocol, not {VERSION}')


def decode(body: bytes) -> Frame:
    """Return the frame that a body is.

    Raises:
        VersionError: It is of another version.
        FrameError: It is of no kind, length or content that this version knows.
    """
    if len(body) < 2:
        raise FrameError('has no kind')
    if body[0] != VERSION:
        raise VersionError(body[0])
    try:
        return _DECODERS[body[1]](body)
    except KeyError:
        raise FrameError(f'is of kind {body[1]:#04x}, which there is not') from None
    except (struct.error, ValueError) as error:
        raise FrameError(f'of kind {body[1]:#04x}: {error}') from None


def _hello(body: bytes) -> Hello:
    _, _, session, period_us = Hello.LAYOUT.unpack(body)
    if session == 0 or period_us == 0:
        raise ValueError('session and period must not be 0')
    return Hello(session, period_us)


def _command(body: bytes) -> Command:
    _, _, session, seq, v, safe, hold_ms, request = Command.LAYOUT.unpack(body)
    if not 1 <= hold_ms <= MAX_HOLD_MS:
        raise ValueError(f'good for {hold_ms} ms, must be 1 to {MAX_HOLD_MS}')
    return Command(session, seq, v, safe, hold_ms, Request(request))


def _info(body: bytes) -> Info:
    _, _, session, values, limit, scale, *scales, name = Info.LAYOUT.unpack(body)
    if not 1 <= values <= MAX_VALUES:
        raise ValueError(f'measures {values} values, must be 1 to {MAX_VALUES}')
    if limit <= 0:
        raise ValueError(f'limit {limit}, must be positive')
    used = (scale, *scales[:values])
    if not all(0.0 < item < float('inf') for item in used):
        raise ValueError(f'scales {used}, must be positive and finite')
    # The shortest decimal number that single precision holds so: 0.001, not 0.0010000000475.
    scale, *scales = (float(str(np.float32(item))) for item in used)
    return Info(session, values, limit, scale, tuple(scales),
                name.rstrip(b'\0').decode(errors='replace'))


def _state(body: bytes) -> State:
    head = State.LAYOUT.size
    count, odd = divmod(len(body) - head, 4)
    if odd or not 1 <= count <= MAX_VALUES:
        raise ValueError(f'{len(body)} bytes long')
    _, _, session, seq, time_us, echo, mode, trips, fault = State.LAYOUT.unpack(body[:head])
    return State(session, seq, time_us, echo, Mode(mode), trips, fault,
                 struct.unpack(f'<{count}i', body[head:]))


_DECODERS: Mapping[int, Callable[[bytes], Frame]] = {
    Hello.KIND: _hello, Command.KIND: _command, Info.KIND: _info, State.KIND: _state}


def newer(seq: int, than: int) -> bool:
    """Return whether a count modulo 2^32 is ahead of another."""
    return 0 < (seq - than) % 2 ** 32 < 2 ** 31
