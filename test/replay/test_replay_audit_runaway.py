# SPDX-License-Identifier: Apache-2.0
"""The audit lets the runaway guard decide again."""

from dataclasses import replace
import json

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.loop.controller import Controller, ViolationError
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.replay.audit.audit import audit

T = 0.005


def event(**details):
    return json.dumps({'node': '/controller_node', **details})


@pytest.fixture(scope='module')
def run():
    """Return the log of a controller that the guard stops, by itself and with the safe command."""
    c = Configuration.from_flat({
        'plant.model': 'servo', 'controller.law': 'robust', 'driver.name': 'mock',
        'driver.script': ['200- reversed'], 'trajectory.kind': 'sinusoid'})
    controller, device = Controller(c), c.make_driver()
    rows = {'reference': [], 'state': [], 'command': [], 'terms': []}
    events = [(1, '/controller_node', event(
        event='configuration', version='', owns=['controller', 'safety'], seq=0,
        configuration=c.to_flat(), set_aside=[], memory=list(controller.memory)))]
    stopped = False
    for k in range(420):
        device.advance(k * T, k)
        reference = Reference(k, k * T, c.trajectory(k * T))
        state = State(k, k * T, device.measure(), k - 1, (k - 1) * T)
        controller.set_reference(reference)
        try:
            command, terms = (controller.safe_answer(state) if stopped
                              else controller.respond(state))
        except ViolationError as error:
            stopped = True
            events.append((1 + k, '/controller_node', event(
                event='mode', mode='fault', earlier='running', cause='fault', reason=str(error))))
            command, terms = controller.safe_answer(state)
        device.command(command.v, k * T)
        for name, item in (('reference', reference), ('state', state), ('command', command),
                           ('terms', terms)):
            rows[name].append(item.numbers())
    assert stopped
    labels = {'reference': Reference.labels(2), 'state': State.labels(2),
              'command': Command.labels(), 'terms': Terms.labels(c.law.signal_names)}
    times = np.arange(420) + 1
    return RunData({name: Channel(labels[name], np.array(item), times, times)
                    for name, item in rows.items()}, c.to_flat(), {'mode': 'realtime'},
                   tuple(events))


def without(run, which):
    return replace(run, events=tuple(item for item in run.events if f'"{which}"' not in item[2]))


def test_a_stop_by_the_guard_is_repeated(run):
    result = audit(run)
    assert result.passed, result
    assert result.checked == 420


def test_a_stop_without_its_fault_is_found(run):
    result = audit(without(run, 'mode'))
    assert not result.passed
    assert any('stopped the recorded controller 0 times, and stops it 1 times here, first at seq'
               in text for text in result.findings), result.findings


def test_a_fault_that_the_states_do_not_show_is_found(run):
    longer = tuple((time, node, text.replace('"safety.runaway_time": 0.5',
                                             '"safety.runaway_time": 0.6'))
                   for time, node, text in run.events)
    result = audit(replace(run, events=longer))
    assert any('stopped the recorded controller 1 times, and stops it 0 times here' in text
               for text in result.findings), result.findings


def test_a_controller_that_went_on_is_found(run):
    shorter = tuple((time, node, text.replace('"safety.runaway_time": 0.5',
                                              '"safety.runaway_time": 0.2'))
                    for time, node, text in run.events)
    result = audit(replace(run, events=shorter))
    assert any('the recorded controller went on' in text for text in result.findings)


def test_a_recording_of_an_earlier_version_has_no_such_guard(run):
    earlier = tuple((time, node, text.replace('"safety.runaway_time": 0.5, ', ''))
                    for time, node, text in without(run, 'mode').events)
    assert earlier != run.events
    assert audit(replace(run, events=earlier)).passed
