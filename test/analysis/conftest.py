"""Runs to look at, without any recording: simulated, and dressed up as if sent over topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
import functools
from typing import Any

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, from_run, RunData
from dz_ros.core.loop import simulate

Simulated = Callable[..., RunData]

EPOCH = 1_700_000_000_000_000_000
LATENCY = 400_000
"""Nanoseconds from publishing a state to publishing its command."""


@functools.cache
def _simulated(items: tuple[tuple[str, Any], ...]) -> RunData:
    return from_run(simulate(Configuration.from_flat(dict(items))))


@pytest.fixture(scope='session')
def simulated() -> Simulated:
    """``simulated({'controller.law': 'pd'})``: an offline run; equal ones are made once."""
    def make(overrides: Mapping[str, Any] | None = None) -> RunData:
        return _simulated(tuple((key, tuple(value) if isinstance(value, list) else value)
                                for key, value in (overrides or {}).items()))
    return make


@pytest.fixture(scope='session')
def over_topics() -> Callable[..., RunData]:
    """``over_topics(run, late={seq: ns})``: the run with the times a real-time loop would have.

    Every topic is published T apart, the command LATENCY after its state, each logged 100 µs
    later; `late` delays the state of a sample, and what follows from it, by so many ns.
    """
    def dress(run: RunData, late: Mapping[int, int] | None = None) -> RunData:
        count = len(run.channels['state'])
        ticks = EPOCH + np.round(np.arange(count) * 1e9
                                 / run.configuration['loop.rate']).astype(np.int64)
        for seq, delay in (late or {}).items():
            ticks[seq] += delay
        after = {'reference': -1_000_000, 'state': 0, 'truth': 20_000, 'command': LATENCY,
                 'terms': LATENCY + 30_000}
        channels = {}
        for name, channel in run.channels.items():
            values = channel.values.copy()
            if name == 'command':
                values[:, channel.labels.index('hold')] = 0.5e-9 * LATENCY
            if name == 'state':
                values[1:, channel.labels.index('round_trip')] = 1.5e-9 * LATENCY
            published = ticks + after[name]
            channels[name] = Channel(channel.labels, values, published + 100_000, published)
        return replace(run, channels=channels, info={'mode': 'realtime', 'host': 'bench'})
    return dress


@pytest.fixture(scope='session')
def keep() -> Callable[..., RunData]:
    """``keep(run, state=rows, command=rows)``: the run with these rows of these channels only."""
    def cut(run: RunData, **rows: Any) -> RunData:
        channels = dict(run.channels)
        for name, chosen in rows.items():
            old = channels[name]
            channels[name] = Channel(old.labels, old.values[chosen], old.log_time[chosen],
                                     old.publish_time[chosen])
        return replace(run, channels=channels)
    return cut
