# SPDX-License-Identifier: Apache-2.0
"""Verdict on a run: faults, losses, lateness, the guarantee, the recording (ours).

A run fails where it ended in a latched fault, samples were lost or its simulation diverged. A
planned end, an interrupt, an e-stop and a fault that was reset are facts, not failures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dz_ros.core.events import (
    FinishedEvent,
    ModeEvent,
    of_kind,
    StoppedEvent,
    typed,
    UnmeasuredEvent,
)
from dz_ros.core.lateness import fell_behind, LATE_TEXT
from dz_ros.core.text import counted
from dz_ros.report import page
from dz_ros.report.guarantee import Guarantee, guarantee
from dz_ros.report.view import View

REST = 0.25
"""Part of the window that must be within Ω_ε without a break to be named."""


@dataclass(frozen=True)
class Verdict:
    """How a run went.

    Attributes:
        failures: Why the run failed, a line each; empty = it did not.
        facts: What else a reader must know, a line each.
        doubts: What makes the numbers of a run that did not fail those of something else.
    """

    failures: tuple[str, ...]
    facts: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        if self.failures:
            return f'FAILED: {"; ".join((*self.failures, *self.doubts))}'
        return ', but '.join(filter(None, ('no failure', '; '.join(self.doubts))))

    def lines(self) -> list[str]:
        """Return the verdict as lines for a terminal."""
        return [f'verdict: {self.headline}', *(f'  {fact}' for fact in self.facts)]

    def html(self) -> str:
        """Return the verdict as the top of a page, a banner where the run failed."""
        return (page.paragraph(f'Verdict: {self.headline}.', 'fault' if self.failures else 'note')
                + page.bullets(self.facts))


def judge(view: View) -> Verdict:
    """Return the verdict on a run."""
    unmeasured, promised = _unmeasured(view), guarantee(view)
    missing = {name: topic.sequence.missing for name, topic in view.timing.topics.items()}
    for name in {'state', 'reference'} & missing.keys():
        missing[name] -= unmeasured     # never to be published, nor was what a state asks for
    lost = {name: count for name, count in missing.items() if count > 0}
    failures = [f'{node} ended in a latched fault at {time:.3f} s: {reason}'
                for node, time, reason in latched_faults(view)]
    finite = np.isfinite(view.rows.x).all(axis=1)
    if view.setting.mode == 'offline' and not finite.all():
        failures.append('the loop diverged, its numbers are no longer finite at t = '
                        f'{view.rows.t[int(finite.argmin())]:g} s')
    if lost:
        failures.append('samples lost: ' + ', '.join(f'{count} of {name}'
                                                     for name, count in lost.items()))
    return Verdict(tuple(failures), tuple(filter(None, (
        _end(view), _modes(view),
        f'{counted(unmeasured, "sample")} without a measurement' if unmeasured else '',
        _samples(view, bool(lost)), _inactive(view), _guaranteed(view, promised),
        _uncovered(promised)))),
        tuple(filter(None, (fell_behind(len(view.rows.seq), _skipped(view)),))))


def latched_faults(view: View) -> list[tuple[str, float, str]]:
    """Return (node, loop time [s], reason) of the faults nodes ended in, the first fault first."""
    last = {event.node: (time, event) for time, event in of_kind(view.run.events, ModeEvent)}
    return [(node, _stamp(view, time), event.reason)
            for node, (time, event) in sorted(last.items(), key=lambda item: item[1][0])
            if event.mode == 'fault']


def _stamp(view: View, time: int) -> float:
    """Return the loop time of an instant of the log [s]."""
    state = view.run.channels.get('state')
    if state is None or not len(state):
        return 0.0
    return float(np.interp(time, state.log_time, state['stamp']))


def _end(view: View) -> str:
    """Return how the run ended and whether the recording is complete."""
    if view.setting.mode == 'offline':
        return ''
    kinds = {type(event) for _, event in typed(view.run.events)}
    end = ('planned end' if FinishedEvent in kinds else 'stopped by deactivation'
           if StoppedEvent in kinds else 'no orderly end')
    c, last = view.setting.configuration, float(view.rows.t[-1])
    if FinishedEvent in kinds and c is not None and last < c.loop.duration - 2.0 * c.loop.period:
        end = f'ended early, in order: {last:g} of {c.loop.duration:g} s'
    cut = view.run.info.get('cut')
    return f'{end}; recording {f"cut off: {cut}" if cut else "complete"}'


def _unmeasured(view: View) -> int:
    """Return the number of samples for which the device had no measurement."""
    return sum(event.samples for _, event in of_kind(view.run.events, UnmeasuredEvent))


def _modes(view: View) -> str:
    """Return e-stops, and faults that did not last."""
    events = [event for _, event in of_kind(view.run.events, ModeEvent)]
    faults = sum(event.mode == 'fault' for event in events) - len(latched_faults(view))
    estops = sum(event.mode == 'estop' for event in events)
    found = [text for text in (faults and f'faults that were reset: {faults}',
                               estops and f'e-stops, both ends counted: {estops}') if text]
    return '; '.join(found)


def _samples(view: View, lost: bool) -> str:
    """Return samples, late and skipped ones."""
    rows, period = view.rows, view.setting.period
    found = [counted(len(rows.seq), 'sample'), *(() if lost else ('none lost',))]
    state = view.timing.topics.get('state')
    if state is not None and state.late is not None:
        found.append(f'{counted(state.late, "period")} more than {LATE_TEXT} too long')
    if period is not None and view.setting.mode == 'realtime':
        found.append(f'{_skipped(view)} skipped')
    return ', '.join(found)


def _skipped(view: View) -> int:
    """Return the number of samples that a loop in real time never began."""
    rows, period = view.rows, view.setting.period
    if period is None or view.setting.mode != 'realtime':
        return 0
    steps = np.rint(np.diff(rows.t) / period) - np.diff(rows.seq)
    return int(steps[steps > 0].sum())


def _inactive(view: View) -> str:
    """Return the number of samples in which the law was not active."""
    count = int(np.count_nonzero(~view.rows.active))
    what = '1 sample, which counts' if count == 1 else f'{count} samples, which count'
    return f'the law was inactive in {what} for no share and no s/ε' if count else ''


def _guaranteed(view: View, found: Guarantee) -> str:
    """Return where the errors stayed, and whether that is promised."""
    share = view.metrics.omega_share
    if found.bounds is None or share is None:
        return found.statement
    (begin, end), t = view.metrics.window, view.rows.t
    unit = np.asarray(found.bounds) / view.widest
    within = (np.abs(view.rows.error) <= unit * view.epsilon[:, None]).all(axis=1)
    outside = np.flatnonzero(~within)       # samples without ε among them
    last = int(outside[-1]) + 1 if len(outside) else 0
    since = (f', from {t[last]:.4g} s on without a break' if share < 1.0 and last < len(t)
             and end - t[last] >= REST * (end - begin) else '')
    return (f'within Ω_ε in {100.0 * share:.4g} % of {begin:g} to {end:g} s{since}. '
            f'{"" if not found.broken else found.broken[0] + " "}{found.statement}')


def _uncovered(found: Guarantee) -> str:
    """Return that the run had a larger disturbance than the theorem's gain covers."""
    return (f'that promise is for a disturbance that k* covers: {found.covered.rstrip(".")}'
            if found.exceeded and not found.broken else '')
