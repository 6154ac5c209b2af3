"""The bus with one drive on it: SDO, NMT and what the drive sends, kept for whoever asks (ours).

canopen's receiving thread calls the ``_on_…`` methods; the newest measurement is one immutable
value that they exchange as a whole, so a reader needs no lock. What goes wrong is kept until
`forget_trouble`: the first trouble is the one that is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
import struct
import threading
import time
from typing import Any

from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.connection import bus_errors, connect, Watcher
from dz_ros.drivers.cia402.scaling import Scaling, Unwrap
from dz_ros.drivers.cia402.sdo import Sdo
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.drivers.cia402.setup import configure
from dz_ros.drivers.cia402.states import DriveState, state_of
from dz_ros.errors import DriverError

START, STOP, PRE_OPERATIONAL, RESET = 0x01, 0x02, 0x80, 0x81
"""NMT commands."""
OPERATIONAL = 5
NMT_STATES = {0: 'boot-up', 4: 'stopped', 5: 'operational', 127: 'pre-operational'}
NMT, SYNC, EMCY, HEARTBEAT = 0, 0x80, 0x80, 0x700
BUS_OFF = 0x40
"""Bit of the identifier of an error frame, as Linux numbers them."""
_AWAKE = 0.03
"""Whoever looks at the heartbeat less often than this was asleep [s]."""


@dataclass(frozen=True)
class Measurement:
    """What the drive said in answer to one SYNC.

    Attributes:
        x: Position [unit of x].
        speed: Velocity [unit of x/s]; nan where the drive does not send it.
        synced_at: When the SYNC went out that it answers, by the steady clock [s].
        at: When it was complete [s].
        torque: Torque over the rated one; nan where the drive does not send it.
    """

    x: float
    speed: float
    synced_at: float
    at: float
    torque: float = math.nan


class DriveBus:
    """One drive and the bus it is on.

    Args:
        parameters: Where it is and what its numbers mean.
        period: Loop period [s].

    Attributes:
        measurement: The newest; None before the first.
        statusword: The newest; −1 before the first.
        said_at: When it came [s].
        synced_at: When the last SYNC went out [s].
        restarted: Whether it has booted since it was configured.
    """

    def __init__(self, parameters: Cia402Parameters, period: float) -> None:
        self.parameters = p = parameters
        self.measurement: Measurement | None = None
        self.statusword = -1
        self.said_at = self.synced_at = -math.inf
        self.restarted = False
        self.place = f'{p.interface} {p.channel}, node {p.node_id}'
        self.command, self._first, self._second = objects.layout(
            p.mode, p.act_at == 'sync', p.velocity_measured)
        self.scaling = Scaling.of(p)
        self._period = period
        self._unwrap = Unwrap()
        self._position: int | None = None
        self._nmt = 0
        self._beat = self._watched_at = math.inf
        self._trouble = ''
        self._lost = False
        self._news = threading.Condition()
        self._network: Any = None
        self._sdo: Sdo | None = None
        self._error: tuple[type[Exception], ...] = (OSError,)

    # The bus.

    def open(self) -> None:
        """Connect to the bus; nothing is said to the drive.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: There is no such bus.
        """
        p = self.parameters
        network = connect(p, Watcher(self._on_error_frame, self._on_bus_error))
        self._error = bus_errors()
        self._sdo = Sdo(network, p, self.place)
        network.subscribe(HEARTBEAT + p.node_id, self._on_heartbeat)
        network.subscribe(EMCY + p.node_id, self._on_emcy)
        network.subscribe(self._first.cob_id(p.node_id), self._on_first)
        if self._second is not None:
            network.subscribe(self._second.cob_id(p.node_id), self._on_second)
        self._network = network
        self._lost = False

    def close(self) -> None:
        """Leave the bus; the drive's own watchdogs stop it if nobody else has."""
        network, self._network = self._network, None
        if network is not None:
            try:
                network.disconnect()
            except self._error as error:
                self.complain(f'the bus could not be closed: {error}')

    def follow(self, earlier: DriveBus) -> None:
        """Know what was known at a connection that has gone: restarts, turns made."""
        self.restarted = earlier.restarted
        self._unwrap = earlier._unwrap

    @property
    def broken(self) -> bool:
        """Whether the bus is not there, or has gone."""
        return self._network is None or self._lost

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame; where the bus is gone that is a trouble, not an error."""
        network = self._network
        if network is None:
            return
        try:
            network.send_message(identifier, data)
        except self._error as error:
            self._on_bus_error(error)

    # Talking with the drive; waits for it.

    @property
    def sdo(self) -> Sdo:
        """The drive's objects.

        Raises:
            DriverError: The bus was never opened, or has been left.
        """
        if self._sdo is None or self._network is None:
            raise DriverError(f'{self.place}: not connected')
        return self._sdo

    def configure(self) -> None:
        """Bring the drive from wherever it is to NMT operational, with our PDOs and limits.

        Raises:
            DriverError: It does not answer, is no servo drive, has another motor, cannot do the
                mode, or refuses a setting.
        """
        self.nmt(PRE_OPERATIONAL)
        self.sdo.missing.clear()
        configure(self.sdo, self.parameters, self.place, self._period,
                  (self.command, self._first, self._second))
        if self.restarted:
            self._unwrap.forget()
        self.measurement = None
        self.statusword = -1
        self._nmt = 0       # until it says that it is operational
        self._beat = self._watched_at = time.monotonic()
        self.restarted = False
        self.nmt(START)

    @property
    def lacks(self) -> str:
        """What the drive does not have of what can be done without, in words."""
        return '' if self._sdo is None else ', '.join(self._sdo.missing)

    def look_for_restart(self) -> None:
        """Ask the drive whether it still has what it was told; it may have booted unheard.

        Raises:
            DriverError: It does not answer.
        """
        told = round(1000.0 * self.parameters.heartbeat)
        if self.sdo.read(objects.PRODUCER_HEARTBEAT) != told:
            self.restarted = True

    def nmt(self, command: int) -> None:
        """Send an NMT command to the drive."""
        self.send(NMT, bytes((command, self.parameters.node_id)))

    # What is known.

    @property
    def state(self) -> DriveState | None:
        """State the drive was last in; None = not known."""
        return None if self.statusword < 0 else state_of(self.statusword)

    def wait_for_status(self, ready: Callable[[], bool], limit: float) -> bool:
        """Wait until the drive has said what makes `ready` true; return whether it has."""
        with self._news:
            return self._news.wait_for(ready, limit)

    def watch(self, now: float) -> None:
        """Look, often, whether the heartbeat has stayed away at `now` [s].

        Time in which nobody looked is not counted: this process slept, and so did its receiver.
        """
        slept = now - self._watched_at
        self._watched_at = now
        if slept > _AWAKE and self._beat < now:
            self._beat = min(self._beat + slept, now)
        if now - self._beat > self.parameters.heartbeat_hold:
            self.complain(f'no heartbeat for {self.parameters.heartbeat_hold:g} s')

    @property
    def trouble(self) -> str:
        """The first thing that went wrong, or ''."""
        return self._trouble

    def complain(self, text: str) -> None:
        """Keep a trouble; the first one counts."""
        with self._news:
            self._trouble = self._trouble or text
            self._news.notify_all()

    def forget_trouble(self) -> None:
        """Begin anew."""
        self._trouble = ''

    # What canopen's thread brings.

    def _on_first(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if len(data) < 6:
            return
        word, counts = struct.unpack_from(self._first.form, data)
        self._nmt = OPERATIONAL     # in every other state it sends no PDOs
        with self._news:
            self.statusword, self.said_at = word, time.monotonic()
            self._news.notify_all()
        self._position = self._unwrap(counts)
        if self._second is None:
            self.measurement = Measurement(self.scaling.x(self._position), math.nan,
                                           self.synced_at, time.monotonic())

    def _on_second(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        position, self._position = self._position, None
        if self._second is None or position is None or len(data) < 6:
            return
        speed, torque = struct.unpack_from(self._second.form, data)
        self.measurement = Measurement(self.scaling.x(position), self.scaling.speed(speed),
                                       self.synced_at, time.monotonic(), torque / 1000.0)

    def _on_heartbeat(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if not data:
            return
        state = data[0] & 0x7F
        if state == 0:
            self.restarted = True
            self.complain('the drive has restarted')
        elif state == OPERATIONAL:
            self._nmt = OPERATIONAL
        elif self._nmt == OPERATIONAL:
            name = NMT_STATES.get(state, str(state))
            self.complain(f'the drive has left NMT state operational: {name}')
        self._beat = time.monotonic()

    def _on_emcy(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if len(data) < 3:
            return      # a SYNC, where the node id is 0, or nonsense
        code, register = struct.unpack_from('<HB', data)
        if code & 0xFF00:
            from canopen.emcy import EmcyError

            meaning = EmcyError(code, register, b'', 0.0).get_desc()
            self.complain(f'EMCY {code:04X}h ({meaning or "unknown"}), error register '
                          f'{register:02X}h')

    def _on_error_frame(self, identifier: int) -> None:
        if identifier & BUS_OFF:
            self._lost = True
            self.complain('bus off: too many errors on the CAN bus')

    def _on_bus_error(self, error: BaseException) -> None:
        if self._network is not None:
            self._lost = True
            self.complain(f'the bus has gone: {" ".join(str(error).split())}')
