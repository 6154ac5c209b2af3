"""The simulated drive as a CANopen node: who hears what, and what it answers (CiA 301, 402).

Everything comes in on canopen's receiving thread, but for `tick`; one lock keeps them apart.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
import threading
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.cia402 import objects
from dz_ros.drivers.cia402.bus import HEARTBEAT, NMT, RESET, START, SYNC
from dz_ros.drivers.cia402.connection import connect
from dz_ros.drivers.cia402.device import Device
from dz_ros.drivers.cia402.motor import Motor
from dz_ros.drivers.cia402.states import DriveState

LOST_HEARTBEAT, LOST_COMMANDS = 0x8130, 0x8250
"""Error codes of CiA 301: heartbeat, RPDO timeout."""
_REGISTER = 0x01
_DEMANDS = (objects.TORQUE.index, objects.TORQUE_DEMAND.index, objects.VELOCITY_DEMAND.index)
_BRAKED = (DriveState.QUICK_STOP, DriveState.REACTING)


class DriveNode:
    """A drive on a bus.

    Args:
        configuration: Bus and scaling in its section driver, and the plant.
        brake: Time constant of a quick stop [s].
        rated_torque: What 6076h says [N m]; 0 = what the driver expects.
        quick_stop_exit: Whether transition 16 is supported.
        ask: Called with number, value and duration [s] of a fault a master asks for.

    Attributes:
        device: State machine.
        moved: Whether a command other than 0 has acted.
        sends_pdos: False while it shall send none.
        say: Called with what happens.
    """

    def __init__(self, configuration: Configuration, brake: float, rated_torque: float,
                 quick_stop_exit: bool, ask: Callable[[int, int, float], None]) -> None:
        self.device = Device()
        self.moved = False
        self.sends_pdos = True
        self.say: Callable[[str], None] = lambda _text: None
        self._parameters = p = configuration.driver_parameters
        self._rated = round(1000.0 * (rated_torque or p.rated_torque))
        # What follows the target object of the mode; the other mode's values stay 0.
        self._demands = _DEMANDS[:2] if p.mode == 'torque' else _DEMANDS[2:]
        self._exit = quick_stop_exit
        self._ask = ask
        self._motor = Motor(configuration, brake)
        self._lock = threading.RLock()
        self._off = True
        self._started = time.monotonic()
        self._synced = self._commanded = self._beaten = 0.0
        self._watched_beat = self._watched_command = 0.0
        self._answers: list[float] = []
        self._answered = True
        self._network: Any = None
        self._node: Any = None

    # Its life.

    def open(self) -> None:
        """Connect to the bus and boot."""
        self._network = network = connect(self._parameters)
        send, notify = network.send_message, network.notify
        # A node that is off the bus is a network that does neither.
        network.send_message = lambda *a, **k: None if self._off else send(*a, **k)
        network.notify = lambda *a: None if self._off else notify(*a)
        network.subscribe(SYNC, self._on_sync)
        network.subscribe(HEARTBEAT + self._parameters.master_id, self._on_heartbeat)
        self.boot()

    def close(self) -> None:
        """Leave the bus."""
        with self._lock:
            self._off = True
            if self._node is not None:
                self._node.nmt.stop_heartbeat()
        if self._network is not None:
            self._network.disconnect()

    def boot(self) -> None:
        """Boot: settings at their defaults, boot-up message, NMT pre-operational."""
        from canopen import LocalNode

        with self._lock:
            p = self._parameters
            node = LocalNode(p.node_id, objects.dictionary(objects.EMULATED))
            for communication, _, cob_id in (objects.RECEIVE, objects.TRANSMIT):
                for number in range(4):
                    node.set_data(communication + number, 1, struct.pack(
                        '<I', objects.NOT_VALID | cob_id + 0x100 * number + p.node_id))
            node.add_read_callback(self._on_read)
            node.add_write_callback(self._on_write)
            self._off = False
            self._watched_beat = self._watched_command = 0.0
            self._node = self._network[p.node_id] = node
            self._network.subscribe(NMT, self._on_nmt)
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
            self._beat_time = self._node.nmt._heartbeat_time_ms
            self._node.nmt.stop_heartbeat()
            self._off = True

    def join(self) -> None:
        """Come back to the bus."""
        with self._lock:
            self._off = False
            self._node.nmt.start_heartbeat(self._beat_time)

    def stop_heartbeat(self) -> Callable[[], None]:
        """Send no more heartbeats; return what starts them again."""
        period = self._node.nmt._heartbeat_time_ms
        self._node.nmt.stop_heartbeat()
        return lambda: self._node.nmt.start_heartbeat(period)

    def fault(self, code: int) -> None:
        """Have a fault: EMCY, quick stop, fault."""
        with self._lock:
            self.device.fault(code)
            self._node.emcy.send(code, _REGISTER)
            self._move()
        self.say(f'EMCY {code:04X}h')

    def drop(self) -> None:
        """Lose the voltage."""
        with self._lock:
            self.device.drop()
            self._move()

    def tick(self) -> None:
        """Move on, look at the watchdogs."""
        with self._lock:
            self._move()
            now = time.monotonic()
            if self.device.state is DriveState.NOT_READY or self._node.nmt.state != 'OPERATIONAL':
                return
            late = 0
            if self._watched_beat and self._beaten and now - self._beaten > self._watched_beat:
                late = LOST_HEARTBEAT
            if (self._watched_command and self._commanded
                    and now - self._commanded > self._watched_command):
                late = LOST_COMMANDS
            if late:
                self._beaten = self._commanded = 0.0    # armed anew by the next one
                if self.device.state in (DriveState.ENABLED, DriveState.QUICK_STOP):
                    self.fault(late)

    def summary(self) -> list[str]:
        """Return what it has seen, in words."""
        times = sorted(self._answers)
        if not times:
            return ['no commands']
        p50, p99 = (times[int(share * (len(times) - 1))] * 1e3 for share in (0.5, 0.99))
        return [f'{len(times)} commands, after the SYNC before them: p50 {p50:.3f} ms, p99 '
                f'{p99:.3f} ms, max {times[-1] * 1e3:.3f} ms']

    # What comes in.

    def _move(self) -> None:
        """Let the motor move until now."""
        state = self.device.state
        self._motor.move(time.monotonic() - self._started, state is DriveState.ENABLED,
                         state in _BRAKED)
        self.device.standing = self._motor.standing
        self.device.settle()
        if state is DriveState.ENABLED and self._motor.target:
            self.moved = True

    def _on_sync(self, *_message: Any) -> None:
        with self._lock:
            self._synced, self._answered = time.monotonic(), False
            self._move()
            if self._node.nmt.state != 'OPERATIONAL' or not self.sends_pdos:
                return
            for pdo in self._node.tpdo.values():
                if pdo.enabled and pdo.map and 1 <= pdo.trans_type <= 240:
                    for item in pdo.map:
                        item.raw = self._value(item.index)
                    pdo.transmit()

    def _on_rpdo(self, pdo: Any) -> None:
        with self._lock:
            if self._node.nmt.state != 'OPERATIONAL' or not pdo.enabled:
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
        self._beaten = time.monotonic()

    def _on_nmt(self, _identifier: int, data: bytearray, _stamp: float) -> None:
        if len(data) < 2 or data[1] not in (0, self._parameters.node_id):
            return
        with self._lock:
            self._beaten = self._commanded = 0.0
            if data[0] == START:
                for pdo in (*self._node.rpdo.values(), *self._node.tpdo.values()):
                    pdo.read()
                timer = int(self._node.sdo[objects.RECEIVE[0]][5].raw)
                self._watched_command = timer / 1000.0
            elif data[0] in (RESET, RESET + 1):
                self.boot()

    def _on_write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        """Take what a master writes; canopen keeps it besides."""
        value = int(od.decode_raw(bytes(data)))
        with self._lock:
            if index == objects.CONSUMER_HEARTBEAT.index and subindex == 1:
                self._watched_beat = (value & 0xFFFF) / 1000.0
            elif index == objects.FAULT.index:
                data_value, duration = (int(self._node.sdo[item.index].raw)
                                        for item in (objects.FAULT_VALUE, objects.FAULT_TIME))
                self._ask(value, data_value, duration / 1000.0)
            else:
                self._take(index, value)

    def _take(self, index: int, value: int) -> None:
        """Take the value of an object that does something."""
        if index == objects.CONTROLWORD.index:
            before = self.device.state
            self.device.control(value)
            if before is DriveState.FAULT and self.device.state is not before:
                self._node.emcy.reset()
        elif index in (objects.TARGET_TORQUE.index, objects.TARGET_VELOCITY.index):
            self.device.limited = self._motor.limit(value)
        elif index == objects.QUICK_STOP_CODE.index:
            self.device.quick_stop_code = value if self._exit or value < 5 else 4

    def _on_read(self, index: int, subindex: int, od: Any) -> int | None:  # noqa: ARG002
        return self._value(index)

    def _value(self, index: int) -> int | None:
        """Return the value of an object that lives; None = it is just kept."""
        if index == objects.STATUSWORD.index:
            return self.device.statusword
        if index == objects.POSITION.index:
            return self._motor.position
        if index == objects.VELOCITY.index:
            return self._motor.velocity
        if index in _DEMANDS:
            follows = index in self._demands and self.device.state is DriveState.ENABLED
            return self._motor.target if follows else 0
        if index == objects.ERROR_CODE.index:
            return self.device.error_code
        if index == objects.ERROR_REGISTER.index:
            return _REGISTER if self.device.error_code else 0
        if index == objects.RATED_TORQUE.index:
            return self._rated
        if index == objects.MODE_DISPLAY.index:
            return int(self._node.sdo[objects.MODE.index].raw)
        return None
