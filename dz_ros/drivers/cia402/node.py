# SPDX-License-Identifier: Apache-2.0
"""The simulated drive as a CANopen node: what it receives and answers (CiA 301, 402).

Everything comes in on canopen's receiving thread, but for `tick`; one lock keeps them apart.

Over 300 lines: NMT, PDOs, SDO, heartbeats and faults act on one state under that lock.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
import threading
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.bus import HEARTBEAT, NMT, RESET, START, STOP, SYNC
from dz_ros.drivers.cia402.connection import connect, share
from dz_ros.drivers.cia402.device import Device
from dz_ros.drivers.cia402.motor import Motor
from dz_ros.drivers.cia402.sdo import REQUEST
from dz_ros.drivers.cia402.states import DriveState

LOST_HEARTBEAT, LOST_COMMANDS, LEFT_OPERATIONAL = 0x8130, 0x8250, 0x8180
"""Error codes: heartbeat, RPDO timeout (CiA 301); NMT left operational (ours)."""
_REGISTER = 0x01
_DEMANDS = (objects.TORQUE.index, objects.TORQUE_DEMAND.index, objects.VELOCITY_DEMAND.index)
_MODES = (8, 9, 10)
"""Modes of operation it can do, as in 6502h."""
_BRAKED = (DriveState.QUICK_STOP, DriveState.REACTING)


class DriveNode:
    """A drive on a bus.

    Args:
        configuration: Bus and scaling in its section driver, and the plant.
        brake: Time constant of a quick stop [s].
        rated_torque: Value of 6076h [N m]; 0 = what the driver expects.
        quick_stop_exit: Whether transition 16 is supported.
        modulus: Number of values of its position, from 0 on; 0 = 32 bits with sign.
        reports_modulus: Whether 607Bh reports it.
        ask: Called with number, value and duration [s] of a fault a master asks for.

    Attributes:
        device: State machine.
        moved: Whether a command other than 0 has acted.
        sends_pdos: False while it shall send none.
        frozen: Whether it sends the same PDOs again and again.
        disordered: Whether the last PDO comes first.
        doubled: Whether it sends each PDO twice, as two nodes with one id do.
        shortened: Whether its first PDO has a byte too few.
        mode: Mode of operation it is in.
        motor: What it moves.
        canopen: The `LocalNode`, booted.
        network: The bus.
        off: Whether it neither receives nor sends.
        heartbeat_timeout: Longest interval of heartbeats [s]; 0 = not watched.
        watched_command: Longest interval of commands [s]; 0 = not watched.
        log: Called with what happens.
    """

    def __init__(self, configuration: Configuration, brake: float, rated_torque: float,
                 quick_stop_exit: bool, modulus: int, reports_modulus: bool,
                 ask: Callable[[int, int, float], None]) -> None:
        self.device = Device()
        self.moved = False
        self.sends_pdos = True
        self.frozen = self.disordered = self.doubled = self.shortened = False
        self.mode = 0
        self.log: Callable[[str], None] = lambda _text: None
        self._parameters = p = configuration.driver_parameters
        self._rated = round(1000.0 * (rated_torque or p.rated_torque))
        # What follows the target object of the mode; the other mode's values stay 0.
        self._demands = _DEMANDS[:2] if p.mode == 'torque' else _DEMANDS[2:]
        self._exit = quick_stop_exit
        self._ask = ask
        self._range = modulus if reports_modulus else 0
        self._wanted = objects.MODES[p.mode]
        self.motor = Motor(configuration, brake, modulus)
        self._lock = threading.RLock()
        self.off = True
        self._logged_state = DriveState.NOT_READY
        self._started = time.monotonic()
        self._synced = self._commanded = self._heartbeat_at = 0.0
        self.heartbeat_timeout = self.watched_command = 0.0
        self._answers: list[float] = []
        self._answered = True
        self.network: Any = None
        self._shares = False
        self.canopen: Any = None

    # Lifecycle.

    def open(self, shared: Any = None) -> None:
        """Connect to the bus, beside other drives of this process if they have it, and boot."""
        self._shares = shared is not None
        self.network = network = share(shared) if self._shares else connect(self._parameters)
        send, notify = network.send_message, network.notify
        # A node that is off the bus is a network that does neither.
        network.send_message = lambda *a, **k: None if self.off else send(*a, **k)
        network.notify = lambda *a: None if self.off or self._ignores(a[0]) else notify(*a)
        network.subscribe(SYNC, self._on_sync)
        network.subscribe(HEARTBEAT + self._parameters.master_id, self._on_heartbeat)
        self.boot()

    def close(self) -> None:
        """Leave the bus."""
        with self._lock:
            self.off = True
            if self.canopen is not None:
                self.canopen.nmt.stop_heartbeat()
        if self.network is not None and not self._shares:
            self.network.disconnect()

    def boot(self) -> None:
        """Boot: settings at their defaults, boot-up message, NMT pre-operational."""
        from canopen import LocalNode

        with self._lock:
            p = self._parameters
            node = LocalNode(p.node_id, objects.dictionary(objects.EMULATED))
            for communication, _, cob_id in (objects.RECEIVE, objects.TRANSMIT):
                for number in range(4):
                    node.set_data(communication + number, 1, struct.pack(
                        '<I', objects.NOT_VALID | self.request_bit(communication + number)
                        | cob_id + 0x100 * number + p.node_id))
            node.set_data(objects.RANGE_HIGHEST.index, 2,
                          struct.pack('<i', max(0, self._range - 1)))
            node.add_read_callback(self._on_read)
            node.add_write_callback(self._on_write)
            self.off = False
            self.heartbeat_timeout = self.watched_command = 0.0
            self.mode = 0
            if self.canopen is not None:    # its heartbeats do not end by themselves
                self.canopen.nmt.stop_heartbeat()
                self.network.unsubscribe(NMT, self._on_nmt)
            self.canopen = self.network[p.node_id] = node
            self.network.subscribe(NMT, self._on_nmt)      # after the node's own
            for number in (1, 2, 3, 4):
                node.rpdo[number].add_callback(self._on_rpdo)
            self.device.boot()
            node.nmt.state = 'INITIALISING'
            node.nmt.state = 'PRE-OPERATIONAL'

    def switch_off(self) -> None:
        """Be without supply: off the bus, without voltage, until `boot`."""
        with self._lock:
            self.leave()
            self.device.state = DriveState.NOT_READY

    def leave(self) -> None:
        """Leave the bus, as in bus off."""
        with self._lock:
            self._heartbeat_interval = self.canopen.nmt._heartbeat_time_ms
            self.canopen.nmt.stop_heartbeat()
            self.off = True

    def join(self) -> None:
        """Come back to the bus."""
        with self._lock:
            self.off = False
            self.canopen.nmt.start_heartbeat(self._heartbeat_interval)

    def stop_heartbeat(self) -> Callable[[], None]:
        """Send no more heartbeats; return what starts them again."""
        period = self.canopen.nmt._heartbeat_time_ms
        self.canopen.nmt.stop_heartbeat()
        return lambda: self.canopen.nmt.start_heartbeat(period)

    def fault(self, code: int) -> None:
        """Have a fault: EMCY, quick stop, fault."""
        with self._lock:
            self.device.fault(code)
            self.canopen.emcy.send(code, _REGISTER)
            self._move()
        self.log(f'EMCY {code:04X}h')

    def drop(self) -> None:
        """Lose the voltage."""
        with self._lock:
            self.device.drop()
            self._move()

    def leave_operational(self, state: str) -> None:
        """Go to an NMT state by itself."""
        with self._lock:
            self.canopen.nmt.state = state
            self._enter(state)

    def tick(self) -> None:
        """Move on, look at the watchdogs."""
        with self._lock:
            self._move()
            now = time.monotonic()
            if self.device.state is DriveState.NOT_READY:
                return
            late = 0
            if (self.heartbeat_timeout and self._heartbeat_at
                    and now - self._heartbeat_at > self.heartbeat_timeout):
                late, self._heartbeat_at = LOST_HEARTBEAT, 0.0        # armed again by the next one
            if (self.watched_command and self._commanded and self._operational
                    and now - self._commanded > self.watched_command):
                late, self._commanded = LOST_COMMANDS, 0.0
            if late:
                self._lose_connection(late)
                behaviour = int(self.canopen.sdo[objects.ERROR_BEHAVIOUR.index][1].raw)
                if behaviour != 1 and self._operational:
                    self.leave_operational('STOPPED' if behaviour == 2 else 'PRE-OPERATIONAL')

    def summary(self) -> list[str]:
        """Return what it has seen, as text."""
        times = sorted(self._answers)
        if not times:
            return ['no commands']
        p50, p99 = (times[int(share * (len(times) - 1))] * 1e3 for share in (0.5, 0.99))
        return [f'{len(times)} commands, after the SYNC before them: p50 {p50:.3f} ms, p99 '
                f'{p99:.3f} ms, max {times[-1] * 1e3:.3f} ms']

    # What comes in.

    @property
    def _operational(self) -> bool:
        return bool(self.canopen.nmt.state == 'OPERATIONAL')

    def _ignores(self, identifier: int) -> bool:
        """Whether it ignores a frame: in NMT state stopped there is no SDO."""
        stopped = self.canopen.nmt.state == 'STOPPED'
        return bool(stopped and identifier == REQUEST + self._parameters.node_id)

    def _lose_connection(self, code: int) -> None:
        """React to a lost connection as 6007h defines."""
        before = self.device.state
        if self.device.lose_connection(code) and before is not self.device.state:
            if self.canopen.nmt.state != 'STOPPED':
                self.canopen.emcy.send(code, _REGISTER)
            self.log(f'EMCY {code:04X}h')
        self._move()

    def _enter(self, state: str) -> None:
        """Enter an NMT state; the profile has the drive react to stopped alone (6007h)."""
        self._commanded = 0.0
        if state == 'STOPPED':
            self._lose_connection(LEFT_OPERATIONAL)

    def _move(self) -> None:
        """Let the motor move until now."""
        state = self.device.state
        coasts = state is DriveState.REACTING and not self.device.fault_reaction
        self.motor.move(time.monotonic() - self._started,
                        state is DriveState.ENABLED and self.mode == self._wanted,
                        state in _BRAKED and not coasts)
        self.device.standing = self.motor.standing
        self.device.settle()
        if self.device.state is not self._logged_state:
            self._logged_state = self.device.state
            self.log(f'state: {self._logged_state.value}')
        if state is DriveState.ENABLED and self.motor.target:
            self.moved = True

    def _on_sync(self, *_message: Any) -> None:
        with self._lock:
            self._synced, self._answered = time.monotonic(), False
            self._move()
            if not self._operational or not self.sends_pdos:
                return
            pdos = [pdo for pdo in self.canopen.tpdo.values()
                    if pdo.enabled and pdo.map and 1 <= pdo.trans_type <= 240]
            for pdo in reversed(pdos) if self.disordered else pdos:
                if not self.frozen:
                    for item in pdo.map:
                        item.raw = self.value(item.index)
                data = bytes(pdo.data)[:-1 if self.shortened and pdo is pdos[0] else None]
                for _ in range(2 if self.doubled else 1):
                    self.network.send_message(pdo.cob_id, data)

    def _on_rpdo(self, pdo: Any) -> None:
        with self._lock:
            if not self._operational or not pdo.enabled or 8 * len(pdo.data) != pdo.length:
                return
            self._commanded = time.monotonic()
            self._move()
            for item in pdo.map:
                self._take(item.index, item.raw)
            self._move()
            if not self._answered and self.device.state is DriveState.ENABLED:
                self._answered = True
                self._answers.append(self._commanded - self._synced)
                del self._answers[:-100_000]

    def _on_heartbeat(self, *_message: Any) -> None:
        self._heartbeat_at = time.monotonic()

    def _on_nmt(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if len(data) < 2 or data[1] not in (0, self._parameters.node_id):
            return
        with self._lock:
            if data[0] == START:
                self._heartbeat_at = self._commanded = 0.0
                for pdo in (*self.canopen.rpdo.values(), *self.canopen.tpdo.values()):
                    pdo.read()
                timer = int(self.canopen.sdo[objects.RECEIVE[0]][5].raw)
                self.watched_command = timer / 1000.0
            elif data[0] in (RESET, RESET + 1):
                self.boot()
            else:
                self._enter('STOPPED' if data[0] == STOP else 'PRE-OPERATIONAL')

    def _on_write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        """Take what a master writes; canopen keeps it besides."""
        value = int(od.decode_raw(bytes(data)))
        bit = self.request_bit(index) if subindex == 1 else 0
        if bit and not value & bit:
            from canopen.sdo import SdoAbortedError

            raise SdoAbortedError(0x06090030)
        with self._lock:
            if index == objects.CONSUMER_HEARTBEAT.index and subindex == 1:
                self.heartbeat_timeout = (value & 0xFFFF) / 1000.0
            elif index == objects.FAULT.index:
                data_value, duration = (int(self.canopen.sdo[item.index].raw)
                                        for item in (objects.FAULT_VALUE, objects.FAULT_TIME))
                self._ask(value, data_value, duration / 1000.0)
            else:
                self._take(index, value)

    @staticmethod
    def request_bit(index: int) -> int:
        """Return the bit that each COB-ID of a TPDO must have: it answers no remote requests."""
        first = objects.TRANSMIT[0]
        return objects.NO_RTR if first <= index < first + 4 else 0

    def _take(self, index: int, value: int) -> None:
        """Take the value of an object that does something."""
        if index == objects.CONTROLWORD.index:
            before = self.device.state
            self.device.control(value)
            if before is DriveState.FAULT and self.device.state is not before:
                self.canopen.emcy.reset()
        elif index in (objects.TARGET_TORQUE.index, objects.TARGET_VELOCITY.index):
            self.device.limited = self.motor.limit(value)
        elif index == objects.QUICK_STOP_CODE.index:
            self.device.quick_stop_code = value if self._exit or value < 5 else 4
        elif index == objects.FAULT_REACTION.index:
            self.device.fault_reaction = value
        elif index == objects.ABORT_CONNECTION.index:
            self.device.abort_connection = value
        elif index == objects.MODE.index and value in _MODES:
            self.mode = value

    def _on_read(self, index: int, subindex: int, od: Any) -> int | None:  # noqa: ARG002
        return self.value(index)

    def value(self, index: int) -> int | None:
        """Return the value of an object that lives; None = it is just kept."""
        if index == objects.STATUSWORD.index:
            return self.device.statusword
        if index == objects.POSITION.index:
            return self.motor.position
        if index == objects.VELOCITY.index:
            return self.motor.velocity
        if index in _DEMANDS:
            follows = index in self._demands and self.device.state is DriveState.ENABLED
            return self.motor.target if follows else 0
        if index == objects.ERROR_CODE.index:
            return self.device.error_code
        if index == objects.ERROR_REGISTER.index:
            return _REGISTER if self.device.error_code else 0
        if index == objects.RATED_TORQUE.index:
            return self._rated
        if index == objects.MODE_DISPLAY.index:
            return self.mode
        return None
