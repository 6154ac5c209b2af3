# SPDX-License-Identifier: Apache-2.0
"""`dz bag`: what a recording holds, and a complete one out of one that was cut off."""

import hashlib
from pathlib import Path
import re

import numpy as np
import pytest

from dz_ros.cli.bag.recover import beside
from dz_ros.cli.main import main
from dz_ros.recording.reader import read_run


def fingerprint(run):
    """Return a hash of every file below a directory."""
    return {str(path.relative_to(run)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(run.rglob('*')) if path.is_file()}


@pytest.fixture
def recorded(tmp_path, capsys):
    run = tmp_path / 'run'
    assert main(['simulate', 'wang2004', '--duration', '4', '--record', str(run)]) == 0
    capsys.readouterr()
    return run


@pytest.fixture
def cut_off(recorded):
    (mcap,) = recorded.glob('*.mcap')
    size = mcap.stat().st_size
    with mcap.open('r+b') as file:
        file.truncate(size * 6 // 10)
    (recorded / 'metadata.yaml').unlink(missing_ok=True)
    return recorded


def table(text):
    """Return topic → numbers."""
    return {line.split()[0]: [int(number) for number in line.split()[2:]]
            for line in text.splitlines() if 'std_msgs/msg/' in line}


def test_info_counts_every_message(recorded, capsys):
    assert main(['bag', 'info', str(recorded)]) == 0
    text = capsys.readouterr().out
    found = table(text)
    assert set(found) == {'/reference', '/state', '/command', '/terms', '/truth', '/events'}
    assert found.pop('/events')[0] == 1     # the configuration
    for messages, size, *faults in found.values():
        assert messages == 801
        assert size > 801 * 40
        assert faults == [0, 0, 0, 0]
    assert 'complete' in text
    assert re.search(r'4\.000 s, 4006 messages', text)
    for known in ('plant: wang2004', 'law: wang2004', 'mode: offline'):
        assert known in text


def test_info_of_a_run_that_was_cut_off_reports_how_to_go_on(cut_off, capsys):
    assert main(['bag', 'info', str(cut_off)]) == 0
    text = capsys.readouterr().out
    assert 'cut off' in text
    assert f'dz bag recover {cut_off}' in text
    assert 0 < table(text)['/state'][0] < 801


def test_recover_keeps_what_there_was_and_leaves_the_source_alone(cut_off, tmp_path, capsys):
    before = fingerprint(cut_off)
    assert main(['bag', 'recover', str(cut_off)]) == 0
    text = capsys.readouterr().out
    target = tmp_path / 'run-recovered'
    assert str(target) in text
    assert 'note: ' in text
    assert fingerprint(cut_off) == before
    data, part = read_run(target), read_run(cut_off)
    assert 'cut' not in data.info
    for name, channel in part.channels.items():
        assert np.array_equal(channel.values, data.channels[name].values)
    assert table(text)['/state'][0] == len(data.channels['state'])
    assert main(['bag', 'recover', str(cut_off)]) == 2
    assert 'exists already' in capsys.readouterr().err
    assert main(['bag', 'recover', str(cut_off), str(tmp_path / 'other')]) == 0


@pytest.mark.parametrize('verb', ['info', 'recover'])
def test_what_is_no_run_is_one_line(verb, tmp_path, capsys):
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'text.mcap').write_text('no bag')
    for name in ('nowhere', 'empty', 'text.mcap'):
        assert main(['bag', verb, str(tmp_path / name)]) == 2
        out, err = capsys.readouterr()
        assert out == ''
        assert err.startswith('dz: error: ')
        assert err.count('\n') == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ['empty', 'text.mcap']


@pytest.mark.parametrize(('run', 'expected'), [
    ('runs/a', 'runs/a-word'), ('runs/a/', 'runs/a-word'), ('runs/a.b', 'runs/a.b-word'),
    ('runs/a/a_0.mcap', 'runs/a/a_0-word'), ('a.db3', 'a-word'),
])
def test_names_beside(run, expected, tmp_path):
    assert beside(tmp_path / run, 'word') == tmp_path / expected


def test_the_working_directory_has_a_name_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert beside(Path(), 'word') == tmp_path.with_name(f'{tmp_path.name}-word')
