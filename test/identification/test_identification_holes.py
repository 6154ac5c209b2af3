# SPDX-License-Identifier: Apache-2.0
"""Short holes in what an experiment measured are filled, longer ones are left."""

import dataclasses

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.identification.estimation.pipeline import identify
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.identification.experiment.session import run_session
from dz_ros.identification.samples import from_run, Samples, to_run

pytestmark = pytest.mark.slow

SERVO = {'plant.model': 'servo', 'plant.dead_zone.m_l': 0.8, 'plant.inertia': 1.25}


def moved(flat, repeats=4):
    c = Configuration.from_flat({**flat, 'loop.timing': 'lockstep'})
    experiment = Experiment(Limits(1.5, 1.0, 4.0), Plan(repeats=repeats), c.plant.order,
                            c.loop.period)
    return c, run_session(c, experiment, lambda seq: seq, lambda: ''), experiment.moving


class Blinking(SimulatedActuator):
    """Has no measurement in one of ten samples, or in the two after each other."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._random = np.random.default_rng(0)
        self._dark = 0

    def measure(self):
        if self._dark == 0 and self._random.random() < 0.1:
            self._dark = int(self._random.integers(1, 3)) + 1
        self._dark = max(0, self._dark - 1)
        return None if self._dark else super().measure()


def test_short_holes_of_an_experiment_hide_nothing():
    noisy = {**SERVO, 'plant.noise': [1e-3, 1e-2]}
    c, samples, margin = moved({**noisy, 'driver.name': f'{__name__}:Blinking'}, 8)
    dark = np.isnan(samples.x[:, 0])
    assert 0.08 < dark.mean() < 0.2
    filled = samples.without_short_holes()
    assert filled.filled > 0.99 * np.count_nonzero(dark)
    assert filled.x[~dark].tobytes() == samples.x[~dark].tobytes()
    found = identify(filled, c, margin)
    zone, b = c.dead_zone, c.plant.b
    truth = (zone.b_r, zone.b_l, b * zone.m_r, b * zone.m_l)
    assert [item.value for item in found.bounds.values()] == pytest.approx(truth, rel=0.03)
    assert all(item.low <= value <= item.high
               for item, value in zip(found.bounds.values(), truth, strict=True))
    # Read again from the recording, which keeps the holes, they are the same.
    run = to_run(samples, c, 0)
    assert len(run.channels['state']) == np.count_nonzero(~dark)
    again, kept = from_run(run, c), np.isfinite(filled.x[:, 0])
    assert again.x.tobytes() == filled.x[kept].tobytes()
    assert again.v.tolist() == pytest.approx(filled.v[kept].tolist())


def test_a_hole_beside_another_or_longer_than_that_is_left():
    _, samples, _ = moved(SERVO)
    x = samples.x.copy()
    x[300:305], x[400], x[500:503], x[504], x[-2] = np.nan, np.nan, np.nan, np.nan, np.nan
    kept = [row for row in range(len(x)) if row not in (600, 601)]
    holes = dataclasses.replace(
        samples, x=x[kept], seq=samples.seq[kept], v=samples.v[kept],
        repeat=samples.repeat[kept], kinds=tuple(samples.kinds[row] for row in kept))
    filled = holes.without_short_holes()
    dark = np.flatnonzero(np.isnan(filled.x[:, 0]))
    assert dark.tolist() == [*range(300, 305), len(x) - 2]
    assert np.diff(filled.seq).tolist() == [1] * (len(filled.seq) - 1)
    assert filled.x[[400, 500, 600]] == pytest.approx(samples.x[[400, 500, 600]], abs=1e-3)
    assert samples.without_short_holes() is samples


@pytest.mark.parametrize(('rate', 'filled'), [(20, 0), (50, 1), (60, 1), (200, 4), (1000, 20)])
def test_holes_of_twenty_milliseconds_are_filled_at_any_rate_and_no_longer_ones(rate, filled):
    t = np.arange(3 * rate) / rate
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(t), 1))
    clean = np.sin(t)[:, np.newaxis]
    x, begins = clean + noise, range(rate // 2, len(t) - rate // 2, rate // 4)
    for longer in (0, 1):
        holes = x.copy()
        for begin in begins:
            holes[begin:begin + filled + longer] = np.nan
        samples = Samples(np.arange(len(t)), holes, 0.0 * t, 0 * np.arange(len(t)),
                          ('rest',) * len(t), 1, 1.0 / rate)
        found = samples.without_short_holes()
        assert found.filled == (0 if longer else len(begins) * filled)
        if found.filled:        # no noisier than what was measured
            off = (found.x - clean)[np.isnan(holes)]
            assert np.sqrt(np.mean(off * off)) < 2.0e-3


@pytest.mark.parametrize('delay', [0, 1, 2, 3])
def test_what_acts_in_a_hole_is_known_from_the_arrivals(delay):
    c, seq = Configuration.from_flat(SERVO), np.arange(60)
    x = np.column_stack([np.sin(0.005 * seq), np.cos(0.005 * seq)])
    x[21:24] = np.nan
    samples = Samples(seq, x, (seq >= 20).astype(float), 0 * seq, ('step',) * 60, 2, 0.005)
    again = from_run(to_run(samples, c, 0), c, delay)
    assert again.filled == 3
    assert again.v == pytest.approx((seq >= 20 + delay).astype(float))
