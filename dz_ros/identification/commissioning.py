# SPDX-License-Identifier: Apache-2.0
"""The steps from a new device to a running loop, and the log of them (ours).

Terminal and live page are two faces of them: `ABOUT` are the steps, `StepLog` is what was done,
and `StepLog.overview` what a face shows of both.

A folder holds a subfolder for each attempt of a step and one log, a JSON object a line. Nothing in
it is ever changed: a step that is repeated is another attempt, and the steps after it use the
newest result of each step before them. What is read from the log is data.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
import json
from pathlib import Path
from typing import Any

from dz_ros.errors import RecordingError

ABOUT: Mapping[str, str] = {
    'limits': 'how far, fast and hard it may move; asked, never guessed',
    'sign': 'does it follow the command',
    'sensor': 'resolution and noise of the position, delay of the commands',
    'identify': 'dead-zone with bounds, and the plant',
    'propose': 'a configuration for a small first motion, in a file',
    'check': 'its design rules',
    'loop': 'the first closed loop, with the e-stop armed',
    'report': 'the report of that run'}
"""Step → what it finds, in their order."""
STEPS = tuple(ABOUT)
MOVING = ('sign', 'sensor', 'identify', 'loop')
"""Steps that move the device."""
LOG = 'commissioning.jsonl'
DONE, FAILED = 'done', 'failed'
MAX_LOG = 10_000_000
"""Longest log that is read [bytes]."""


@dataclass(frozen=True)
class Attempt:
    """One attempt of a step.

    Attributes:
        number: Place in the log, from 1.
        step: One of `STEPS`.
        begun: When it began, ISO 8601, UTC.
        outcome: `DONE` or `FAILED`.
        words: What came of it, one line.
        folder: Name of its subfolder; '' = it has no files.
        result: Its numbers, by name.
    """

    number: int
    step: str
    begun: str
    outcome: str
    words: str
    folder: str = ''
    result: Mapping[str, Any] = field(default_factory=dict)


class StepLog:
    """The log of a folder.

    Args:
        folder: Where it lies.

    Attributes:
        folder: The same.
        attempts: All of them, in their order.

    Raises:
        RecordingError: It cannot be read as a log.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.attempts: list[Attempt] = []
        path = folder / LOG
        if path.exists():
            if path.stat().st_size > MAX_LOG:
                raise RecordingError(f'{path}: is longer than {MAX_LOG} bytes, which no log is')
            self.attempts.extend(_read(path))

    def add(self, attempt: Attempt) -> None:
        """Append an attempt."""
        self.attempts.append(attempt)
        with (self.folder / LOG).open('a', encoding='utf-8') as file:
            file.write(json.dumps(asdict(attempt), ensure_ascii=False, allow_nan=False) + '\n')

    def name(self, step: str) -> str:
        """Return the name of the subfolder of the next attempt, of that step."""
        return f'{len(self.attempts) + 1:02d}-{step}'

    def newest(self, step: str) -> Attempt | None:
        """Return the newest attempt of a step that was done."""
        return next((item for item in reversed(self.attempts)
                     if item.step == step and item.outcome == DONE), None)

    def lacking(self, step: str) -> str:
        """Return the first step that must be done before this one and is not; '' = none."""
        return next((item for item in STEPS[:STEPS.index(step)] if self.newest(item) is None), '')

    def overview(self) -> list[dict[str, Any]]:
        """Return each step: what it finds, number of attempts, the newest of them, what it lacks.

        `stale` are steps done before the newest result of a step before them.
        """
        found, newest = [], 0
        for step, about in ABOUT.items():
            attempts = [item for item in self.attempts if item.step == step]
            last, done = attempts[-1] if attempts else None, self.newest(step)
            found.append({
                'step': step, 'about': about, 'moves': step in MOVING, 'attempts': len(attempts),
                'outcome': last.outcome if last else '', 'words': last.words if last else '',
                'folder': last.folder if last else '', 'result': dict(last.result) if last else {},
                'lacking': self.lacking(step),
                'stale': done is not None and done.number < newest})
            newest = max(newest, done.number if done is not None else 0)
        return found

    def position(self) -> float:
        """Return where the device stood last, in a step done or failed [unit of x].

        Raises:
            RecordingError: No step has left a position.
        """
        for item in reversed(self.attempts):
            value = item.result.get('position')
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                return float(value)
        return self.number('identify', 'position')

    def number(self, step: str, name: str) -> float:
        """Return a number of the newest result of a step.

        Raises:
            RecordingError: The step was not done, or the log has no such number.
        """
        found = self.newest(step)
        value = None if found is None else found.result.get(name)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise RecordingError(f'{self.folder / LOG}: step {step} has left no {name}: begin '
                                 f'with --from {step}')
        return float(value)


def _read(path: Path) -> Iterator[Attempt]:
    """Yield the attempts of a log.

    Raises:
        RecordingError: A line that is none.
    """
    try:
        lines = path.read_text(encoding='utf-8').splitlines()
    except UnicodeError:
        raise RecordingError(f'{path}: is no text') from None
    for place, line in enumerate(lines, 1):
        try:
            found = json.loads(line)
            texts = [found[key] for key in ('step', 'begun', 'outcome', 'words', 'folder')]
            result = found['result']
        except (ValueError, RecursionError, KeyError, TypeError):
            raise RecordingError(f'{path}: line {place} is no attempt of a step') from None
        if (not all(isinstance(item, str) for item in texts) or not isinstance(result, dict)
                or texts[0] not in STEPS or Path(texts[4]).name != texts[4]):
            raise RecordingError(f'{path}: line {place} is no attempt of a step')
        step, begun, outcome, words, folder = texts
        yield Attempt(place, step, begun, outcome, words, folder, result)
