# SPDX-License-Identifier: Apache-2.0
"""Runs to read and break."""

from __future__ import annotations

from collections.abc import Callable
import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.records import Command, Reference, State, Terms, Truth

START = 1_700_000_000_000_000_000
PERIOD = 5_000_000
LABELS = {'reference': Reference.labels(2), 'state': State.labels(2), 'command': Command.labels(),
          'terms': Terms.labels(('theta1', 'theta2', 'phi')), 'truth': Truth.labels()}

MakeRun = Callable[..., RunData]


@pytest.fixture
def make_run() -> MakeRun:
    """Return a maker of runs of this number of samples at 200 Hz, every number different."""

    def make(samples: int = 400, names: tuple[str, ...] = tuple(LABELS), seed: int = 0) -> RunData:
        generator = np.random.default_rng(seed)
        channels = {}
        for place, name in enumerate(names):
            labels = LABELS[name]
            values = generator.standard_normal((samples, len(labels)))
            values[:, 0] = np.arange(samples)
            values[:, 1] = np.arange(samples) * 0.005
            log = START + PERIOD * np.arange(samples) + 1000 * (place + 1)
            channels[name] = Channel(labels, values, log, log - 700)
        events = tuple((START + 10 * k, f'/node{k}', f'{{"node": "/node{k}", "event": "ä"}}')
                       for k in range(2))
        return RunData(channels, {'loop.rate': 200.0, 'plant.model': 'wang2004',
                                  'controller.law': 'pd', 'plant.x0': [-2.5, 3.5]},
                       {'mode': 'realtime', 'host': 'bench'}, events)

    return make


@pytest.fixture
def awkward() -> list[float]:
    """Return the doubles that writers and readers get wrong."""
    return [0.0, -0.0, 5e-324, -5e-324, 2.2250738585072014e-308, math.nextafter(1.0, 2.0),
            1.7976931348623157e308, -1.7976931348623157e308, math.inf, -math.inf, math.nan,
            0.1, 1 / 3, 2.0**53 + 2]


@pytest.fixture
def place(tmp_path: Path) -> Callable[[], Path]:
    """Return a maker of paths that do not exist yet, for tests that run a body many times."""
    counter = itertools.count()
    return lambda: tmp_path / f'run{next(counter)}'


@pytest.fixture
def same() -> Callable[..., None]:
    """Return what fails unless two runs hold the same bits."""

    def check(ours: RunData, theirs: RunData, *, publish: bool = True) -> None:
        assert list(ours.channels) == list(theirs.channels)
        for name, channel in ours.channels.items():
            other = theirs.channels[name]
            assert channel.labels == other.labels
            assert np.ascontiguousarray(channel.values).tobytes() == other.values.tobytes()
            assert channel.log_time.tolist() == other.log_time.tolist()
            if publish:
                assert channel.publish_time.tolist() == other.publish_time.tolist()
        assert ours.events == theirs.events

    return check
