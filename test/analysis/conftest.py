"""Runs to look at, without any recording: simulated, and dressed up as if sent over topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
import functools
import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.controller import Controller
from dz_ros.core.dataset import Channel, from_run, RunData
from dz_ros.core.loop import simulate
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.version import version

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


T = 0.005
BASE = {'loop.duration': 2.0}


class Log:
    """A log written as a recorder would, one message after the other, 100 µs apart."""

    def __init__(self, configuration, mode='realtime'):
        self.configuration, self.mode = configuration, mode
        self.rows = {name: [] for name in ('reference', 'state', 'command', 'terms')}
        self.events, self.now = [], 1_700_000_000_000_000_000

    def put(self, name, numbers):
        self.now += 100_000
        self.rows[name].append((self.now, tuple(map(float, numbers))))

    def announce(self, configuration, seq, memory, said=None):
        self.now += 100_000
        self.events.append((self.now, '/controller_node', json.dumps({
            'node': '/controller_node', 'event': 'configuration', 'version': said or version(),
            'owns': ['controller'], 'configuration': configuration.to_flat(), 'set_aside': [],
            'seq': seq, 'memory': list(memory)})))

    def data(self):
        order = self.configuration.plant.order
        labels = {'reference': Reference.labels(order), 'state': State.labels(order),
                  'command': Command.labels(),
                  'terms': Terms.labels(self.configuration.law.signal_names)}
        return RunData({name: Channel(labels[name], np.array([row for _, row in rows]),
                                      *[np.array([time for time, _ in rows])] * 2)
                        for name, rows in self.rows.items() if rows},
                       self.configuration.to_flat(), {'mode': self.mode}, tuple(self.events))


def real_time(samples=300, changes=(), restart=None, plant_restart=None, said=None, flat=BASE):
    """Return a real-time log with jitter, skipped periods, lost and repeated messages.

    Args:
        samples: States published.
        changes: (seq, overrides): gain changes.
        restart: State at which the controller is started anew.
        plant_restart: State at which the plant is started anew.
        said: Version the controller states.
        flat: Configuration.
    """
    generator = np.random.default_rng(7)
    configuration = Configuration.from_flat(flat)
    log, controller, count = Log(configuration), Controller(configuration), 0
    log.announce(configuration, 0, controller.memory, said)
    x, stamp, seq = list(configuration.x0), 0.0, 0
    changes = dict(changes)
    for k in range(samples):
        if k == restart:
            controller, count = Controller(configuration), 0
            log.announce(configuration, 0, controller.memory, said)
        if k == plant_restart:
            x, stamp, seq = list(configuration.x0), 0.0, 0
        if count in changes:
            configuration = configuration.replace(**changes.pop(count))
            controller.law = configuration.law
            log.announce(configuration, count, controller.memory, said)
        sample = round(stamp / T)
        meant = Reference(seq, sample * T, configuration.trajectory(sample * T))
        log.put('reference', meant.numbers())
        if k % 37 != 5 or not controller.has_reference:    # else it arrives too late
            controller.set_reference(meant)
        state = State(seq, stamp, tuple(x), count - 1, 0.0, 0.0)
        for _ in range(2 if k % 50 == 3 else 1):       # sent again: the same answer again
            log.put('state', state.numbers())
            if k % 41 == 11:                            # never reaches the controller
                continue
            command, terms = controller.respond(state)
            count = command.seq + 1
            log.put('command', (*command.numbers()[:-1], generator.uniform(0.0, 1e-3)))
            log.put('terms', terms.numbers())
        if k % 37 == 5:
            controller.set_reference(meant)
        skipped = {60: 1, 120: 2, 180: 5}.get(k, 0)
        stamp += T * (1 + skipped) + generator.normal(0.0, 5e-5)
        x[0] += T * x[1]
        x[1] += T * (command.v - x[0]) + generator.normal(0.0, 0.01)
        seq += 1
    return log.data()


def offline(**overrides):
    return from_run(simulate(Configuration.from_flat({**BASE, **overrides})))


def change(run, name, label, row, value):
    """Return the run with one number changed."""
    channel = run.channels[name]
    values = channel.values.copy()
    values[row, channel.labels.index(label)] = value
    return replace(run, channels={**run.channels, name: replace(channel, values=values)})


def drop(run, name, *rows):
    """Return the run without some messages."""
    channel = run.channels[name]
    keep = np.setdiff1d(np.arange(len(channel)), [row % len(channel) for row in rows])
    return replace(run, channels={**run.channels, name: Channel(
        channel.labels, channel.values[keep], channel.log_time[keep],
        channel.publish_time[keep])})


@pytest.fixture(scope='session')
def logs():
    """Return what makes logs: `real_time`, `offline`; and alters them: `change`, `drop`."""
    return SimpleNamespace(real_time=real_time, offline=offline, change=change, drop=drop)
