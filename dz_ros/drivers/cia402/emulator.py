# SPDX-License-Identifier: Apache-2.0
"""A simulated servo drive on a CAN bus, real CANopen and all, with a plant behind a dead-zone.

canopen's `LocalNode` is its SDO server, NMT slave and heartbeat; what a drive does with that is
here: PDOs as they were mapped, SYNC, the state machine, watchdogs of its own (consumer heartbeat,
event timer of the RPDO) and its reactions (6007h, 605Ah, 605Eh, 1029h), EMCY. It is a
process of its own on any bus python-can knows; on ``udp_multicast`` no hardware is needed.

Faults come from the script, or while it runs from any master by SDO: the number of a fault in
`FAULTS` into 2000h, after its value (e.g. the code of an EMCY) into 2001h and its duration in ms
into 2002h.

Several drives in one process (`EmulatedDrives`) share its connection to each bus.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
import threading
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.schema import parameter
from dz_ros.drivers.cia402.connection import connect
from dz_ros.drivers.cia402.node import DriveNode
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.drivers.emulators import Emulator, Fault
from dz_ros.errors import ConfigurationError

MOST_NODES = 126
"""Node ids of CANopen but the master's."""
OVERCURRENT = 0x2310
FAULTS = {
    'emcy': 'EMCY and fault; VALUE: error code, 8976 = 2310h unless given',
    'stuck': 'the same, and for S s no reset helps',
    'heartbeat': 'sends no heartbeat for S s',
    'restart': 'loses its settings and boots again; S s until it is there again',
    'bus-off': 'neither receives nor sends for S s',
    'torque-off': 'loses the voltage without a fault, as by its safe-torque-off input',
    'no-pdo': 'sends no PDO for S s',
    'pre-operational': 'leaves NMT state operational by itself',
    'stopped': 'goes to NMT state stopped by itself',
    'mode': 'is in another mode of operation; VALUE: which, 1 unless given',
    'local': 'is operated locally for S s: it obeys no controlword',
    'frozen': 'sends the same PDOs again and again for S s',
    'disorder': 'sends the last PDO first for S s',
    'twice': 'sends each PDO twice for S s, as two nodes with one id do',
    'short': 'sends its first PDO with a byte too few for S s',
}
"""What can go wrong; 2000h counts them from 1."""


@dataclass(frozen=True)
class EmulatedParameters:
    """What the simulated drive has besides the sections driver and plant."""

    brake: float = parameter(0.1, 's', 'time constant of its quick stop', minimum=0.001)
    rated_torque: float = parameter(0.0, 'N m', 'rated torque it reports; 0 = that of '
                                    'driver.rated_torque', minimum=0.0)
    quick_stop_exit: bool = parameter(True, '', 'goes from quick stop active back to operation '
                                      'enabled (transition 16, optional in the profile)')
    position_range: int = parameter(0, '1', 'its position counts from 0 to this - 1, as that of a '
                                    'modulo axis or a narrow counter; 0 = 32 bits', minimum=0,
                                    maximum=2 ** 31)
    reports_range: bool = parameter(True, '', 'it reports that (607Bh)')


class Cia402Emulator(Emulator):
    """A simulated CiA 402 drive.

    Attributes:
        node: The drive on the bus, while open.
        tick: How often it looks at its watchdogs [s].
        pending: Faults of the script that have not begun.
        ends: What ends a fault that has begun: when [s], what to call, its name.
    """

    name = 'cia402'
    summary = 'servo drive on CANopen: state machine, PDOs, SYNC, heartbeat, EMCY'
    faults = FAULTS
    Parameters = EmulatedParameters

    def __init__(self, parameters: Any, configuration: Configuration,
                 faults: Sequence[Fault] = ()) -> None:
        super().__init__(parameters, configuration, faults)
        if not isinstance(configuration.driver_parameters, Cia402Parameters):
            raise ConfigurationError('driver.name', configuration.driver_settings.name,
                                     'must be cia402: bus, node id and scaling are in its section')
        if configuration.plant.order > 2:
            raise ConfigurationError('plant.model', configuration.plant.name, 'has order '
                                     f'{configuration.plant.order}, a drive has position and '
                                     'velocity')
        self.tick = min(0.005, configuration.loop.period)
        self.node: DriveNode | None = None
        self._moved_at: float | None = None
        self.pending = list(self.script)
        self.ends: list[tuple[float, Callable[[], None], str]] = []
        self._asked: list[Fault] = []
        self._lock = threading.Lock()

    @classmethod
    def of_axes(cls, parameters: Any, machine: Configuration, nodes: int,
                faults: Sequence[Fault]) -> EmulatedDrives:
        """Return the drives of all axes, or `nodes` equal ones with the node ids from 1 on.

        Raises:
            ConfigurationError: Another number than that of the axes, or an id that cannot be.
        """
        if machine.axes and nodes not in (0, len(machine.axes)):
            raise ConfigurationError('--nodes', nodes, f'must be {len(machine.axes)}, that of '
                                     'loop.axes, or left out')
        if not 0 <= nodes <= MOST_NODES:
            raise ConfigurationError('--nodes', nodes, f'must be from 1 to {MOST_NODES}')
        each = dict(machine.axes) or {
            str(node): machine.replace(**{'driver.node_id': node,
                                          'loop.seed': machine.loop.seed + node - 1})
            for node in range(1, nodes + 1)}
        return EmulatedDrives(parameters, machine, each, faults)

    def open(self, shared: Any = None) -> str:
        """Be on the bus; return where.

        Args:
            shared: canopen's network of that bus, where this process has it; None = connect.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: There is no such bus.
        """
        self.node = node = DriveNode(self.configuration, self.parameters.brake,
                                     self.parameters.rated_torque,
                                     self.parameters.quick_stop_exit,
                                     self.parameters.position_range,
                                     self.parameters.reports_range, self.ask)
        node.open(shared)
        p = self.configuration.driver_parameters
        return (f'simulated drive, node {p.node_id} on {p.interface} {p.channel}: '
                f'{self.configuration.plant.name} behind a dead-zone')

    def run(self, stopping: Callable[[], bool], log: Callable[[str], None]) -> None:
        """Be the drive until `stopping` returns True."""
        while not stopping():
            time.sleep(self.tick)
            self.step(log)
        self.finish(log)

    def step(self, log: Callable[[str], None]) -> None:
        """Move on until now; log what happens."""
        assert self.node is not None
        self.node.log = log
        self.node.tick()
        self._look(self.node, time.monotonic(), log)

    def finish(self, log: Callable[[str], None]) -> None:
        """Log what it has seen."""
        for line in self.node.summary() if self.node is not None else ():
            log(line)

    def close(self) -> None:
        """Leave the bus."""
        node, self.node = self.node, None
        if node is not None:
            node.close()

    def ask(self, number: int, value: int, duration: float) -> None:
        """Take a fault that a master asks for by SDO."""
        names = list(FAULTS)
        if 1 <= number <= len(names):
            with self._lock:
                self._asked.append(Fault(names[number - 1], 0.0, duration,
                                         float(value) if value else math.nan))

    def _look(self, node: DriveNode, now: float, log: Callable[[str], None]) -> None:
        """Begin and end the faults that are due."""
        if self._moved_at is None and node.moved:
            self._moved_at = now
        with self._lock:
            due, self._asked = self._asked, []
        if self._moved_at is not None:
            due += [item for item in self.pending if now - self._moved_at >= item.start]
            self.pending = [item for item in self.pending if item not in due]
        for item in due:
            log(f'fault {item.name}')
            end = self._begin(node, item)
            if end is not None:
                self.ends.append((now + item.duration, end, item.name))
        for place in [entry for entry in self.ends if now >= entry[0]]:
            self.ends.remove(place)
            place[1]()
            log(f'end of fault {place[2]}')

    def _begin(self, node: DriveNode, item: Fault) -> Callable[[], None] | None:
        """Let something go wrong; return what ends it."""
        code = OVERCURRENT if math.isnan(item.value) else int(item.value)
        if item.name in ('emcy', 'stuck'):
            node.device.stuck = item.name == 'stuck'
            node.fault(code)
            return (lambda: setattr(node.device, 'stuck', False)) if node.device.stuck else None
        if item.name == 'heartbeat':
            return node.stop_heartbeat()
        if item.name == 'restart':
            node.switch_off()
            return node.boot
        if item.name == 'bus-off':
            node.leave()
            return node.join
        if item.name == 'torque-off':
            node.drop()
            return None
        if item.name in ('pre-operational', 'stopped'):
            node.leave_operational(item.name.upper())
            return None
        if item.name == 'mode':
            node.mode = 1 if math.isnan(item.value) else int(item.value)
            return None
        owner, attribute, wrong = {
            'no-pdo': (node, 'sends_pdos', False), 'local': (node.device, 'local', True),
            'frozen': (node, 'frozen', True), 'disorder': (node, 'disordered', True),
            'twice': (node, 'doubled', True), 'short': (node, 'shortened', True)}[item.name]
        setattr(owner, attribute, wrong)
        return lambda: setattr(owner, attribute, not wrong)


class EmulatedDrives(Emulator):
    """Simulated drives of several axes, each with its own motor.

    Args:
        parameters: Of each of them.
        configuration: Of the machine.
        each: Name → configuration of each drive.
        faults: The script; the device of a fault is a name or a node id.

    Attributes:
        drives: Name → drive.

    Raises:
        ConfigurationError: A fault of a drive that there is not, or a configuration of no drive.
    """

    name, summary, faults = Cia402Emulator.name, Cia402Emulator.summary, FAULTS
    Parameters = EmulatedParameters

    def __init__(self, parameters: Any, configuration: Configuration,
                 each: Mapping[str, Configuration], faults: Sequence[Fault] = ()) -> None:
        super().__init__(parameters, configuration, faults)
        self.drives: dict[str, Cia402Emulator] = {}
        for name, own in each.items():
            drive = Cia402Emulator(parameters, own)
            names = ('', name, str(own.driver_parameters.node_id))
            drive.pending = [item for item in faults if item.device in names]
            self.drives[name] = drive
        known = [str(item.configuration.driver_parameters.node_id)
                 for item in self.drives.values()]
        for item in faults:
            if item.device not in ('', *self.drives, *known):
                raise ConfigurationError('--fault', f'{item.device}:{item.name}', 'the drives are '
                                         + ', '.join(dict.fromkeys((*self.drives, *known))))
        self._networks: dict[tuple[str, str], Any] = {}

    def open(self) -> str:
        """Be on the bus; return where.

        Raises:
            MissingDependencyError: canopen or python-can is not installed.
            DriverError: There is no such bus.
        """
        found = []
        for name, drive in self.drives.items():
            p = drive.configuration.driver_parameters
            if p.bus not in self._networks:
                self._networks[p.bus] = connect(p)
            found.append(f'{name}: {drive.open(self._networks[p.bus])}')
        return '\n'.join(found)

    def run(self, stopping: Callable[[], bool], log: Callable[[str], None]) -> None:
        """Be the drives until `stopping` returns True."""
        logs = {name: _named(name, log) for name in self.drives}
        tick = min(item.tick for item in self.drives.values())
        while not stopping():
            time.sleep(tick)
            for name, drive in self.drives.items():
                drive.step(logs[name])
        for name, drive in self.drives.items():
            drive.finish(logs[name])

    def close(self) -> None:
        """Leave the bus."""
        for drive in self.drives.values():
            drive.close()
        for network in self._networks.values():
            network.disconnect()


def _named(name: str, log: Callable[[str], None]) -> Callable[[str], None]:
    """Return what logs with the name of a drive before the text."""
    return lambda text: log(f'{name}: {text}')
