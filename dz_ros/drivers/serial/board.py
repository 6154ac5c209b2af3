# SPDX-License-Identifier: Apache-2.0
"""A microcontroller at a port, as the axes of its motors share it (ours).

The host calls the driver of each axis as if it were alone. What is one for all motors is one here:
the line, the state that a sample is measured by, power, mode, request and watchdog.

- A command is sent once every open axis has given its own, in one frame; where one stays away none
  is sent, and the device's watchdog acts. The motor of an axis that is not open has its safe one.
- A request to stop of one axis is one of all, and is sent at once.
- Power is given and taken, faults are left and a sample is measured once for all axes, when the
  first of them asks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
import time
from typing import Any, Protocol, TypeVar

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.freshness import BASELINE
from dz_ros.drivers.serial.link import Link
from dz_ros.drivers.serial.protocol import Info, Mode, Request, State
from dz_ros.drivers.serial.settings import motors_of, SerialParameters
from dz_ros.drivers.serial.state_monitor import Wish
from dz_ros.errors import DriverError

ANSWER = 0.5
"""A device that is there does what it is asked within this [s]."""

Result = TypeVar('Result')


class RefusedError(DriverError):
    """The device does not do what it was asked; why is known of each motor.

    Attributes:
        what: What it does not do, as text; '' = only the reason is given.
    """

    def __init__(self, what: str) -> None:
        self.what = f'the device does not {what}: ' if what else ''
        super().__init__(self.what)


class Axis(Protocol):
    """What a board has to know of the driver of an axis.

    Attributes:
        hold_ms: How long it lets the device hold a command [ms].
    """

    hold_ms: int

    def fault(self) -> str:
        """Return what is wrong with the device or with the motor of this axis."""

    def safe_count(self) -> int:
        """Return the safe command [counts]."""


class Board:
    """A device with a motor for each of some axes.

    Args:
        each: Configurations of the axes at its port, each as of a loop of this axis alone.

    Attributes:
        link: The line.
        motors: Which motor each of the axes has, in their order.
        axes: Motor → driver of its axis.
        powered: Whether it was given power and this was not taken since.
    """

    def __init__(self, each: Sequence[Configuration]) -> None:
        shared: SerialParameters = each[0].driver_parameters
        self.motors = motors_of(each)
        self._patience = shared.patience
        self._absolute = all(item.driver_parameters.absolute_encoder for item in each)
        self.link = Link(shared.port, shared.baudrate, round(1e6 / shared.device_rate),
                         shared.silence, len(each), BASELINE * each[0].loop.period)
        self.powered = False
        self.axes: dict[int, Axis] = {}
        self._wishes: dict[int, tuple[Request, int, int]] = {}
        self._opened: set[int] = set()
        self._work: Callable[[], Any] | None = None
        self._asked: set[int] = set()
        self._result: Any = None

    def measure(self) -> tuple[State, float, float, float] | None:
        """Return the newest state, when it arrived and was measured, and now [s]; or None."""
        found = self.link.newest()
        return None if found is None else (*found, time.monotonic())

    def once(self, motor: int, work: Callable[[], Result]) -> Result:
        """Return what work returns that is done once for all axes.

        Args:
            motor: Of the axis that asks. The first open one has it done, and one that asks again.
            work: Function of this board or of its line.

        Raises:
            DriverError: The work has raised it.
        """
        if work != self._work or motor in (*self._asked, self._first()):
            self._work, self._asked = None, set()
            try:
                self._result = work()
            except DriverError as error:
                self._result = error
            self._work = work
        self._asked.add(motor)
        if isinstance(self._result, DriverError):
            raise self._result
        return self._result  # type: ignore[no-any-return]

    # Lifecycle.

    def open(self, motor: int) -> Info:
        """Find the device for the axis of a motor, greet it where that is the first one.

        Raises:
            DriverError: It is not there, or is another one.
            MissingDependencyError: pyserial is not installed.
        """
        self._opened.add(motor)
        if len(self._opened) == 1 or self.link.info is None:
            return self.link.open(self._patience)
        return self.link.info

    def close(self, motor: int) -> None:
        """Let go of the port once no axis needs it."""
        self._opened.discard(motor)
        if not self._opened:
            self.link.close()

    def enable(self) -> None:
        """Have power on, at the safe commands.

        Raises:
            DriverError: The device refuses.
        """
        self._accept()
        if self._mode() is Mode.FAULT:
            self._ask(Request.RESET, (Mode.DISABLED, Mode.SAFE), 'leave its fault')
        if self.fault():
            raise RefusedError('')
        self._give_power()
        self.powered = True

    def disable(self) -> None:
        """Take power away; a device that does not receive it holds the safe commands by itself."""
        self.powered = False
        with contextlib.suppress(DriverError):  # it is not there, and its watchdog has acted
            self._ask(Request.DISABLE, (Mode.DISABLED, Mode.FAULT, Mode.ESTOP), 'give power off')

    def recover(self) -> None:
        """Take the device as it is now, clear its fault or e-stop, give it power if it had it.

        Raises:
            DriverError: It is not there, its fault lasts, or its position is lost.
        """
        self._accept()
        if self._mode() in (Mode.FAULT, Mode.ESTOP):
            self._ask(Request.RESET, (Mode.DISABLED, Mode.SAFE), 'leave its fault')
        if self.powered:
            self._give_power()

    def resume(self) -> None:
        """Take the device as it is now, give it power if it had it; its fault or e-stop lasts.

        Raises:
            DriverError: It is not there, takes no power, or its position is lost.
        """
        self._accept()
        if self.powered and self._mode() not in (Mode.FAULT, Mode.ESTOP):
            self._give_power()          # asks for no reset, whatever has come since

    # Each sample.

    def command(self, motor: int, request: Request, v: int, safe: int) -> None:
        """Take what an axis wants [counts]; send it with that of all others, to stop at once."""
        if motor == self._first():      # what is left of an earlier sample is of no use
            self._wishes.clear()
        self._wishes[motor] = request, v, safe
        complete = self._wishes.keys() >= self._opened
        if not complete and request is Request.RUN:
            return
        requests = {wish[0] for wish in self._wishes.values()}
        rows = [self._wishes.get(place, (request, count, count))
                for place, count in enumerate(self._safe())]
        self._send(Request.SAFE if Request.SAFE in requests else Request.RUN,
                   tuple(row[1] for row in rows), tuple(row[2] for row in rows))
        if complete:
            self._wishes.clear()

    def fault(self) -> str:
        """Return what is wrong with the device, as any of the open axes reports it."""
        return next(filter(None, (self.axes[motor].fault() for motor in self._opened)), '')

    def trip(self, motor: int, codes: Sequence[int]) -> str:
        """Return what the axis of a motor reports of the device's fault codes.

        That of another open axis is reported by that one: ''.
        """
        if codes[motor] or not any(codes):
            return f'the device reports fault {codes[motor]}'
        other = next(place for place, code in enumerate(codes) if code)
        if any(codes[place] for place in self._opened):
            return ''
        return f'the device reports fault {codes[other]} of motor {other}'

    # Requests to the device.

    def _first(self) -> int | None:
        """Return the motor of the first open axis; None where none is."""
        return next((motor for motor in self.motors if motor in self._opened), None)

    def _mode(self) -> Mode | None:
        """Return the device's newest mode; None where nothing is known."""
        found = self.link.newest()
        return None if found is None else found[0].mode

    def _accept(self) -> None:
        """Take the device that is there for the one to work with.

        Raises:
            DriverError: There is none, or it has lost its position.
        """
        self.link.mend()
        if self.link.monitor.restarted and not self._absolute:
            raise DriverError(f'{self.link.port}: the device has restarted and its position '
                              'is lost (driver.absolute_encoder = false): home it, then start '
                              'the loop again')

    def _give_power(self) -> None:
        """Have power on, at the safe commands, in this session of the line.

        Raises:
            DriverError: The device refuses.
        """
        self.link.grant()
        self._ask(Request.SAFE, (Mode.SAFE,), 'take power')

    def _safe(self) -> tuple[int, ...]:
        """Return the safe command of each motor [counts]."""
        return tuple(self.axes[motor].safe_count() for motor in range(len(self.axes)))

    def _send(self, request: Request, v: tuple[int, ...], safe: tuple[int, ...]) -> None:
        hold_ms = min(axis.hold_ms for axis in self.axes.values())
        self.link.send(Wish(request, v, safe, hold_ms))

    def _ask(self, request: Request, wanted: tuple[Mode, ...], what: str) -> None:
        """Ask until the device has taken the request and is in one of the modes.

        Raises:
            RefusedError: It is not, in time.
        """
        give_up = time.monotonic() + ANSWER
        asked = time.monotonic()

        def done() -> bool:
            found, taken = self.link.newest(), self.link.taken()
            return (found is not None and found[1] > asked and found[0].mode in wanted
                    and taken is not None and taken.request is request)

        while time.monotonic() < give_up:
            self._send(request, self._safe(), self._safe())
            if self.link.wait(done, 0.05):
                return
        raise RefusedError(what)
