# SPDX-License-Identifier: Apache-2.0
"""The device's side of the protocol: modes, watchdog, states. No port, no clock (ours).

    DISABLED ──SAFE──▶ SAFE ──RUN──▶ RUN               any but ESTOP ──fault──▶ FAULT
    RUN ──SAFE, watchdog──▶ SAFE                       any ──ESTOP──▶ ESTOP
    SAFE, RUN ──DISABLE──▶ DISABLED                    FAULT, ESTOP ──RESET──▶ DISABLED

RUN gives no power: only SAFE does, so that a command that comes late to a session moves nothing.
FAULT and ESTOP are latched: only RESET leaves them, FAULT only once its cause has gone. Of several
motors all have the one mode: a fault of one takes the power of all. The same machine, in C for a
microcontroller, is ``examples/firmware/dz_device.c``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from dz_ros.drivers.serial.framing import pack, Receiver
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    FrameError,
    Hello,
    Info,
    Mode,
    newer,
    Request,
    State,
)

MIN_PERIOD_US, MAX_PERIOD_US = 200, 2 ** 31 - 1
"""Shortest and longest interval between states, whatever a host asks for [µs]."""
IDLE_PERIOD_US = 100_000
"""Interval between states before the first greeting [µs]."""


class Device:
    """A device as the line sees it.

    Args:
        info: What it is; its session is ignored.
        measure: Returns the values of each motor now [counts], shape (motors, values), and their
            fault codes, 0 = none, shape (motors,).
        actuate: Takes what the motors are to do [counts], shape (motors,); None = no power.

    Attributes:
        mode: What it does.
        trips: How often its watchdog has acted.
        due: When the next state is sent [µs].
        seq: Of the newest state sent.
    """

    def __init__(self, info: Info,
                 measure: Callable[[], tuple[Sequence[Sequence[int]], Sequence[int]]],
                 actuate: Callable[[tuple[int, ...] | None], None]) -> None:
        self.mode = Mode.DISABLED
        self.trips = 0
        self._info = info
        self._measure = measure
        self._actuate = actuate
        self._receiver = Receiver()
        self._session = 0
        self._period = IDLE_PERIOD_US
        self.due = 0
        self.seq = 0
        self._echo = 0
        self._fresh = True      # no command of this session yet
        self._safe = (0,) * info.motors
        self._good_until = 0
        self._faults = self._safe
        self._actuate(None)

    def step(self, received: bytes, now: int) -> bytes:
        """Take what has arrived by `now` [µs], look at the clock; return what to send."""
        sent = b''
        for body in self._receiver.feed(received):
            try:
                frame = decode(body)
            except FrameError:
                continue
            if frame.motors != self._info.motors:
                continue
            if isinstance(frame, Hello):
                sent += self._greet(frame, now)
            elif isinstance(frame, Command):
                self._take(frame, now)
        if self.mode in (Mode.RUN, Mode.SAFE) and now >= self._good_until:
            if self.mode is Mode.RUN:
                self.trips += 1
            self._enter(Mode.SAFE)
        values, codes = self._measure()
        if any(codes) and self.mode is not Mode.ESTOP:
            self._faults = tuple(code or before for code, before
                                 in zip(codes, self._faults, strict=True))
            self._enter(Mode.FAULT)
        if self.seq == 0 or now >= self.due:
            self.due += self._period
            if self.seq == 0 or now >= self.due:   # the first, or late by a whole period
                self.due = now + self._period
            self.seq = (self.seq + 1) % 2 ** 32
            sent += pack(State(self._session, self.seq, now % 2 ** 32, self._echo, self.mode,
                               self.trips % 256, self._faults,
                               tuple(map(tuple, values))).body())
        return sent

    def _greet(self, hello: Hello, now: int) -> bytes:
        """Begin a session without power; the same HELLO again changes nothing but the period."""
        if hello.session != self._session:
            self._session = hello.session
            self._fresh = True
            self._echo = 0
            if self.mode in (Mode.RUN, Mode.SAFE):
                self._enter(Mode.DISABLED)
        self._period = min(max(hello.period_us, MIN_PERIOD_US), MAX_PERIOD_US)
        self.due = now
        return pack(replace(self._info, session=self._session).body())

    def _take(self, command: Command, now: int) -> None:
        """Do what a command asks, if it is of this session and newer than the newest."""
        if self._session == 0 or command.session != self._session:
            return
        if not self._fresh and not newer(command.seq, self._echo):
            return
        self._fresh = False
        self._echo = command.seq
        self._good_until = now + 1000 * command.hold_ms
        self._safe = self._clip(command.safe)
        request = command.request
        if request is Request.ESTOP:
            self._enter(Mode.ESTOP)
        elif self.mode in (Mode.FAULT, Mode.ESTOP):
            if request is Request.RESET:
                self._faults = (0,) * self._info.motors
                self._enter(Mode.DISABLED)      # a fault that lasts is back before the next state
        elif request is Request.RUN and self.mode is not Mode.DISABLED:
            self._enter(Mode.RUN, self._clip(command.v))
        elif request is Request.SAFE:
            self._enter(Mode.SAFE)
        elif request is Request.DISABLE:
            self._enter(Mode.DISABLED)

    def _enter(self, mode: Mode, v: tuple[int, ...] = ()) -> None:
        """Take a mode and give the motors what belongs to it."""
        self.mode = mode
        self._actuate(v if mode is Mode.RUN else self._safe if mode is Mode.SAFE else None)

    def _clip(self, counts: Sequence[int]) -> tuple[int, ...]:
        return tuple(min(max(count, -motor.limit), motor.limit)
                     for count, motor in zip(counts, self._info.each, strict=True))
