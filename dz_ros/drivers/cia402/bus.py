# SPDX-License-Identifier: Apache-2.0
"""One drive on its bus: SDO, NMT and what the drive sends, kept for its readers (ours).

The connection is that of all drives of the bus, ``shared_bus.py``. canopen's receiving thread
calls the ``_on_…`` methods; the newest measurement is one immutable value that they exchange as a
whole, so a reader needs no lock. What goes wrong is kept until `forget_fault`: the first fault is
the one reported.

Over 300 lines: what one thread receives and the others read, in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
import struct
import threading
import time
from typing import Any, TYPE_CHECKING

from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.measurement import (
    Answers,
    Measurement,
    Position,
    REPEATED,
    Repeats,
)
from dz_ros.drivers.cia402.scaling import Scaling
from dz_ros.drivers.cia402.sdo import Sdo
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.drivers.cia402.setup import configure
from dz_ros.drivers.cia402.states import DriveState, Promises, state_of
from dz_ros.errors import DriverError

if TYPE_CHECKING:
    from dz_ros.drivers.cia402.shared_bus import SharedBus

START, STOP, PRE_OPERATIONAL, RESET, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
"""NMT commands."""
BOOTED, STOPPED, OPERATIONAL, PREPARED = 0, 4, 5, 127
"""NMT states, as in heartbeats."""
NMT_STATES = {BOOTED: 'boot-up', STOPPED: 'stopped', OPERATIONAL: 'operational',
              PREPARED: 'pre-operational'}
_LEADS_TO = {STOP: STOPPED, PRE_OPERATIONAL: PREPARED, RESET: BOOTED, RESET_COMMUNICATION: BOOTED}
NMT, SYNC, EMCY, HEARTBEAT = 0, 0x80, 0x80, 0x700
_AWAKE = 0.03
"""A process that checks the heartbeat less often than this was asleep [s]."""
SWING = 0.05
"""Change of the target, of the largest one, that shows in the torque of a drive."""
MISSED = (0x8100, 0x8110, 0x8130, 0x8200, 0x8250)
"""Error codes of a drive that has missed messages (CiA 301): communication, overrun, heartbeat,
protocol, RPDO timeout."""
_REGISTER = 0x11
"""Bits of the error register that go with them: generic, communication."""
_MALFORMED = 10
"""PDOs of another length in a row that are another mapping, not noise."""


class DriveBus:
    """One drive on its bus.

    Args:
        parameters: Where it is and what its numbers mean.
        period: Loop period [s].
        shared: The bus.

    Attributes:
        measurement: The newest; None before the first.
        statusword: The newest; −1 before the first.
        received_at: When it came [s].
        synced_at: When the last SYNC went out [s].
        restarted: Whether it has booted since it was configured.
        nmt_state: NMT state it is known to be in; None = not known.
        left_at: When it was first known to have left NMT state operational [s].
        mode: Mode of operation it reports; None = not known.
        polls_mode: Whether the mode is in no PDO and must be asked for.
        remarks: Permitted differences from its settings.
        position: Its counter.
        target: Target it was last sent.
        network: canopen's for this drive alone, while open.
    """

    def __init__(self, parameters: Cia402Parameters, period: float, shared: SharedBus) -> None:
        self.parameters = p = parameters
        self.restarted = False
        self.place = f'{p.interface} {p.channel}, node {p.node_id}'
        self.scaling = Scaling.of(p)
        self._period = period
        self._shared = shared
        self.position = Position(float(p.counts_per_rev))
        self._swing = SWING * self.scaling.largest
        self._fault = ''
        self._lasting = False
        self._codes: set[int] = set()
        self._news = threading.Condition()
        self.network: Any = None
        self._sdo: Sdo | None = None
        self.forget()

    def forget(self) -> None:
        """Know nothing of the drive but what holds over connections: restarts, turns, a fault."""
        p = self.parameters
        self.measurement: Measurement | None = None
        self.statusword = -1
        self.received_at = self.synced_at = self.left_at = -math.inf
        self.nmt_state: int | None = None
        self.mode: int | None = None
        self.polls_mode = False
        self.target = 0
        self.remarks: tuple[str, ...] = ()
        self.command, self._first, self._second = objects.layout(
            p.mode, p.act_at == 'sync', p.velocity_measured)
        self._answers = Answers(1 if self._second is None else 2)
        self._promises = Promises()
        self._repeats = Repeats(self._swing)
        self._started = False
        self._malformed = [0, 0]
        self._heartbeat_at = self._watched_at = math.inf

    # The bus.

    def open(self) -> None:
        """Connect to the bus; nothing is sent to the drive.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: There is no such bus.
        """
        self._shared.join(self)

    def attach(self, network: Any) -> None:
        """Receive from a canopen network what the drive sends."""
        p = self.parameters
        self._sdo = Sdo(network, p, self.place)
        network.subscribe(HEARTBEAT + p.node_id, self._on_heartbeat)
        network.subscribe(NMT, self._on_nmt)
        network.subscribe(EMCY + p.node_id, self._on_emcy)
        network.subscribe(self._first.cob_id(p.node_id), self._on_first)
        if self._second is not None:
            network.subscribe(self._second.cob_id(p.node_id), self._on_second)
        self.network = network

    def close(self) -> None:
        """Leave the bus; the drive's own watchdogs stop it if it still runs."""
        self.complain_if(self._shared.leave(self))

    @property
    def broken(self) -> bool:
        """Whether the bus is not there, or has gone."""
        return self.network is None or self._shared.lost

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame; where the bus is gone that is a fault, not an error."""
        self._shared.send(identifier, data)

    # Talking with the drive; waits for it.

    @property
    def sdo(self) -> Sdo:
        """The drive's objects.

        Raises:
            DriverError: The bus was never opened, or has been left.
        """
        if self._sdo is None or self.network is None:
            raise DriverError(f'{self.place}: not connected')
        return self._sdo

    def configure(self) -> None:
        """Bring the drive from wherever it is to NMT operational, with our PDOs and limits.

        Raises:
            DriverError: It does not answer, is no servo drive, has another motor, cannot do the
                mode, refuses a setting, would not stop by itself.
        """
        self._started = False
        self.nmt(PRE_OPERATIONAL)
        self.sdo.missing.clear()
        p = self.parameters
        found = configure(self.sdo, p, self.place, self._period, objects.layout(
            p.mode, p.act_at == 'sync', p.velocity_measured))
        self._first, self._second = found.first, found.second
        self.polls_mode = found.polls_mode
        self.remarks = found.remarks
        if self.restarted or self.position.lost or self.position.modulus != found.modulus:
            self.position = Position(float(p.counts_per_rev), found.modulus)
        self._answers = Answers(1 if self._second is None else 2)
        self._promises = Promises()
        self._repeats = Repeats(self._swing)
        self.measurement = None
        self.statusword = -1
        self.mode = found.mode
        self.nmt_state = None       # until it reports operational
        self._malformed = [0, 0]
        self._heartbeat_at = self._watched_at = time.monotonic()
        self.restarted = False
        self.nmt(START)
        self._started = True

    @property
    def lacks(self) -> str:
        """What the drive does not have of what can be done without, as text."""
        return '' if self._sdo is None else ', '.join(self._sdo.missing)

    def leave(self) -> None:
        """Stop the drive's communication, if it has no torque left to take away."""
        self._started = False
        if self.state not in (DriveState.ENABLED, DriveState.QUICK_STOP):
            self.nmt(PRE_OPERATIONAL)

    def synced(self, at: float) -> None:
        """Note that a SYNC goes out at `at` [s]."""
        self.synced_at = at
        self._answers.sync(at)
        if self._answers.repeated >= REPEATED:
            self.complain('more than one answer to each SYNC: does another node have the id '
                          f'{self.parameters.node_id}?')

    def look_for_restart(self) -> None:
        """Read whether the drive still has its settings; its boot-up message may have been lost.

        Raises:
            DriverError: It does not answer.
        """
        if self.nmt_state == STOPPED:
            self.nmt(PRE_OPERATIONAL)       # it takes no SDO before
        period = round(1000.0 * self.parameters.heartbeat)
        if self.sdo.read(objects.PRODUCER_HEARTBEAT) != period:
            self.restarted = True

    def nmt(self, command: int) -> None:
        """Send an NMT command to the drive."""
        self.send(NMT, bytes((command, self.parameters.node_id)))

    # What is known.

    @property
    def state(self) -> DriveState | None:
        """State the drive was last in; None = not known."""
        return None if self.statusword < 0 else state_of(self.statusword)

    @property
    def outside(self) -> bool:
        """Whether it was operational and is known to be so no more: it takes no PDOs."""
        return self._started and self.nmt_state not in (None, OPERATIONAL)

    @property
    def deaf(self) -> str:
        """Why it cannot take a command, as far as is known; '' if it can."""
        if self.broken:
            return 'there is no connection to the bus'
        silent = time.monotonic() - self._heartbeat_at
        if silent > self.parameters.heartbeat_hold:
            return f'the drive is silent for {silent:.1f} s'
        if self.outside:
            return f'the drive is in NMT state {NMT_STATES.get(self.nmt_state or 0, "unknown")}'
        return ''

    def take_status(self, word: int) -> None:
        """Take a statusword, however it came."""
        with self._news:
            self.statusword, self.received_at = word, time.monotonic()
            self._news.notify_all()

    def take_mode(self, mode: int) -> None:
        """Take a mode of operation; another than was asked for is a fault."""
        self.mode = mode
        wanted = objects.MODES[self.parameters.mode]
        if mode != wanted and self._started:
            self.complain(f'the drive is in another mode: {objects.MODE_DISPLAY} = {mode}, not '
                          f'{wanted}')

    def wait_for_status(self, ready: Callable[[], bool], limit: float) -> bool:
        """Wait until a statusword makes `ready` true; return whether one has."""
        with self._news:
            return self._news.wait_for(ready, limit)

    def watch(self, now: float) -> None:
        """Look, often, whether the heartbeat has stayed away at `now` [s].

        Time without a check is not counted: this process slept, and so did its receiver.
        """
        slept = now - self._watched_at
        self._watched_at = now
        if slept > _AWAKE and self._heartbeat_at < now:
            self._heartbeat_at = min(self._heartbeat_at + slept, now)
        if now - self._heartbeat_at > self.parameters.heartbeat_hold:
            self.complain(f'no heartbeat for {self.parameters.heartbeat_hold:g} s', False)

    @property
    def fault(self) -> str:
        """The first thing that went wrong, or ''."""
        return self._fault

    def complain(self, text: str, lasting: bool = True) -> None:
        """Keep a fault; the first one counts.

        Args:
            text: What is wrong.
            lasting: Whether it cannot be what a stall of this machine causes.
        """
        with self._news:
            self._fault = self._fault or text
            self._lasting = self._lasting or lasting
            self._news.notify_all()

    def complain_if(self, text: str) -> None:
        """Keep a fault, if it is one."""
        if text:
            self.complain(text)

    def forget_fault(self) -> None:
        """Start again."""
        self._fault, self._lasting = '', False
        self._codes.clear()

    def lost_us(self) -> bool:
        """Return whether all that is wrong is that the drive has missed our messages.

        It reports that itself, by EMCY or 603Fh (`MISSED`), or nothing is wrong with it.

        Raises:
            DriverError: It does not answer.
        """
        if self._lasting or self.restarted or self.broken:
            return False
        self.take_status(self.sdo.read(objects.STATUSWORD))
        codes, tripped = set(self._codes), self.state in (DriveState.FAULT, DriveState.REACTING)
        if tripped:     # else it is an old one
            codes |= {self.sdo.read_optional(objects.ERROR_CODE) or 0} - {0}
        if not codes:
            return not (tripped or self._fault)
        return codes.issubset(MISSED)

    # What canopen's thread brings.

    def _on_first(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        self._take(0, self._first, data)

    def _on_second(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if self._second is not None:
            self._take(1, self._second, data)

    def _take(self, stream: int, pdo: objects.Pdo, data: bytearray) -> None:
        if not self._started:
            return      # of the settings before
        if len(data) != struct.calcsize(pdo.form):
            self._malformed[stream] += 1
            if self._malformed[stream] >= _MALFORMED:
                self.complain(f'{pdo.name} has {len(data)} bytes, not '
                              f'{struct.calcsize(pdo.form)}: its mapping was changed')
            return
        self._malformed[stream] = 0
        values = struct.unpack(pdo.form, data)
        self.nmt_state = OPERATIONAL        # in every other state it sends no PDOs
        if stream == 0:
            self.take_status(values[0])
            self.complain_if(self._promises.look(values[0]))
            if len(values) > 2:
                self.take_mode(values[2])
        whole = self._answers.take(stream, values)
        if whole is not None:
            self._measure(*whole)

    def _measure(self, synced_at: float, answers: Sequence[tuple[int, ...]]) -> None:
        """Make a measurement of the answers to one SYNC."""
        number, torque = map(float, answers[1] if len(answers) > 1 else (math.nan, math.nan))
        speed = number * self.scaling.counts_per_number
        counts, wrong = self.position.follow(answers[0][1], speed, synced_at)
        wrong = wrong or self._repeats.look(answers, speed, synced_at, self.target)
        if counts is None or wrong:
            self.complain_if(wrong)
            return
        self.measurement = Measurement(
            self.scaling.x(counts), self.scaling.speed(number), synced_at, time.monotonic(),
            torque / 1000.0)

    def _on_nmt(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        """Take another master's NMT command; our own, where the bus brings them, are before it."""
        if (self._started and len(data) >= 2 and data[1] in (0, self.parameters.node_id)
                and data[0] in _LEADS_TO):
            self._left(_LEADS_TO[data[0]], ', commanded by another master')

    def _on_heartbeat(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if not data:
            return
        state = data[0] & 0x7F
        self._heartbeat_at = time.monotonic()
        if state == BOOTED:
            self.restarted = True
            self.complain('the drive has restarted')
            self.nmt_state = state
        elif state == OPERATIONAL or (self._started and self.nmt_state is not None):
            self._left(state)

    def _left(self, state: int, why: str = '') -> None:
        """Take the NMT state it is in."""
        if state != OPERATIONAL and self.nmt_state in (None, OPERATIONAL):
            self.left_at = time.monotonic()
        self.nmt_state = state
        if state != OPERATIONAL:
            name = NMT_STATES.get(state, str(state))
            self.complain(f'the drive has left NMT state operational: {name}{why}; it takes no '
                          'commands, the safe one included', bool(why))

    def _on_emcy(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if len(data) < 3:
            return      # a SYNC, where the node id is 0, or nonsense
        code, register = struct.unpack_from('<HB', data)
        if code & 0xFF00:
            self._codes.add(code)
            from canopen.emcy import EmcyError

            meaning = EmcyError(code, register, b'', 0.0).get_desc()
            self.complain(f'EMCY {code:04X}h ({meaning or "unknown"}), error register '
                          f'{register:02X}h', code not in MISSED or bool(register & ~_REGISTER))
