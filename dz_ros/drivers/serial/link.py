"""The host's side of the line: two threads, so that nobody waits for a port (ours).

The reader keeps the newest state, greets the device, and opens the port again for as long as it
takes when it has gone; the writer sends the newest command, and only ever that one. What the
device's watchdog lives on comes from `send` alone: neither thread repeats a command by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import secrets
import threading
import time
from typing import Any

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
from dz_ros.errors import DriverError, MissingDependencyError

READ_WAIT = 0.02
"""Longest wait for bytes [s]."""
WRITE_WAIT = 0.1
"""A frame that cannot be written within this is dropped [s]."""
RETRY = 0.2
"""A port that is not there is tried again after each of these [s]."""
GREET = 0.05
"""A greeting that is not answered is repeated after each of these [s]."""


@dataclass(frozen=True)
class Wish:
    """The newest that the host wants: request, v and safe command [counts], how long [ms]."""

    request: Request
    v: int
    safe: int
    hold_ms: int


class Link:
    """A line to one device.

    Args:
        port: Device file, or a URL that pyserial knows.
        baudrate: Bits per second.
        period_us: Interval between states [µs].
        silence: A device that says nothing for so long is greeted anew [s].

    Attributes:
        counts: Frames and connections, by what became of them.
        info: What the device said it is; None before it did.
        broken: Why line or device is not the one greeted first, in words; stays until `mend`.
    """

    def __init__(self, port: str, baudrate: int, period_us: int, silence: float) -> None:
        self.port, self.baudrate, self.period_us = port, baudrate, period_us
        self._silence = silence
        self.counts = dict.fromkeys(('states', 'other frames', 'strange frames', 'not written',
                                     'connections'), 0)
        self.info: Info | None = None
        self.broken = ''
        self._news = threading.Condition()
        self._serial: Any = None
        self._receiver = Receiver()
        self._session = 0
        self._state: tuple[State, float] | None = None
        self._wish: Wish | None = None
        self._sent: dict[int, Wish] = {}
        self._seq = 0
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
            DriverError: No port, no answer, or one of another version.
            MissingDependencyError: pyserial is not installed.
        """
        try:
            import serial  # noqa: F401
        except ImportError:
            raise MissingDependencyError("driver.name = 'serial' needs pyserial: pip install "
                                         "'dz_ros[serial]'") from None
        self._closing, self.info, self.broken, self._problem = False, None, '', ''
        self._state, self._wish, self._session = None, None, 0
        self._connect()
        self._threads = [threading.Thread(target=work, name=f'{self.port} {work.__name__}',
                                          daemon=True) for work in (self._read, self._write)]
        for thread in self._threads:
            thread.start()
        if not self.wait(lambda: self._state is not None and self.info is not None, patience):
            raise DriverError(f'{self.port}: ' + (self.trouble or (
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

    def newest(self) -> tuple[State, float] | None:
        """Return the newest state of this session and when it arrived [s, steady]."""
        return self._state

    def taken(self) -> Wish | None:
        """Return the newest wish that the device says it has taken; None = not known."""
        found = self._state
        return None if found is None else self._sent.get(found[0].echo)

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
            raise DriverError(f'{self.port}: {self.trouble or "no answer yet"}')
        with self._news:
            self.broken, self._wish = '', None

    @property
    def trouble(self) -> str:
        """What is wrong with the line, or with who is at its end."""
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
                self._hear(body)
            self._look(time.monotonic())

    def _look(self, now: float) -> None:
        """Greet a device that has not answered yet, or does no more."""
        if self._state is not None and now - self._state[1] > self._silence:
            with self._news:
                self._break(f'the device has said nothing for {self._silence:g} s')
        if self._state is None and now - self._greeted > GREET:
            self._greet()

    def _write(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._closing or self._wish is not None)
                if self._closing and self._wish is None:
                    return
                wish, self._wish = self._wish, None
                if wish is not None and wish.request is Request.RUN and self.trouble:
                    # Wished before the line broke: it must not move the device after it.
                    wish = replace(wish, request=Request.SAFE)
                self._seq = (self._seq + 1) % 2 ** 32
                seq, session = self._seq, self._session
            if wish is not None:
                self._sent[seq] = wish
                self._sent.pop(seq - 256, None)     # has been answered, or never will be
                self._put(Command(session, seq, wish.v, wish.safe, wish.hold_ms, wish.request)
                          .body())

    def _hear(self, body: bytes) -> None:
        """Take a frame that came over whole."""
        try:
            frame = decode(body)
        except VersionError as error:
            self._problem = f'the device {error}'
            frame = None
        except FrameError:
            frame = None
        with self._news:
            if isinstance(frame, State) and frame.session == self._session:
                self._state = frame, time.monotonic()
                self.counts['states'] += 1
            elif isinstance(frame, State) and self._state is not None:
                self._break('the device has started anew' if frame.session == 0 else
                            'the device has been greeted by another host')
            elif isinstance(frame, Info) and frame.session == self._session:
                if self.info is None or frame.shape == self.info.shape:
                    self.info, self._problem = frame, ''
                else:
                    self._problem = f'another device answers: {frame.name!r}'
            elif isinstance(frame, State):
                self.counts['other frames'] += 1    # of the session before this one
            else:
                self.counts['strange frames'] += 1
            self._news.notify_all()

    def _break(self, reason: str) -> None:
        """Begin a new session, and remember why, unless it was broken already."""
        self.broken = self.broken or reason
        self._state = None
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
        """Begin a session of a number nobody has had."""
        with self._news:
            if self._greeted == 0.0 or self._session == 0:
                self._session = secrets.randbelow(2 ** 32 - 1) + 1
            self._greeted = time.monotonic()
            session = self._session
        # The zero ends whatever garbage the device may have of before.
        self._put(Hello(session, self.period_us).body(), b'\0')

    def _put(self, body: bytes, before: bytes = b'') -> None:
        """Write a frame; drop it where the line takes nothing."""
        with self._writing:
            port = self._serial
            if port is None:
                return
            try:
                port.write(before + pack(body))
            except (OSError, TypeError, ValueError):    # a dead line shows at the reader
                self.counts['not written'] += 1

    def _disconnect(self, reason: str) -> None:
        with self._news:
            port, self._serial, self._state = self._serial, None, None
            if not self._closing:
                self._break(reason)
        if port is not None:
            with self._writing:
                port.close()

    def rejected(self) -> dict[str, int]:
        """Return how many lines were damaged, by what was wrong with them."""
        return dict(self._receiver.counts)


def _why(error: Exception) -> str:
    """Return pyserial's complaint in few words."""
    known = {2: 'there is no such port', 13: 'permission denied: on many systems the group '
             'dialout may use serial ports', 16: 'in use by another program', 11: 'in use by '
             'another program'}
    return known.get(getattr(error, 'errno', None) or 0, ' '.join(str(error).split()))
