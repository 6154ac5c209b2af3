# SPDX-License-Identifier: Apache-2.0
"""`dz report`: page, five numbers, JSON; the recording itself stays as it is."""

import json
import re

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.cli.table import five_rows, format_table, metric_rows
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    run = tmp_path_factory.mktemp('report') / 'run'
    assert main(['simulate', 'wang2004', '--duration', '6', '--record', str(run)]) == 0
    return run


def numbers(text):
    return dict(re.findall(r'^  (.+?)  +([-\d.e]+)', text, re.MULTILINE))


@pytest.mark.slow
def test_report_lies_beside_the_run_and_shows_five_numbers(recorded, capsys):
    before = sorted((path.name, path.read_bytes()) for path in recorded.iterdir())
    assert main(['report', str(recorded)]) == 0
    text = capsys.readouterr().out
    page = recorded.with_name('run-report') / 'report.html'
    assert text.splitlines()[-1] == f'report: {page}'
    assert page.read_text(encoding='utf-8').startswith('<!')
    assert {'tracking.png', 'error_without.png', 'command_without.png'} <= {
        path.name for path in page.parent.iterdir()}
    assert sorted((path.name, path.read_bytes()) for path in recorded.iterdir()) == before
    run = simulate(Configuration.from_flat({'loop.duration': 6.0}))
    inside = run.t >= 3.0
    error = (run.x[:, 0] - run.x_d[:, 0])[inside]
    found = numbers(text)
    assert len(found) == 5
    assert float(found['max |x̃|']) == pytest.approx(np.abs(error).max(), rel=1e-3)
    assert float(found['total variation of v']) == pytest.approx(
        np.abs(np.diff(run.v[inside])).sum() / 3.0, rel=1e-3)
    assert found['messages missing, all topics'] == '0'
    assert found['periods within 1 ms of 5 ms'] == '-'    # offline there is no timing


@pytest.mark.slow
def test_json_is_for_programs_and_writes_nothing(recorded, tmp_path, capsys):
    assert main(['report', str(recorded), '--json', '--window', '1', '2']) == 0
    out, err = capsys.readouterr()
    assert err == ''
    found = json.loads(out)
    assert found['metrics']['window'] == [1.0, 2.0]
    assert found['plant'] == 'wang2004'
    assert found['metrics']['error_max'] > 0.0
    target = tmp_path / 'out'
    assert main(['report', str(recorded), '--json', '--out', str(target)]) == 0
    out, err = capsys.readouterr()
    json.loads(out)
    assert err == f'report: {target / "report.html"}\n'
    assert (target / 'report.html').is_file()


@pytest.mark.slow
def test_a_second_run_replaces_the_simulated_one(recorded, tmp_path, capsys):
    other = tmp_path / 'other'
    assert main(['simulate', 'wang2004', '--duration', '3', '--set',
                 'plant.dead_zone={b_r: 0, b_l: 0}', '--record', str(other)]) == 0
    assert main(['report', str(recorded), '--without-dead-zone', str(other), '--out',
                 str(tmp_path / 'a')]) == 0
    assert main(['report', str(other), '--out', str(tmp_path / 'b')]) == 0
    capsys.readouterr()
    assert (tmp_path / 'a' / 'error_without.png').is_file()
    assert not (tmp_path / 'b' / 'error_without.png').exists()    # it has no dead-zone itself


@pytest.mark.slow
def test_where_the_loop_without_dead_zone_diverges_the_rest_is_reported(
        recorded, tmp_path, capsys, monkeypatch):
    def diverge(view):
        raise OverflowError

    monkeypatch.setattr('dz_ros.cli.report.without_dead_zone', diverge)
    assert main(['report', str(recorded), '--out', str(tmp_path / 'a')]) == 0
    assert 'figures 5 and 6 are left out' in capsys.readouterr().err
    assert (tmp_path / 'a' / 'error.png').is_file()
    assert not (tmp_path / 'a' / 'error_without.png').exists()


@pytest.mark.parametrize('words', [
    ['nowhere'], ['RUN', '--window', '5', '1'], ['RUN', '--without-dead-zone', 'nowhere'],
    ['RUN', '--out', 'a file'], ['RUN', '--namespace', 'elsewhere'],
])
def test_mistakes_are_one_line_and_leave_nothing(words, recorded, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'a file').write_text('')
    words = [str(recorded) if word == 'RUN' else word for word in words]
    out = [] if '--out' in words else ['--out', 'out']
    assert main(['report', *words, *out]) == 2
    printed, err = capsys.readouterr()
    assert printed == ''
    assert err.startswith('dz: error: ')
    assert err.count('\n') == 1
    assert [path.name for path in tmp_path.iterdir()] == ['a file']


@pytest.mark.slow
def test_a_run_that_was_cut_off_is_reported(recorded, tmp_path, capsys):
    (source,) = recorded.glob('*.mcap')
    part = tmp_path / 'part.mcap'
    part.write_bytes(source.read_bytes()[:source.stat().st_size * 7 // 10])
    assert main(['report', str(part)]) == 0
    out, err = capsys.readouterr()
    assert 'note: the run was cut off' in err
    assert f'report: {tmp_path / "part-report" / "report.html"}' in out


def test_tables_align_and_carry_units():
    from dz_ros.report.view import View
    run = simulate(Configuration.from_flat({'plant.model': 'servo', 'loop.duration': 2.0}))
    view = View.of(from_run(run))
    text = format_table('title', metric_rows(view))
    lines = [line.replace('\N{COMBINING TILDE}', '') for line in text[1:]]
    ends = {re.match(r'  .+?  +[-\d.e+]+(?=  |$)', line).end() for line in lines}
    assert len(ends) == 1
    assert any(line.endswith('rad') for line in lines)
    assert any(line.endswith('A/s') for line in lines)
    rows = five_rows(view)
    assert len(rows) == 5
    assert rows[0][2] == 'rad'
