# SPDX-License-Identifier: Apache-2.0
"""``dz doctor`` on this machine, and on ones that permit nothing or fail."""

import json

import pytest

from dz_ros.cli import doctor
from dz_ros.cli.main import main
from dz_ros.runtime.privileges import usable_cores


@pytest.mark.slow
def test_the_doctor_measures_what_is_permitted(capsys):
    assert main(['doctor', '--seconds', '0.1', '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['machine']['cores'] == str(len(usable_cores()))
    assert found['idle']['as any process']['ticks'] == 20
    assert 'as any process' in found['busy']
    for name, measured in found['idle'].items():
        assert 0.0 <= measured['p50'] <= measured['p99'] <= measured['max']
        assert (name in found['busy']) is not bool(measured['refused'])


def test_a_summary_is_of_the_ticks():
    assert doctor.summary([0.0, 1e-4, 2e-4, 3e-3]) == {
        'p50': 2e-4, 'p99': 3e-3, 'max': 3e-3, 'late': 1, 'ticks': 4}


def measured(p99, refused=()):
    return {'refused': list(refused), 'p50': 1e-5, 'p99': p99, 'max': p99, 'late': 0, 'ticks': 20}


def printed(monkeypatch, capsys, answers):
    """Return what the doctor prints where measurements give these answers, one a set-up."""
    monkeypatch.setattr(doctor, 'measure', lambda words, _: answers[bool(words)])
    assert main(['doctor', '--seconds', '0.1']) == 0
    return capsys.readouterr().out


def test_a_machine_that_permits_nothing_gets_one_line_of_advice(monkeypatch, capsys):
    out = printed(monkeypatch, capsys, {False: measured(1e-4),
                                        True: measured(1e-4, ['SCHED_FIFO 50'])})
    advice = [line for line in out.splitlines() if 'limits.conf' in line]
    assert len(advice) == 1
    assert out.count('  refused') == 8
    assert 'times as punctual' not in out


def test_what_helps_is_named_with_what_it_helps(monkeypatch, capsys):
    out = printed(monkeypatch, capsys, {False: measured(1e-3), True: measured(1e-4)})
    assert 'makes the ticks 10.0 times as punctual' in out


def test_what_does_not_help_is_not_recommended(monkeypatch, capsys):
    assert 'leave them off' in printed(monkeypatch, capsys, {False: measured(1e-4),
                                                             True: measured(9e-5)})


@pytest.mark.parametrize('seconds', ['0', '-1', '1e9', 'nan'])
def test_an_odd_length_is_refused_in_one_line(seconds, capsys):
    assert main(['doctor', '--seconds', seconds]) == 2
    assert 'must be from 0.1' in capsys.readouterr().err
