# SPDX-License-Identifier: Apache-2.0
"""The latched guard of `robust` is released while the law runs, reported with seq and memory."""

import dataclasses
import json

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.core.safety.controller_guard import ControllerGuard
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.replay.audit.audit import audit


def test_reset_while_running_is_announced_and_the_audit_follows_it():
    # Steeper and later than the law is made for: the guard fires.
    c = Configuration.from_flat({'controller.law': 'robust', 'plant.b': 2.5, 'loop.delay': 2,
                                 'loop.timing': 'lockstep', 'loop.duration': 6.0})
    begins = []
    guard = ControllerGuard(c, begins=lambda seq, memory: begins.append((seq, memory)))
    guard.transition('configure')
    guard.transition('activate')
    plant = SimulatedActuator(c.driver_parameters, c)
    rows = {name: [] for name in ('state', 'reference', 'command', 'terms')}
    kappa = c.law.signal_names.index('kappa_f')
    seen, reset_at = [], 800
    for k in range(1200):
        t = k * c.loop.period
        plant.advance(t, k)
        state = State(k, t, plant.measure())
        reference = Reference(k, t, tuple(c.trajectory(t)))
        guard.reference(reference.numbers(), t)
        taken = guard.take(state.numbers(), t)
        if k == reset_at:
            before = seen[-1]
            assert guard.reset(t) == ''
            assert begins[-1][0] == reset_at    # the first command it holds for
        command, terms = guard.answer(taken, t)
        plant.command(command.v, t)
        seen.append(terms.signals[kappa])
        for name, record in (('state', state), ('reference', reference), ('command', command),
                             ('terms', terms)):
            rows[name].append(record.numbers())
    assert before < 1.0                         # it had fired
    assert seen[reset_at] == 1.0
    assert {'kappa_f', 'gain', 'epsilon', 'v_integral'} <= {*c.law.signal_names}
    labels = {'state': State.labels(2), 'reference': Reference.labels(2),
              'command': Command.labels(), 'terms': Terms.labels(c.law.signal_names)}
    times = (np.arange(1200) * 5_000_000).astype(np.int64)
    events = tuple((int(times[seq]), 'controller_node', json.dumps({
        'node': 'controller_node', 'event': 'configuration', 'owns': ['controller', 'safety'],
        'configuration': c.to_flat(), 'seq': seq, 'memory': list(memory)}))
        for seq, memory in begins)
    run = RunData({name: Channel(labels[name], np.array(rows[name]), times, times)
                   for name in rows}, c.to_flat(), {'mode': 'lockstep'}, events)
    result = audit(run)
    assert result.passed, result
    assert len(result.spans) == 2
    # Without the event the audit finds that the memory changed by itself.
    assert not audit(dataclasses.replace(run, events=events[:1])).passed


def test_a_law_that_has_nothing_latched_reports_it():
    c = Configuration.from_flat({'controller.law': 'wang2004'})
    assert ControllerGuard(c).reset(0.0) == 'nothing is latched'
