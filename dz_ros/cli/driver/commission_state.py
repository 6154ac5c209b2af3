# SPDX-License-Identifier: Apache-2.0
"""What the steps of a commissioning share: the device, its limits, the log, the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import DzRosError
from dz_ros.identification.commissioning import StepLog
from dz_ros.identification.estimation.pipeline import Identified
from dz_ros.identification.estimation.prediction_error import Fit
from dz_ros.identification.experiment.plan import Limits, Plan


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


@dataclass
class State:
    """What the steps share.

    Attributes:
        c: The configuration given.
        log: The steps so far.
        limits, plan, amplitude: How the device may move, and how far the first loop moves it.
        namespace: Of the loop and its e-stop.
        yes: Whether nothing is asked.
        duration: Length of the first loop [s].
        page: Host and port at which the browser shows it; None = it does not.
        name: Subfolder of the present attempt.
        identified: What the step identify found in this process, with the refined plant.
    """

    c: Configuration
    log: StepLog
    limits: Limits
    plan: Plan
    amplitude: float
    namespace: str
    yes: bool
    duration: float
    page: tuple[str, int] | None = None
    name: str = ''
    identified: tuple[Identified, Fit | None] | None = None

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

    def limits_outcome(self) -> Outcome:
        """Return the limits as answered."""
        c, limits = self.c, self.limits
        driver = c.make_driver()
        speed = ''
        if c.plant.order > 1:
            speed = f', speed {limits.speed:g} {driver.state_units[1]}'
        return Outcome(f'{driver.name}: travel {limits.travel:g} {driver.state_units[0]}{speed}, '
                       f'|v| up to {limits.effort:g} {driver.command_unit}; first motion '
                       f'{self.amplitude:g} {driver.state_units[0]}',
                       {**asdict(limits), **asdict(self.plan), 'amplitude': self.amplitude})
