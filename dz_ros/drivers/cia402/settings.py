# SPDX-License-Identifier: Apache-2.0
"""Parameters of a drive: where it is, what its numbers mean, how long to wait for it (ours)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from dz_ros.core.axes_keys import axis_key
from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError

LARGEST_TARGET = 32767
"""Largest target torque, per mille of the rated one: it is a 16-bit number."""


@dataclass(frozen=True)
class Cia402Parameters:
    """Parameters of the driver `cia402`."""

    interface: str = parameter('socketcan', '', 'interface of python-can', structural=True)
    channel: str = parameter('can0', '', 'channel of that interface', structural=True)
    bitrate: int = parameter(1_000_000, 'bit/s', 'bit rate; some interfaces have it set outside',
                             minimum=10_000, maximum=1_000_000, structural=True)
    bus_options: tuple[str, ...] = parameter((), '', 'further options of the interface, each '
                                             'name=value', structural=True)
    node_id: int = parameter(1, '1', 'node id of the drive', minimum=1, maximum=127,
                             structural=True)
    master_id: int = parameter(127, '1', 'node id under which our heartbeat is sent', minimum=1,
                               maximum=127, structural=True)

    mode: str = parameter('torque', '', 'what v is: torque (cyclic synchronous torque, 10) or '
                          'velocity (cyclic synchronous velocity, 9)',
                          choices=('torque', 'velocity'), structural=True)
    counts_per_rev: int = parameter(65536, '1/rev', 'position counts (6064h) of one revolution '
                                    'of the motor', minimum=1, structural=True)
    gear: float = parameter(1.0, 'rev/rev', 'revolutions of the motor for one of the output',
                            minimum=0.0, open_minimum=True, structural=True)
    unit_per_rev: float = parameter(2.0 * math.pi, 'unit of x/rev', 'x of one revolution of the '
                                    'output; the pitch of a lead screw', minimum=0.0,
                                    open_minimum=True, structural=True)
    reverse: bool = parameter(False, '', 'the drive turns the other way: x, velocity and v '
                              'change their sign', structural=True)
    zero: int = parameter(0, '1', 'position count at which x is 0', minimum=-2 ** 31,
                          maximum=2 ** 31 - 1, structural=True)
    position_range: int = parameter(0, '1', 'counts after which the position (6064h) begins '
                                    'again: of a modulo axis, 65536 of a 16-bit counter; 0 = as '
                                    'the drive reports (607Bh), or 32 bits', minimum=0,
                                    maximum=2 ** 32, structural=True)
    absolute_encoder: bool = parameter(True, '', 'the position survives a restart of the drive; '
                                       'false: a restarted drive is not driven on',
                                       structural=True)
    velocity_measured: bool = parameter(True, '', 'take the velocity from the drive (606Ch); '
                                        "false: from the host's observer", structural=True)
    velocity_counts: float = parameter(0.0, '1/(rev/s)', 'velocity number (606Ch, 60FFh) of one '
                                       'revolution of the motor per second; 0 = counts_per_rev',
                                       minimum=0.0, structural=True)
    rated_torque: float = parameter(1.0, 'N m', "the motor's rated torque; compared with the "
                                    "drive's own, 6076h", minimum=0.0, open_minimum=True,
                                    structural=True)
    torque_per_command: float = parameter(1.0, 'N m per command unit', 'torque at the motor '
                                          'shaft that v = 1 asks for', minimum=0.0,
                                          open_minimum=True, structural=True)
    max_torque: float = parameter(1.0, '1', 'largest torque over the rated one, written to the '
                                  'drive (6072h)', minimum=0.0, open_minimum=True,
                                  maximum=LARGEST_TARGET / 1000.0, structural=True)
    speed_per_command: float = parameter(1.0, 'unit of x/s per command unit', 'velocity of the '
                                         'output that v = 1 asks for', minimum=0.0,
                                         open_minimum=True, structural=True)
    max_speed: float = parameter(3000.0, '1/min', 'largest speed of the motor, written to the '
                                 'drive (6080h)', minimum=0.0, open_minimum=True, structural=True)

    act_at: str = parameter('arrival', '', 'when the drive applies a command: at its arrival '
                            '(PDO type 255) or at the next sync (type 1)',
                            choices=('arrival', 'sync'), structural=True)
    sync_lead: float = parameter(0.0015, 's', 'SYNC goes out that long before each sample, so '
                                 'that its answer is there in time', minimum=0.0, structural=True)
    extrapolate: bool = parameter(True, '', 'bring x from the instant of the SYNC to that of the '
                                  "sample by the drive's velocity", structural=True)
    heartbeat: float = parameter(0.05, 's', 'period of the heartbeats, both ways', minimum=0.002,
                                 maximum=10.0, structural=True)
    heartbeat_hold: float = parameter(0.15, 's', 'a heartbeat that stays away that long is a '
                                      'fault, here and in the drive', minimum=0.005, maximum=60.0,
                                      structural=True)
    command_hold: float = parameter(0.1, 's', 'the drive stops by itself when no command comes '
                                    'for that long (event timer of its RPDO)', minimum=0.005,
                                    maximum=60.0, structural=True)
    quick_stop: int = parameter(6, '1', 'what the drive does at a quick stop (605Ah): 0 without '
                                'voltage, 1 and 2 stop and then without voltage, 5 and 6 stop and '
                                'stay enabled', minimum=0, maximum=8, structural=True)
    abort_connection: int = parameter(1, '1', 'what the drive does when host or bus is gone, or '
                                      'NMT stops it (6007h): 1 fault, 2 disable voltage, 3 quick '
                                      'stop', minimum=1, maximum=3, structural=True)
    fault_reaction: int = parameter(2, '1', 'what the drive does at a fault (605Eh): 0 without '
                                    'voltage, 1 slow down ramp, 2 quick stop ramp, 3 and 4 at the '
                                    'limit of current or voltage', minimum=0, maximum=4,
                                    structural=True)
    unsupervised: bool = parameter(False, '', 'true: drive also a drive that would not stop by '
                                   'itself when host or bus is gone', structural=True)
    transition_limit: float = parameter(2.0, 's', 'longest way to operation enabled',
                                        minimum=0.05, maximum=60.0, structural=True)
    answer_limit: float = parameter(0.3, 's', 'longest wait for an answer to an SDO',
                                    minimum=0.01, maximum=10.0, structural=True)

    def check(self, prefix: str) -> None:
        """Check what spans several parameters.

        Raises:
            ConfigurationError: Two nodes with one id, a hold shorter than the heartbeat, an
                option that is not name=value.
        """
        if self.node_id == self.master_id:
            raise ConfigurationError(f'{prefix}master_id', self.master_id,
                                     f'must not be that of the drive, {prefix}node_id')
        if self.heartbeat_hold < 2.0 * self.heartbeat:
            raise ConfigurationError(f'{prefix}heartbeat_hold', self.heartbeat_hold,
                                     'must be at least two heartbeats, '
                                     f'{2.0 * self.heartbeat:g} s')
        for option in self.bus_options:
            if not option.partition('=')[0].isidentifier() or '=' not in option:
                raise ConfigurationError(f'{prefix}bus_options', list(self.bus_options),
                                         f'{option!r} must be name=value')
        if self.max_speed / 60.0 * (self.velocity_counts or self.counts_per_rev) >= 2 ** 31:
            raise ConfigurationError(f'{prefix}max_speed', self.max_speed,
                                     'is more than 32 bits hold: lower it or velocity_counts')

    @property
    def bus(self) -> tuple[str, str]:
        """Interface and channel: drives with the same ones are on one bus."""
        return self.interface, self.channel

    @property
    def options(self) -> dict[str, int | float | bool | str]:
        """`bus_options` as values: numbers and true, false where they look like it."""
        found: dict[str, int | float | bool | str] = {}
        for option in self.bus_options:
            name, _, text = option.partition('=')
            found[name] = _value(text)
        return found


OF_THE_BUS = ('bitrate', 'bus_options', 'master_id', 'heartbeat', 'sync_lead')
"""Parameters that the drives of one bus have in common: there is one connection, SYNC, master."""


def check_buses(axes: Mapping[str, Cia402Parameters]) -> None:
    """Check that the drives of axes which name the same bus can be on it together.

    Args:
        axes: Name → parameters.

    Raises:
        ConfigurationError: Two have one node id, one has that of the master, or what concerns the
            bus differs.
    """
    buses: dict[tuple[str, str], dict[int, tuple[str, Cia402Parameters]]] = {}
    for name, p in axes.items():
        nodes = buses.setdefault(p.bus, {})
        place = f'{p.interface} {p.channel}'
        for first, other in nodes.values():
            for key in OF_THE_BUS:
                value, wanted = getattr(p, key), getattr(other, key)
                if value != wanted:
                    raise ConfigurationError(
                        axis_key(name, f'driver.{key}'), _plain(value), f'must be '
                        f'{_plain(wanted)!r} as of axis {first}: both are on {place}, which has '
                        'one connection, one SYNC and one master')
        if p.node_id in nodes:
            raise ConfigurationError(
                axis_key(name, 'driver.node_id'), p.node_id, 'must differ from that of axis '
                f'{nodes[p.node_id][0]}: both are on {place}')
        nodes[p.node_id] = (name, p)


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _value(text: str) -> int | float | bool | str:
    """Return a text as the number or truth value it is, or as it is."""
    if text.lower() in ('true', 'false'):
        return text.lower() == 'true'
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
