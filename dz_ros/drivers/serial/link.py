# SPDX-License-Identifier: Apache-2.0
"""The host's side of the line: two threads, so that no caller waits for a port (ours).

The reader keeps the newest state, greets the device, and opens the port again for as long as it
takes when it has gone; the writer sends the newest command, and only ever that one. What the
device's watchdog lives on comes from `send` alone: a command to run is never repeated. One to stop
(SAFE, DISABLE) is, until the device answers that it has taken it.

A state counts only as far as `state_monitor` takes it. A difference between what was asked and
what the device does is remembered like a broken line: until `mend`. Power is given by `grant`, for
one session: in a later one, which began without the operator, the device gets only
requests to stay without.

Over 300 lines: reader, writer and session share one lock and one state, which a cut would hide.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
import secrets
import threading
import time
from typing import Any

from dz_ros.core.counted_log import Counted
from dz_ros.drivers.serial.device_clock import between, DeviceClock
from dz_ros.drivers.serial.framing import pack, Receiver
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    FrameError,
    Hello,
    Info,
    Request,
    State,
    VersionError,
)
from dz_ros.drivers.serial.state_monitor import StateMonitor, Wish
from dz_ros.errors import DriverError, MissingDependencyError

READ_WAIT = 0.02
"""Longest wait for bytes [s]."""
WRITE_WAIT = 0.1
"""A frame that cannot be written within this is dropped [s]."""
RETRY = 0.2
"""A port that is not there is tried again after each of these [s]."""
GREET = 0.05
"""A greeting that is not answered is repeated after each of these [s]."""
REPEAT = 0.02
"""A request to stop that is not answered is repeated after each of these [s]."""


class Link:
    """A line to one device.

    Args:
        port: Device file, or a URL that pyserial knows.
        baudrate: Bits per second.
        period_us: Interval between states [µs].
        silence: A device without a new state or an answer for longer is greeted again [s].
        motors: Number of motors that the device must have.
        baseline: Time over which `speed` is taken [s].

    Attributes:
        counts: States taken and connections.
        refused: Counts frames that were damaged, not taken or not written, by cause.
        monitor: Judge of the states.
        info: Description the device sent; None before it did.
        seq: Of the newest command written.
        broken: Why line or device is not the one greeted first, as text; stays until `mend`.
    """

    def __init__(self, port: str, baudrate: int, period_us: int, silence: float,
                 motors: int, baseline: float) -> None:
        self.port, self.baudrate, self.period_us = port, baudrate, period_us
        self._silence = silence
        self.motors = motors
        self._baseline = baseline
        self.counts = dict.fromkeys(('states', 'connections'), 0)
        self.refused = Counted()
        self.monitor = StateMonitor(self.refused)
        self.info: Info | None = None
        self.broken = ''
        self._news = threading.Condition()
        self._serial: Any = None
        self._receiver = Receiver(self.refused)
        self._session = 0
        self._state: tuple[State, float, float] | None = None
        self._clock = DeviceClock()
        self._before: deque[State] = deque()
        self._wish: Wish | None = None
        self._last_wish: Wish | None = None
        self.seq = 0
        self._identified = False
        self._granted = 0
        self._greeted = 0.0
        self._problem = ''
        self._closing = False
        self._threads: list[threading.Thread] = []
        self._writing = threading.Lock()

    # What the host's thread calls.

    def open(self, patience: float) -> Info:
        """Find the device and greet it.

        Args:
            patience: Longest wait for its answer [s].

        Raises:
            DriverError: No port, no answer, one of another version or another number of motors.
            MissingDependencyError: pyserial is not installed.
        """
        try:
            import serial  # noqa: F401
        except ImportError:
            raise MissingDependencyError("driver.name = 'serial' needs pyserial: pip install "
                                         "'dz_ros[serial]'") from None
        self._closing, self.info, self.broken, self._problem = False, None, '', ''
        self._state, self._wish, self._session, self._granted = None, None, 0, 0
        self.monitor.forget()
        self._connect()
        self._threads = [threading.Thread(target=work, name=f'{self.port} {work.__name__}',
                                          daemon=True) for work in (self._read, self._write)]
        for thread in self._threads:
            thread.start()
        if not self.wait(lambda: self._state is not None and self.info is not None, patience):
            raise DriverError(f'{self.port}: ' + (self.fault or (
                f'nothing that speaks the protocol answers within {patience:g} s at '
                f'{self.baudrate} baud')))
        assert self.info is not None
        return self.info

    def close(self) -> None:
        """Let go of the port."""
        with self._news:
            self._closing = True
            self._news.notify_all()
        for thread in self._threads:
            thread.join(2.0)
        self._disconnect('closed')

    def send(self, wish: Wish) -> None:
        """Have something sent, instead of what has not been sent yet; return at once."""
        with self._news:
            self._wish = wish
            self._news.notify_all()

    def newest(self) -> tuple[State, float, float] | None:
        """Return the newest state of this session, when it came and was measured [s, steady]."""
        return self._state

    def speed(self, motor: int) -> float:
        """Return how fast the first value of a motor has changed of late [counts/s].

        By the device's clock, over `baseline`; 0 where one state of the session is known.
        """
        with self._news:
            first, last = self._before[0], self._before[-1]
        passed = between(first, last)
        moved = last.values[motor][0] - first.values[motor][0]
        return moved / passed if passed > 0.0 else 0.0

    def taken(self) -> Wish | None:
        """Return the newest wish that the device has confirmed; None = not known."""
        return None if self._state is None else self.monitor.answered

    def wait(self, done: Callable[[], bool], patience: float) -> bool:
        """Wait until something holds, looking whenever a frame has arrived."""
        with self._news:
            return self._news.wait_for(lambda: done() or bool(self._problem), patience) and done()

    def mend(self) -> None:
        """Take the device as it is now for the one to work with.

        Raises:
            DriverError: It is not there.
        """
        if self._state is None or self._problem:
            raise DriverError(f'{self.port}: {self.fault or "no answer yet"}')
        with self._news:
            self.broken, self._wish, self._last_wish = '', None, None
            self.monitor.pardon()

    def grant(self) -> None:
        """Let commands of this session give the device power; a later session needs another."""
        self._granted = self._session

    @property
    def fault(self) -> str:
        """What is wrong with the line, or with the device at its end."""
        return self._problem or self.broken

    # Threads.

    def _read(self) -> None:
        while not self._closing:
            if self._serial is None:
                try:
                    self._connect()
                except DriverError:
                    with self._news:
                        self._news.wait_for(lambda: self._closing, RETRY)
                    continue
            try:
                data = self._serial.read(max(1, self._serial.in_waiting))
            except (OSError, TypeError, ValueError):    # pyserial's are OSErrors
                self._disconnect('the line has gone')
                continue
            for body in self._receiver.feed(data):
                self._receive(body)
            self._look(time.monotonic())

    def _look(self, now: float) -> None:
        """Greet a device that has not answered yet, or does no more."""
        if self._state is not None:
            with self._news:
                arrived = self._state[1]
                silent = now - arrived > self._silence
                # Only a state shows that a command has no answer; without one it is silence.
                if silent or self.monitor.outstanding(arrived) > self._silence:
                    stale = self.monitor.stale
                    what = (f'{stale}: nothing new' if stale else 'the device has sent nothing'
                            if silent else 'the device has taken no command')
                    self._break(f'{what} for {self._silence:g} s')
        if self._state is None and now - self._greeted > GREET:
            self._greet()

    def _write(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._closing or self._wish is not None,
                                    REPEAT if self._last_wish is not None else None)
                if self._closing and self._wish is None:
                    return
                wish = self._wish or self._unanswered()
                self._wish = None
                if wish is None:
                    self._last_wish = None
                    continue
                wish = self._permitted(wish)
                self._last_wish = None if wish.request is Request.RUN else wish
                self.seq = self.seq % (2 ** 32 - 1) + 1       # 0 answers no command
                seq, session = self.seq, self._session
                written = self.monitor.writing(seq, wish, time.monotonic())
            self._put(Command(session, seq, wish.v, wish.safe, wish.hold_ms, wish.request).body())
            written.ended = time.monotonic()

    def _unanswered(self) -> Wish | None:
        """Return a request to stop that the device has not taken yet, None where there is none."""
        wish = self._last_wish
        if wish is None or wish.request not in (Request.SAFE, Request.DISABLE):
            return None
        return wish if self._state is not None and self.monitor.unanswered else None

    def _permitted(self, wish: Wish) -> Wish:
        """Return what of a wish may be sent now.

        It may have been wished before the line broke: it must not move the device after it, nor
        give it power in a session the operator has not seen.
        """
        if wish.request is Request.RUN and self.fault:
            wish = replace(wish, request=Request.SAFE)
        if wish.request in (Request.RUN, Request.SAFE) and self._session != self._granted:
            wish = replace(wish, request=Request.DISABLE)
        return wish

    def _receive(self, body: bytes) -> None:
        """Take a frame that came over whole."""
        now = time.monotonic()
        try:
            frame = decode(body)
        except VersionError as error:
            with self._news:
                self._deny(f'the device {error}')
            frame = None
        except FrameError:
            frame = None
        with self._news:
            if isinstance(frame, (State, Info)) and frame.motors != self.motors:
                self._deny(self._other_number(frame.motors))
            elif isinstance(frame, State) and frame.session == self._session and self._identified:
                self._take(frame, now)
            elif (isinstance(frame, State) and self._state is not None
                  and not self.monitor.was_held_back(frame)):
                self.monitor.restarted |= frame.session == 0
                self._break('the device has restarted' if frame.session == 0 else
                            'the device has been greeted by another host')
            elif isinstance(frame, Info) and frame.session == self._session:
                if self.info is None or frame.identity == self.info.identity:
                    self.info, self._problem, self._identified = frame, '', True
                else:
                    self._deny(f'another device answers: {frame.name!r}')
            elif isinstance(frame, State):
                self.refused.add('states of another session')
            else:
                self.refused.add('frames of no use here')
            self._news.notify_all()

    def _take(self, state: State, now: float) -> None:
        """Take a state of this session, as far as it is new, and keep what is wrong with it."""
        assert self.info is not None
        if len(state.values[0]) != self.info.values:
            self.refused.add('states with another number of values')
            return
        taken, difference = self.monitor.take(state, now)
        if taken:
            if self._state is None:
                self._before.clear()
                self._clock = DeviceClock()
            self._before.append(state)
            while len(self._before) > 1 and between(self._before[1], state) >= self._baseline:
                self._before.popleft()
            self._state = state, now, self._clock.measured(state, now)
            self.counts['states'] += 1
        self.broken = self.broken or difference

    def _other_number(self, motors: int) -> str:
        """Return why a device with this number of motors is not the one, as text."""
        has = ('1 motor (version 1 of the protocol)' if motors == 1 else
               f'{motors} motors (version 2 of the protocol)')
        return (f'another number of axes: the device has {has}, at this port '
                + ('is 1 axis' if self.motors == 1 else f'are {self.motors} axes'))

    def _deny(self, reason: str) -> None:
        """Ignore what answers until the right device does."""
        self._problem, self._identified = reason, False
        if self._state is not None:
            self._break(reason)

    def _break(self, reason: str) -> None:
        """Begin a new session, and remember why, unless it was broken already."""
        self.broken = self.broken or reason
        self._state, self._identified = None, False
        self._greeted = 0.0

    # The port.

    def _connect(self) -> None:
        """Open the port and greet.

        Raises:
            DriverError: It cannot be opened.
        """
        import serial
        try:
            opened = serial.serial_for_url(self.port, baudrate=self.baudrate, timeout=READ_WAIT,
                                           write_timeout=WRITE_WAIT, exclusive=True)
        except (OSError, ValueError) as error:
            raise DriverError(f'driver.port = {self.port!r}: {_why(error)}') from None
        list(self._receiver.feed(b'\0'))    # whatever was cut off with the line
        self._serial = opened
        self.counts['connections'] += 1
        self._greet()

    def _greet(self) -> None:
        """Begin a session of a new number."""
        with self._news:
            if self._greeted == 0.0 or self._session == 0:
                self._session = secrets.randbelow(2 ** 32 - 1) + 1
                self._identified = False
                self.monitor.begin()
            self._greeted = time.monotonic()
            session = self._session
        # The zero ends whatever garbage the device may have of before.
        self._put(Hello(session, self.period_us, self.motors).body(), b'\0')

    def _put(self, body: bytes, before: bytes = b'') -> None:
        """Write a frame; drop it where the line takes nothing."""
        with self._writing:
            port = self._serial
            if port is None:
                return
            try:
                port.write(before + pack(body))
            except (OSError, TypeError, ValueError):    # a dead line shows at the reader
                self.refused.add('frames not written')

    def _disconnect(self, reason: str) -> None:
        with self._news:
            port, self._serial, self._state = self._serial, None, None
            if not self._closing:
                self._break(reason)
        if port is not None:
            with self._writing:
                port.close()


def _why(error: Exception) -> str:
    """Return pyserial's complaint in few words."""
    known = {2: 'there is no such port', 13: 'permission denied: on many systems the group '
             'dialout may use serial ports', 16: 'in use by another program', 11: 'in use by '
             'another program'}
    return known.get(getattr(error, 'errno', None) or 0, ' '.join(str(error).split()))
