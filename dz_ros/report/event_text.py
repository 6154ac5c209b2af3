# SPDX-License-Identifier: Apache-2.0
"""Events of a run as sentences; a kind that is not known is shown by its fields."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import singledispatch
from typing import Any

from dz_ros.core.events import (
    ActionEvent,
    ConfigurationEvent,
    Event,
    EventError,
    LatencyEvent,
    ModeEvent,
    parse,
    RepeatEvent,
    StartedEvent,
    StoppedEvent,
    UnmeasuredEvent,
)

LONGEST = 300
"""Letters of a sentence; a recording may hold events of any length."""


def event_text(text: str) -> str:
    """Return an event's text as a sentence, what is no event as it is."""
    with suppress(EventError):
        text = sentence(parse(text))
    return text if len(text) <= LONGEST else f'{text[:LONGEST]}…'


@singledispatch
def sentence(event: Event) -> str:
    """Return what happened, as a sentence; the node is named beside it."""
    return ': '.join(filter(None, (event.kind, _pairs(event.more))))


@sentence.register
def _(event: ConfigurationEvent) -> str:
    made = ', '.join(filter(None, (event.version and f'dz_ros {event.version}', event.rmw)))
    aside = f'; set aside: {", ".join(event.set_aside)}' if event.set_aside else ''
    return (f'Runs {len(event.configuration)} configuration keys from sample {event.seq} on'
            f'{f" ({made})" if made else ""}{aside}.')


@sentence.register
def _(event: ModeEvent) -> str:
    earlier = f' after {event.earlier}' if event.earlier else ''
    why = event.reason or event.cause
    return f'Changed to mode {event.mode}{earlier}{f": {why}" if why else ""}.'


@sentence.register
def _(event: StartedEvent) -> str:
    return f"Started the loop's clock at {event.stamp:g} s."


@sentence.register
def _(event: StoppedEvent) -> str:      # FinishedEvent too
    done = 'Finished' if event.kind == 'finished' else 'Stopped'
    last = f' after sample {event.seq}' if event.seq is not None else ''
    ends = f'; nothing follows on {", ".join(event.ends)}' if event.ends else ''
    taken = [f'not taken, {what}: {_pairs(given)}' for what, given in (
        ('states and commands', event.ignored), ('references', event.ignored_references)) if given]
    return '; '.join((f'{done}{last}{ends}', *taken)) + '.'


@sentence.register
def _(event: LatencyEvent) -> str:
    times = [f'{name} {1e3 * value:.3f} ms' for name, value in (
        ('median', event.p50), ('p99', event.p99), ('largest', event.max)) if value is not None]
    return (f'Counted {event.count} delays of {event.hop or "a hop"}: {event.late} late, '
            f'{event.too_late} too late{"; " if times else ""}{", ".join(times)}.')


@sentence.register
def _(event: ActionEvent) -> str:
    target = f' of {event.target}' if event.target else ''
    values = f' ({_pairs(event.values)})' if event.values else ''
    end = 'done' if event.done else 'refused'
    came = f', {event.message}' if event.message else ''
    return f'{event.by or "An operator"} asked for {event.action}{target}{values}: {end}{came}.'


@sentence.register
def _(event: RepeatEvent) -> str:
    return (f'Began repeat {event.repeat}' if event.repeat >= 0 else 'Paused between repeats'
            ) + f' at sample {event.seq}.'


@sentence.register
def _(event: UnmeasuredEvent) -> str:
    spans = ', '.join(' to '.join(map(str, sorted(set(span)))) for span in event.ranges)
    return (f'Had no measurement in {event.samples} samples{f" ({spans})" if spans else ""}'
            f'{f": {event.reason}" if event.reason else ""}.')


def _pairs(given: Mapping[str, Any]) -> str:
    """Return keys and values of a mapping, what is empty left out."""
    return ', '.join(f'{key} {value}' for key, value in given.items() if value not in ([], {}, ''))
