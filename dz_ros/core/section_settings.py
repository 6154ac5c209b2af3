# SPDX-License-Identifier: Apache-2.0
"""What the sections of a configuration have besides what the class they choose brings."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
import re

from dz_ros.core.axes import check_names
from dz_ros.core.deadzone import Schedule
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
                                'only)', minimum=0.0, maximum=1e9, structural=True)
    seed: int = parameter(0, '1', 'seed of everything random', minimum=0, maximum=2 ** 63 - 1,
                          structural=True)
    peers: tuple[str, ...] = parameter(
        ('plant_node', 'controller_node', 'trajectory_node'), '', 'names of the nodes that must '
        'be there before the first sample; add recorder_node to have it recorded',
        structural=True)
    axes: tuple[str, ...] = parameter(
        (), '', 'names of the axes of a loop of several; empty = one, without a name',
        structural=True)
    schedule_values: tuple[float, ...] = parameter(
        (), 'unit of the scheduling variable', 'scheduling variable that dead-zone and law may '
        'follow, such as a supply voltage: one number = constant, several = at schedule_times, '
        'linear between them; empty = none', structural=True)
    schedule_times: tuple[float, ...] = parameter(
        (), 's', 'instants of schedule_values, rising; empty with one value', structural=True)
    schedule_topic: str = parameter('', '', 'topic (std_msgs/Float64) that gives the scheduling '
                                    'variable in real time, from its first message on; empty = '
                                    'none', structural=True)

    def check(self, prefix: str) -> None:
        """Check axes, that a run has a sample after the first, and the table of the schedule."""
        check_names(self.axes, f'{prefix}axes')
        times, values, topic = self.schedule_times, self.schedule_values, self.schedule_topic
        if topic and not re.fullmatch(r'/?[A-Za-z]\w*(/[A-Za-z]\w*)*', topic, re.ASCII):
            raise ConfigurationError(f'{prefix}schedule_topic', topic,
                                     'must be the name of a topic, or empty')
        if topic and not values:
            raise ConfigurationError(f'{prefix}schedule_topic', topic, 'needs schedule_values, '
                                     'which hold before its first message and offline')
        if topic and self.timing == 'lockstep':
            raise ConfigurationError(f'{prefix}schedule_topic', topic, 'must be empty in '
                                     'lockstep: its messages have no sample')
        if len(times) != len(values) and (times or len(values) != 1):
            raise ConfigurationError(f'{prefix}schedule_times', list(times), 'must have one '
                                     f'instant for each of the {len(values)} schedule_values')
        if any(earlier >= later for earlier, later in pairwise(times)):
            raise ConfigurationError(f'{prefix}schedule_times', list(times), 'must rise')
        if self.duration > 0.0 and self.samples < 1:
            raise ConfigurationError(f'{prefix}duration', self.duration, 'must be 0 (until '
                                     f'stopped) or at least one period, {self.period:g} s')

    @property
    def period(self) -> float:
        """T [s]."""
        return 1.0 / self.rate

    @property
    def schedule(self) -> Schedule | None:
        """The scheduling variable; None = there is none."""
        if not self.schedule_values:
            return None
        return Schedule(self.schedule_times or (0.0,), self.schedule_values)

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
    resolution: float = parameter(0.0, 'unit of x', 'the sensor counts x in steps of this; 0 = '
                                  'none', minimum=0.0, structural=True)
    derivative_resolution: tuple[float, ...] = parameter(
        (), 'state units', "steps in which x', x'', … are counted where they are measured; empty "
        'or 0 = none', minimum=0.0, structural=True)
    command_resolution: float = parameter(0.0, 'actuator unit', 'the actuator rounds v to steps '
                                          'of this; 0 = not', minimum=0.0, structural=True)
    backlash: float = parameter(0.0, 'actuator unit', 'play between the command and the '
                                'dead-zone, whole width; 0 = none', minimum=0.0, structural=True)
    command_limit: float = parameter(0.0, 'actuator unit', 'the actuator clips |v| to this; '
                                     '0 = no limit', minimum=0.0, structural=True)
    disturbance_pulse: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), 's, unit of x^(n), s', '[instant, acceleration, duration] of a '
        'disturbance pulse, over the samples that begin within it; acceleration 0 = none',
        length=3)

    def check(self, prefix: str) -> None:
        """Check that the pulse is in the loop's time."""
        if self.disturbance_pulse[0] < 0.0 or self.disturbance_pulse[2] < 0.0:
            raise ConfigurationError(f'{prefix}disturbance_pulse', list(self.disturbance_pulse),
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
    error_band: float = parameter(0.0, 'unit of x', 'error that the law is not shown, so that it '
                                  'rests where friction sticks; 0 = none', minimum=0.0,
                                  structural=True)
    regressors_at: str = parameter('measured', '', 'state at which the law gets Y: the measured '
                                   'one, or that of the reference', structural=True,
                                   choices=('measured', 'reference'))
    override_checks: bool = parameter(False, '', 'start the controller even where a design rule '
                                      'finds an error', structural=True)

    def check(self, prefix: str) -> None:
        """Check that lower bounds lie below upper ones."""
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
                           'or 2-3; empty = every other one for each',
                           structural=True)
    lock_memory: bool = parameter(False, '', 'keep plant or actuator and controller in RAM',
                                  structural=True)
    collect_garbage: bool = parameter(False, '', "leave Python's automatic garbage collection on; "
                                      'for drivers and laws that make reference cycles',
                                      structural=True)
    poll: str = parameter('none', '', 'in real time, where there are two cores or more, wait for '
                          'what is due within a fraction of a millisecond without sleeping: the '
                          'plant or actuator for the command, the controller for the state',
                          choices=('none', 'plant', 'both'), structural=True)

    def check(self, prefix: str) -> None:
        """Check that the cores are numbers."""
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
