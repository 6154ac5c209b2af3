# SPDX-License-Identifier: Apache-2.0
"""What the steps of a commissioning share: the device, its limits, the log, the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
import math
from pathlib import Path
from typing import Any

from dz_ros.cli.driver.identify_moves import ask_at_terminal, motion_text
from dz_ros.cli.driver.move_limits import build_limits
from dz_ros.cli.output import print_lines
from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.identification.commissioning import StepLog
from dz_ros.identification.estimation.pipeline import Identified
from dz_ros.identification.estimation.prediction_error import Fit
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.plan import Limits, Plan

SHARE = 0.3
"""The first motion, as a share of the travel, where no other is asked for."""


class StepFailedError(DzRosError):
    """A step that was made and did not succeed.

    Attributes:
        result: Its numbers.
    """

    def __init__(self, words: str, **result: Any) -> None:
        super().__init__(words)
        self.result = result


@dataclass(frozen=True)
class Outcome:
    """What a step found: one line, and its numbers."""

    words: str
    result: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Answers:
    """How the device may move, and how far the first loop moves it [unit of x]."""

    limits: Limits
    plan: Plan
    amplitude: float


def answers_of(given: Mapping[str, Any], c: Configuration) -> Answers:
    """Return answers by name as what they mean.

    Raises:
        ConfigurationError: One is missing, unknown or not allowed.
    """
    names = {item.name for kind in (Limits, Plan) for item in schema.fields(kind)}
    for name, value in given.items():
        if name not in names and name != 'amplitude':
            raise ConfigurationError(f'--{name[:80]}', value, 'is no limit')
    limits, plan = build_limits(given, c)
    amplitude = given.get('amplitude', SHARE * limits.travel)
    if not (isinstance(amplitude, (int, float)) and math.isfinite(amplitude)
            and 0.0 < amplitude <= limits.travel):
        raise ConfigurationError('--amplitude', amplitude, 'must be > 0 and at most the travel, '
                                 f'{limits.travel:g}')
    return Answers(limits, plan, float(amplitude))


class Operator:
    """The person at the terminal, or at the page (`commission_page`).

    Args:
        yes: Whether nothing is asked.
    """

    def __init__(self, yes: bool) -> None:
        self.yes = yes

    def confirm(self, text: str) -> None:
        """Show what is going to move, and ask whether it may.

        Raises:
            ConfigurationError: There is no terminal to ask at.
            DriverError: It may not.
        """
        print_lines(text)
        if not self.yes:
            ask_at_terminal()

    def watch(self, _moves: Experiment) -> str:
        """Follow the moves, sample by sample; return why to stop, '' = go on."""
        return ''

    def stopped(self) -> str:
        """Return why the device must not move, '' = it may."""
        return ''

    def begun(self, step: str) -> None:
        """Note that a step has begun."""

    def ended(self) -> None:
        """Note that it has ended; it is in the log."""


@dataclass
class State:
    """What the steps share.

    Attributes:
        c: The configuration given.
        log: The steps so far.
        answers: Limits and amplitude; None = not yet given.
        namespace: Of the loop and its e-stop.
        duration: Length of the first loop [s].
        operator: Allows moves.
        name: Subfolder of the present attempt.
        identified: What the step identify found in this process, with the refined plant.
    """

    c: Configuration
    log: StepLog
    answers: Answers | None
    namespace: str
    duration: float
    operator: Operator
    name: str = ''
    identified: tuple[Identified, Fit | None] | None = None

    @property
    def answered(self) -> Answers:
        """Limits and amplitude.

        Raises:
            StepFailedError: They have not been given.
        """
        if self.answers is None:
            raise StepFailedError('step limits has not been done: begin with --from limits')
        return self.answers

    @property
    def limits(self) -> Limits:
        """How far, fast and hard the device may move."""
        return self.answered.limits

    def may_move(self, what: str, duration: float) -> None:
        """Ask whether the device may move so, for at most a time [s].

        Raises:
            ConfigurationError: There is no terminal to ask at.
            DriverError: It may not.
        """
        self.operator.confirm(motion_text(self.c, self.limits, what, duration))

    @property
    def folder(self) -> Path:
        """Subfolder of the present attempt, made when it is first asked for."""
        folder = self.log.folder / self.name
        folder.mkdir(exist_ok=True)
        return folder

    def keep(self, run: RunData, name: str = 'run') -> None:
        """Write a run into the subfolder of the present attempt."""
        from dz_ros.recording.save import save_run

        save_run(run, self.folder / name)

    def of(self, step: str) -> Path:
        """Return the subfolder of the newest attempt of a step that was done.

        Raises:
            StepFailedError: There is none.
        """
        found = self.log.newest(step)
        if found is None or not found.folder:
            raise StepFailedError(f'step {step} has not been done: begin with --from {step}')
        return self.log.folder / found.folder

    def kept(self, step: str) -> str:
        """Return what is kept where a step is interrupted, and how to go on."""
        return (f'the steps before {step} are kept; dz driver commission --from {step} --out '
                f'{self.log.folder} goes on')

    def limits_outcome(self) -> Outcome:
        """Return the limits as answered."""
        c, limits, amplitude = self.c, self.limits, self.answered.amplitude
        driver = c.make_driver()
        speed = ''
        if c.plant.order > 1:
            speed = f', speed {limits.speed:g} {driver.state_units[1]}'
        return Outcome(f'{driver.name}: travel {limits.travel:g} {driver.state_units[0]}{speed}, '
                       f'|v| up to {limits.effort:g} {driver.command_unit}; first motion '
                       f'{amplitude:g} {driver.state_units[0]}',
                       {**asdict(limits), **asdict(self.answered.plan), 'amplitude': amplitude})
