# SPDX-License-Identifier: Apache-2.0
"""Recordings made by an earlier version: still read, audited bit for bit, same metrics."""

import json
from pathlib import Path

import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.events import ActionEvent, ConfigurationEvent, of_kind, parse
from dz_ros.errors import ConfigurationError
from dz_ros.recording.reader import read_run

FOLDER = Path(__file__).parent / 'data' / 'recordings'
EXPECTED = json.loads((FOLDER / 'expected.json').read_text(encoding='utf-8'))


@pytest.mark.parametrize('name', sorted(EXPECTED))
def test_the_audit_reproduces_every_number(name, capsys):
    assert main(['bag', 'audit', str(FOLDER / name), '--json']) == 0
    found, expected = json.loads(capsys.readouterr().out), EXPECTED[name]
    assert found['differences'] == 0
    assert found['passed']
    assert {key: found[key] for key in ('samples', 'checked', 'compared')} == {
        key: expected[key] for key in ('samples', 'checked', 'compared')}
    assert [[span['first'], span['law']] for span in found['spans']] == expected['spans']


@pytest.mark.parametrize('name', sorted(EXPECTED))
def test_the_metrics_are_those_of_then(name, capsys):
    assert main(['report', str(FOLDER / name), '--json']) == 0
    found = json.loads(capsys.readouterr().out)['metrics']
    for key, value in EXPECTED[name]['metrics'].items():
        assert found[key] == (None if value is None else pytest.approx(value, rel=1e-12)), key


@pytest.mark.parametrize('name', sorted(EXPECTED))
def test_earlier_names_are_read_as_the_present_ones(name):
    assert b'plant.kick' in next((FOLDER / name).glob('*.mcap')).read_bytes()
    run = read_run(FOLDER / name)
    stated = [event.configuration for _, event in of_kind(run.events, ConfigurationEvent)]
    assert run.configuration['plant.disturbance_pulse'] == [0.0, 0.0, 0.0]
    assert any('plant.disturbance_pulse' in item for item in stated)
    for flat in (run.configuration, *stated):
        assert 'plant.kick' not in flat
    assert Configuration.from_untrusted(run.configuration).set_aside == ()


def test_an_earlier_action_is_read_as_the_present_one():
    event = parse('{"node": "/live_node", "event": "action", "action": "kick", "by": "a", '
                  '"values": {"plant.kick": [1, 2, 3]}}')
    assert isinstance(event, ActionEvent)
    assert event.action == 'disturbance_pulse'
    assert event.values == {'plant.disturbance_pulse': [1, 2, 3]}


def test_an_earlier_key_that_is_typed_names_the_present_one():
    with pytest.raises(ConfigurationError, match=r'is called plant\.disturbance_pulse now'):
        Configuration.from_flat({'plant.kick': [0.0, 0.0, 0.0]})
