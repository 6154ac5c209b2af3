# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of an end of the loop over the last window, as labels and numbers (ours).

Nothing here reads a clock or a message: samples go in, a `Report` comes out and the window begins
again. Totals since the start go on counting.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import enum
import math

from dz_ros.core.configuration import Configuration
from dz_ros.core.lateness import LATE, LATE_COUNT
from dz_ros.core.percentiles import percentile
from dz_ros.core.records import Status, Terms
from dz_ros.core.safety.modes import LifecycleState, Mode
from dz_ros.core.safety.supervisor import Supervisor
from dz_ros.core.signals import S, V_FEED_FORWARD, V_REGRESSOR
from dz_ros.core.tracking import guaranteed_bounds

LATE_SHARE, SATURATED_SHARE, CHATTER = 0.05, 0.2, 3.0
"""More than this is worth a warning: share of late samples, of saturated ones, of variation over
the expected one."""


class Level(enum.IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass
class Report:
    """Diagnostics of a node, once a second.

    Attributes:
        level: The worst that was found.
        message: The findings, as text.
        values: Label with its unit in brackets → number or text.
    """

    level: Level = Level.OK
    message: str = ''
    values: dict[str, str] = field(default_factory=dict)

    def summarize(self, level: Level, message: str) -> None:
        """Add a finding; the worst level leads."""
        self.message = f'{self.message}; {message}' if self.message else message
        self.level = max(self.level, level)

    def add(self, fill: Callable[[Report], None], name: str) -> None:
        """Add a report of one axis, which `fill` writes, with its name before each label."""
        own = Report()
        fill(own)
        self.values.update((f'{name}: {label}', text) for label, text in own.values.items())
        if own.message:
            self.summarize(own.level, f'{name}: {own.message}')

    def put(self, label: str, value: float | str | None, form: str = '.4g') -> None:
        """Add a value; None is left out."""
        if value is not None:
            self.values[label] = value if isinstance(value, str) else format(value, form)


def percentiles(values: Sequence[float], report: Report, label: str) -> None:
    """Add p50, p99, p99.9 and the largest of some times [s] in milliseconds."""
    ordered = sorted(values)
    if ordered:
        for name, share in (('p50', 0.5), ('p99', 0.99), ('p99.9', 0.999), ('max', 1.0)):
            report.put(f'{label} {name} [ms]', percentile(ordered, share) * 1e3, '.3f')


class Pace:
    """Rate, periods and lateness of samples by the steady clock."""

    def __init__(self, period: float) -> None:
        self.late = 0
        self.samples = 0
        self._period = period
        self._intervals: list[float] = []
        self._late_before = 0
        self._last: tuple[float, float] | None = None

    def sample(self, now: float, stamp: float) -> None:
        """Take note of a sample of loop time `stamp` at `now` [s]."""
        self.samples += 1
        if self._last is not None:
            earlier, before = self._last
            self._intervals.append(now - earlier)
            self.late += now - earlier - (stamp - before) > LATE
        self._last = now, stamp

    def report(self, report: Report, judged: bool) -> None:
        """Add rate, periods and lateness; `judged` where they are the wall clock's."""
        span = math.fsum(self._intervals)
        report.put('rate [Hz]', len(self._intervals) / span if span > 0.0 else 0.0, '.1f')
        percentiles(self._intervals, report, 'period')
        report.put(LATE_COUNT, self.late, 'd')
        fresh = self.late - self._late_before
        if judged and self._intervals and fresh > LATE_SHARE * len(self._intervals):
            report.summarize(Level.WARN, f'{fresh} of {len(self._intervals)} samples late')
        self._intervals.clear()
        self._late_before = self.late


class Rejections:
    """Messages not taken, with a warning in the window in which their number grew."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}

    def report(self, report: Report, counts: Mapping[str, int]) -> None:
        """Add the counts, named `topic: reason`."""
        for name, count in counts.items():
            report.put(f'ignored {name}', count, 'd')
            if count > self._before.get(name, 0):
                fresh = count - self._before.get(name, 0)
                report.summarize(Level.WARN, f'{fresh} ignored ({name})')
        self._before = dict(counts)


def variation_share(variation: float, expected: float, largest: float) -> float:
    """Return how much more v varies in a window than the reference needs.

    A command that only follows its feed-forward varies as that does; crossing the dead-zone adds
    about once the command's own size. Chatter inside the layer, which no guard sees, shows here;
    so does noise that the layer's gain passes on.

    Args:
        variation: Total variation of v.
        expected: That of the feed-forward φ̂ u_fd + Yᵀθ̂.
        largest: Largest |v|.
    """
    return variation / (expected + largest or 1.0)


class LawHealth:
    """What the law has done: errors, freezes, saturation, variation of the command."""

    def __init__(self, configuration: Configuration) -> None:
        self.freezes = dict.fromkeys((item for item in Status if item), 0)
        self.configure(configuration)
        self._clear()

    def configure(self, configuration: Configuration) -> None:
        """Use other gains from now on."""
        law = configuration.law
        self._epsilon = getattr(law.gains, 'epsilon', 0.0) or 0.0
        names = law.signal_names
        self._epsilon_at = names.index('epsilon') if 'epsilon' in names else None
        self._ratio = 0.0       # bound of x̃ over ε
        if getattr(law.gains, 'lambda_', 0.0) > 0.0:
            self._ratio = guaranteed_bounds(law.gains.lambda_, 1.0, configuration.plant.order)[0]

    def _clear(self) -> None:
        self._samples = self._saturated = self._inside = 0
        self._layer = self._largest = self._variation = self._expected = self._error = 0.0
        self._last: tuple[float, float] | None = None

    def sample(self, v: float, terms: Terms, error: float) -> None:
        """Take note of a sample: command, terms of the law, x̃."""
        self._samples += 1
        if terms.status:
            for item in self.freezes:
                self.freezes[item] += bool(terms.status & item)
            self._saturated += bool(terms.status & Status.SATURATED)
        epsilon = self._epsilon if self._epsilon_at is None else terms.signals[self._epsilon_at]
        if epsilon > 0.0:
            self._layer = max(self._layer, abs(terms.values[S]) / epsilon)
            if self._ratio > 0.0:
                self._inside += abs(error) <= self._ratio * epsilon
        self._error = max(self._error, abs(error))
        smooth = terms.values[V_FEED_FORWARD] + terms.values[V_REGRESSOR]
        if self._last is not None:
            self._variation += abs(v - self._last[0])
            self._expected += abs(smooth - self._last[1])
        self._largest = max(self._largest, abs(v))
        self._last = v, smooth

    def report(self, report: Report) -> None:
        """Add the values of the window and begin the next window."""
        if self._samples:
            report.put('max |error|', self._error)
            report.put('max |v|', self._largest)
            if self._epsilon or self._epsilon_at is not None:
                report.put('max |s|/epsilon', self._layer)
                report.put('within the guaranteed bound [%]', 100.0 * self._inside / self._samples,
                           '.1f')
            saturated = self._saturated / self._samples
            report.put('saturated [%]', 100.0 * saturated, '.1f')
            if saturated > SATURATED_SHARE:
                report.summarize(Level.WARN, f'saturated {100.0 * saturated:.0f} % of the time')
            chatter = variation_share(self._variation, self._expected, self._largest)
            report.put('variation of v over the expected', chatter)
            if chatter > CHATTER:
                report.summarize(Level.WARN,
                                 f'chatter, or noise passed on: v varies {chatter:.1f} '
                                 'times the expected')
        for item, count in self.freezes.items():
            name = str(item.name).lower().replace('_', ' ')
            report.put(f'frozen: {name} [samples]', count, 'd')
        self._clear()


def summarize_state(report: Report, supervisor: Supervisor) -> None:
    """Begin a report with lifecycle state and mode, and with what is wrong with them."""
    report.put('state', supervisor.lifecycle_state.value)
    report.put('mode', supervisor.mode.value)
    if supervisor.lifecycle_state is not LifecycleState.ACTIVE:
        report.summarize(Level.WARN, supervisor.lifecycle_state.value)
    if supervisor.mode in (Mode.LOST, Mode.FAULT, Mode.ESTOP):
        report.summarize(Level.ERROR, f'{supervisor.mode.value}: {supervisor.reason}')
    elif supervisor.lifecycle_state is LifecycleState.ACTIVE:
        report.summarize(Level.OK, supervisor.mode.value)
