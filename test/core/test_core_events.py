# SPDX-License-Identifier: Apache-2.0
"""Events: typed from texts of any origin, refused by cause, kept where newer than this version."""

from dataclasses import replace
import json
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.core import events
from dz_ros.core.events import (
    ConfigurationEvent,
    EventError,
    FinishedEvent,
    LatencyEvent,
    ModeEvent,
    OtherEvent,
    parse,
    RepeatEvent,
    StoppedEvent,
)

TEXTS = st.text(st.characters(codec='utf-8', exclude_categories=('Cs',)), max_size=30)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner,
                                                                max_size=4), max_leaves=12)
FIELDS = sorted({item for kind in events.KINDS.values() for item in kind.__dataclass_fields__})


@settings(deadline=None)
@given(st.text() | JSON.map(json.dumps) | st.dictionaries(
    st.sampled_from([*FIELDS, 'event', 'other key']), JSON | st.sampled_from(
        [*events.KINDS, 10 ** 400, 2 ** 53, -2, 1e308]), max_size=8).map(json.dumps))
def test_any_text_is_an_event_or_refused_by_cause(text):
    try:
        event = parse(text)
    except EventError as error:
        refused = error
    else:
        again = parse(event.to_json())
        assert again == event or 'NaN' in event.to_json()
        event.to_json().encode()
        return
    assert refused.cause in events.CAUSES
    assert '\n' not in str(refused)


@pytest.mark.parametrize(('text', 'cause'), [
    ('[' * 100_000, events.TOO_DEEP),
    ('{"event": "mode", "a": ' + '[' * 100_000 + ']' * 100_000 + '}', events.TOO_DEEP),
    ('{"event": "x", "a": ' + '[' * 9 + ']' * 9 + '}', events.TOO_DEEP),
    ('{"event": "mode", "a": "' + 'x' * (1 << 20) + '"}', events.TOO_LONG),
    ('{"event": "mode"', events.NOT_JSON),
    ('{"event": "x", "a": 1' + '0' * 5000 + '}', events.NOT_JSON),
    ('{"event": "x", "reason": "\\ud800"}', events.NOT_UNICODE),
    ('[1]', events.NOT_AN_EVENT),
    ('{"node": "/n"}', events.NOT_AN_EVENT),
    ('{"event": "mode", "node": 3}', events.NOT_AN_EVENT),
    (json.dumps({'event': 'mode', 'node': 'n' * 300}), events.NOT_AN_EVENT),
    ('{"event": "stopped", "ends": 5}', events.WRONG_TYPE),
    ('{"event": "stopped", "ends": [5]}', events.WRONG_TYPE),
    ('{"event": "configuration", "configuration": [1]}', events.WRONG_TYPE),
    ('{"event": "configuration", "seq": 1e308}', events.WRONG_TYPE),
    ('{"event": "configuration", "seq": 1.5}', events.WRONG_TYPE),
    ('{"event": "configuration", "seq": true}', events.WRONG_TYPE),
    ('{"event": "configuration", "memory": ["1"]}', events.WRONG_TYPE),
    ('{"event": "mode", "reason": {}}', events.WRONG_TYPE),
])
def test_refused_by_cause(text, cause):
    with pytest.raises(EventError) as refused:
        parse(text)
    assert refused.value.cause == cause


@pytest.mark.parametrize('event', [
    ConfigurationEvent('/c', {'controller.lambda': 2.0}, ('controller',), 7, (0.5, 1e-17), '1.0',
                       'rmw', ('plant.a',)),
    ModeEvent('/c', 'fault', 'running', 'fault', 'no state'),
    StoppedEvent('/p', ('state',), 3, {'not finite': 2}),
    FinishedEvent('/p', ('command',)),
    LatencyEvent('/p', 'round trip', 3, 1, 0, 0.001, None, None, 0.5, (0.001, None), (2, 1)),
    RepeatEvent('identify', -1, 12),
    OtherEvent('/n', 'from tomorrow', more={'x': [1, {'y': None}]}),
])
def test_there_and_back(event):
    assert parse(event.to_json()) == event


@settings(deadline=None)
@given(TEXTS, st.lists(st.floats(allow_nan=False), max_size=5).map(tuple))
def test_numbers_and_texts_survive_bit_for_bit(reason, memory):
    assert parse(ModeEvent('/n', reason=reason).to_json()).reason == reason
    found = parse(ConfigurationEvent('/n', memory=memory).to_json()).memory
    assert [math.copysign(1.0, item) for item in found] == [
        math.copysign(1.0, item) for item in memory]
    assert found == memory


@pytest.mark.parametrize('configuration', [{}, {'plant.model': 'a"}', 'loop.rate': 200.0}])
@pytest.mark.parametrize('more', [{}, {'trajectory.times': [0.0, 1.0]}])
def test_a_configuration_is_completed_by_text(configuration, more):
    event = ConfigurationEvent('/plant_node', configuration, ('plant',), 3, (1.0,))
    text = event.to_json_with(json.dumps(more)[1:-1])
    assert parse(text) == replace(event, configuration={**configuration, **more})


def test_what_other_versions_publish_is_kept():
    newer = parse('{"node": "/n", "event": "mode", "mode": "lost", "axis": [1, 2]}')
    assert (newer.mode, newer.more) == ('lost', {'axis': [1, 2]})
    assert json.loads(newer.to_json())['axis'] == [1, 2]
    older = parse('{"node": "/c", "event": "configuration", "configuration": {"loop.rate": 9}}')
    assert (older.owns, older.memory, older.seq) == (None, None, 0)
    made = events.make('mode', '/n', {'mode': 'lost', 'axis': 3})
    assert made == ModeEvent('/n', 'lost', more={'axis': 3})


def test_events_of_a_run_are_those_that_are_events():
    texts = ((1, '', 'no JSON'), (2, '/a', '{"event": "mode", "mode": "lost"}'),
             (3, '/b', '{"event": "stopped", "ends": 1}'),
             (4, '/b', '{"event": "finished", "node": "/b"}'))
    assert [(time, event.kind, event.node) for time, event in events.typed(texts)] == [
        (2, 'mode', '/a'), (4, 'finished', '/b')]
    assert not list(events.of_kind(texts, StoppedEvent))
