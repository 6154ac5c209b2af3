"""What the sections of a configuration have besides what the class they choose brings."""

from __future__ import annotations

from dataclasses import dataclass
import re

from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError


@dataclass(frozen=True)
class LoopSettings:
    """The loop itself."""

    rate: float = parameter(200.0, 'Hz', 'samples per second, 1/T; the paper has T = 0.005 s',
                            minimum=1.0, maximum=10000.0, structural=True)
    delay: int = parameter(0, 'samples', 'whole samples by which the actuator applies a command '
                           'late, on top of what the transport takes', minimum=0, maximum=100,
                           structural=True)
    timing: str = parameter('realtime', '', 'realtime: absolute deadlines of the wall; lockstep: '
                            'as fast as the messages come, stamp = kT', structural=True,
                            choices=('realtime', 'lockstep'))
    duration: float = parameter(20.0, 's', 'length of a run; 0 = until stopped (a loop of nodes '
                                'only)', minimum=0.0, structural=True)
    seed: int = parameter(0, '1', 'seed of everything random', minimum=0, maximum=2 ** 63 - 1,
                          structural=True)
    peers: tuple[str, ...] = parameter(
        ('plant_node', 'controller_node', 'trajectory_node'), '', 'names of the nodes that must '
        'be there before the first sample; add recorder_node to have it recorded',
        structural=True)

    def check(self, prefix: str) -> None:
        """Check that a run has a sample after the first.

        Raises:
            ConfigurationError: It has not.
        """
        if self.duration > 0.0 and self.samples < 1:
            raise ConfigurationError(f'{prefix}duration', self.duration, 'must be 0 (until '
                                     f'stopped) or at least one period, {self.period:g} s')

    @property
    def period(self) -> float:
        """T [s]."""
        return 1.0 / self.rate

    @property
    def samples(self) -> int:
        """Number of the last sample of a run; samples 0 … this one exist."""
        return round(self.duration * self.rate)


@dataclass(frozen=True)
class PlantSettings:
    """What every plant has besides its model's own parameters."""

    model: str = parameter('wang2004', '', 'name of the plant, or package.module:Class',
                           structural=True)
    x0: tuple[float, ...] = parameter((), 'state units', "initial state; empty = the model's",
                                      structural=True)
    substeps: int = parameter(4, '1', 'RK4 steps in a sample', minimum=1, maximum=1000,
                              structural=True)
    noise: tuple[float, ...] = parameter(
        (0.0,), 'state units', 'standard deviation of the measurement noise of each state, or one '
        'for all', minimum=0.0, structural=True)
    command_limit: float = parameter(0.0, 'actuator unit', 'the actuator clips |v| to this; '
                                     '0 = no limit', minimum=0.0, structural=True)
    kick: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), '', '[instant in s, acceleration in unit of x^(n), duration in s] of a '
        'push on the plant, over the samples that begin within it; acceleration 0 = none',
        length=3)

    def check(self, prefix: str) -> None:
        """Check that the kick is in the loop's time.

        Raises:
            ConfigurationError: Its instant or duration is negative.
        """
        if self.kick[0] < 0.0 or self.kick[2] < 0.0:
            raise ConfigurationError(f'{prefix}kick', list(self.kick),
                                     'instant and duration must not be negative')


@dataclass(frozen=True)
class ControllerSettings:
    """What every controller has besides its law's own gains: the law and the knowledge (A4)."""

    law: str = parameter('wang2004', '', 'name of the law, or package.module:Class',
                         structural=True)
    b_r_bounds: tuple[float, ...] = parameter((0.1, 0.6), 'actuator unit',
                                              'known bounds of b_r (A4)', length=2, minimum=0.0)
    b_l_bounds: tuple[float, ...] = parameter((-0.7, -0.1), 'actuator unit',
                                              'known bounds of b_l (A4)', length=2, maximum=0.0)
    m_bounds: tuple[float, ...] = parameter((0.85, 1.25), '1', 'known bounds of the slope m (A4)',
                                            length=2, minimum=0.0, open_minimum=True)
    b_bounds: tuple[float, ...] = parameter((1.0, 1.0), 'input gain unit',
                                            'known bounds of the input gain b', length=2,
                                            minimum=0.0, open_minimum=True)
    override_checks: bool = parameter(False, '', 'start the controller even where a design rule '
                                      'finds an error', structural=True)

    def check(self, prefix: str) -> None:
        """Check that lower bounds lie below upper ones.

        Raises:
            ConfigurationError: They do not.
        """
        for name in ('b_r_bounds', 'b_l_bounds', 'm_bounds', 'b_bounds'):
            low, high = getattr(self, name)
            if low > high:
                raise ConfigurationError(f'{prefix}{name}', [low, high],
                                         'the lower bound must not exceed the upper one')


@dataclass(frozen=True)
class TrajectorySettings:
    """What every trajectory has besides its own parameters."""

    kind: str = parameter('sinusoid', '', 'name of the trajectory, or package.module:Class',
                          structural=True)


@dataclass(frozen=True)
class ProcessSettings:
    """What the two ends of the loop ask of the operating system; all of it may be refused."""

    priority: int = parameter(0, '', 'SCHED_FIFO priority of plant or actuator and controller in '
                              'real time, one less for the trajectory; 0 = as any process',
                              minimum=0, maximum=98, structural=True)
    cores: str = parameter('', '', 'cores that plant or actuator and controller run on, e.g. 2,3 '
                           'or 2-3; empty = any, in lockstep every other one for each',
                           structural=True)
    lock_memory: bool = parameter(False, '', 'keep plant or actuator and controller in RAM',
                                  structural=True)
    collect_garbage: bool = parameter(False, '', "leave Python's automatic garbage collection on; "
                                      'for drivers and laws that make reference cycles',
                                      structural=True)

    def check(self, prefix: str) -> None:
        """Check that the cores are numbers.

        Raises:
            ConfigurationError: They are not.
        """
        part = r'\d{1,4}(-\d{1,4})?'
        if self.cores and not re.fullmatch(f'{part}(,{part})*', self.cores):
            raise ConfigurationError(f'{prefix}cores', self.cores,
                                     'must be numbers and ranges such as 0,2-3, or empty')

    @property
    def core_numbers(self) -> frozenset[int]:
        """The cores by number; empty = none named."""
        found: set[int] = set()
        for part in self.cores.split(',') if self.cores else ():
            first, _, last = part.partition('-')
            found.update(range(int(first), int(last or first) + 1))
        return frozenset(found)
