# SPDX-License-Identifier: Apache-2.0
"""What takes long shows on standard error what it does; nothing is shown to programs."""

import re
import threading

import pytest

from dz_ros.cli import progress
from dz_ros.cli.main import main
from dz_ros.cli.progress import Progress, silence, stage


@pytest.fixture(autouse=True)
def _received():
    yield
    silence(False)


class Slow:
    """`threading` as a stage sees it where everything takes long: its line is due at once."""

    class Event:
        def __init__(self):
            self._set = False

        def set(self):
            self._set = True

        def wait(self, _limit):
            passed, self._set = self._set, True
            return passed

    class Thread:
        ident = None

        def __init__(self, target, daemon):
            self.start = target


@pytest.fixture
def slow(monkeypatch):
    monkeypatch.setattr(progress, 'threading', Slow)


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """Return a recording, and its table as a CSV file beside it."""
    folder = tmp_path_factory.mktemp('progress')
    run = folder / 'run'
    assert main(['simulate', 'wang2004', '--duration', '12', '--record', str(run),
                 '--csv', str(folder / 'table.csv')]) == 0
    return run


VERBS = {
    'info': ('bag info {run}', ['reading {run}']),
    'audit': ('bag audit {run}', ['reading {run}', 'recomputing samples']),
    'export': ('bag export {run} --out {out}', ['reading {run}', 'joining samples',
                                                'writing {out}']),
    'compare': ('bag compare {run} {run} --out {out}', ['reading {run}', 'computing the metrics',
                                                        'drawing pictures']),
    'recover': ('bag recover {run} {out}', ['reading {run}, writing {out}']),
    'import': ('bag import {csv} --out {out} --config wang2004 --map stamp=t,x0=x0,x1=x1,v=v',
               ['reading {csv}', 'converting', 'writing {out}']),
    'whatif': ('bag whatif {run} --set controller.epsilon=0.03 --out {out}', [
        'reading {run}', 'simulating 12 s', 'comparing, drawing pictures']),
    'fit': ('bag whatif {run} --fit --out {out}', ['fitting the plant']),
    'identify': ('driver identify --from {run} --out {out}', ['reading {run}',
                                                              'finding the dead-zone']),
    'report': ('report {run} --out {out}', [
        'reading {run}', 'computing the metrics', 'simulating the run without dead-zone',
        'drawing pictures']),
    'simulate': ('simulate wang2004 --duration 2 --record {out}', [
        'simulating 2 s, 400 samples', 'writing {out}', 'computing the metrics']),
    'check': ('check wang2004', ['searching the largest λ of a calm loop']),
    'certify': ('certify wang2004 --duration 2', ['enclosing the loop for each delay']),
    'tune': ('tune wang2004 --duration 2', ['simulating candidates']),
    'doctor': ('doctor --seconds 0.1', ['measuring an idle machine', 'measuring a busy machine']),
}
PROGRAMS = {
    'audit': 'bag audit {run} --json', 'report': 'report {run} --json --out {out}',
    'compare': 'bag compare {run} {run} --json --out {out}', 'check': 'check wang2004 --json',
    'certify': 'certify wang2004 --duration 2 --json',
    'tune': 'tune wang2004 --duration 2 --json', 'doctor': 'doctor --seconds 0.1 --json'}


@pytest.mark.slow
@pytest.mark.parametrize('verb', VERBS)
def test_a_verb_that_takes_long_shows_what_it_does(verb, run, slow, tmp_path, capsys):
    if verb == 'certify':
        pytest.importorskip('flint', reason='python-flint is not installed')
    words, stages = VERBS[verb]
    names = {'run': str(run), 'csv': str(run.with_name('table.csv')), 'out': str(tmp_path / 'o')}
    main([item.format(**names) for item in words.split()])
    err = capsys.readouterr().err
    assert 'dz: error' not in err or verb == 'identify', err
    for text in stages:
        assert f'{text.format(**names)}' in err, err


@pytest.mark.slow
@pytest.mark.parametrize('verb', PROGRAMS)
def test_a_program_that_reads_json_is_shown_nothing(verb, run, slow, tmp_path, capsys):
    if verb == 'certify':
        pytest.importorskip('flint', reason='python-flint is not installed')
    names = {'run': str(run), 'out': str(tmp_path / 'o')}
    main([item.format(**names) for item in PROGRAMS[verb].split()])
    err = capsys.readouterr().err
    assert [line for line in err.splitlines() if not line.startswith(('report:', 'comparison:'))
            ] == []


def test_a_stage_shows_itself_with_what_is_done_and_how_long_it_took(monkeypatch, capfd):
    monkeypatch.setattr(progress, 'NOTICED', 0.01)
    monkeypatch.setattr(progress, 'INTERVAL', 0.01)
    monkeypatch.setattr(progress, 'TICK', 0.01)
    seen = ''
    with stage('reading runs/a') as step:
        for _ in range(60_000):
            seen += capfd.readouterr().err
            if re.search(r'reading runs/a: \d+ s', seen):
                step(5, 10, '')
            if 'reading runs/a: 5 of 10, about' in seen:
                break
            threading.Event().wait(0.001)
    seen += capfd.readouterr().err
    assert re.search(r'reading runs/a: 5 of 10, about \d+ s left\n', seen)
    assert re.fullmatch(r'reading runs/a: \d+ s', seen.splitlines()[-1])
    assert not [item for item in threading.enumerate() if 'show' in item.name]


def test_a_short_stage_shows_nothing_and_passes_errors_on(capfd):
    with pytest.raises(ZeroDivisionError), stage('dividing'):
        _ = 1 / 0
    assert capfd.readouterr().err == ''


def test_on_a_terminal_a_line_takes_the_place_of_the_last_one(monkeypatch, capsys):
    monkeypatch.setattr('sys.stderr.isatty', lambda: True, raising=False)
    counted = Progress(200)
    counted.resume(100)
    counted(101, 200, 'a long word')
    counted(200, 200)
    first, *lines = capsys.readouterr().err.split('\r')[1:]
    assert first == '0 of 200 runs, time left unknown'
    assert lines[0].startswith('101 of 200 runs, about')
    assert lines[0].endswith('(a long word)')
    assert lines[1].startswith('200 of 200 runs, ')
    assert len(lines[1].rstrip('\n')) == len(lines[0])
    assert lines[1].endswith('\n')
    silence(True)
    counted(100, 200)
    assert capsys.readouterr().err == ''


def test_elsewhere_the_last_line_is_always_there_and_others_are_rare(capsys):
    counted = Progress(3)
    for done in (1, 2, 3):
        counted(done, 3)
    assert re.fullmatch(r'([12] of 3 runs, .*\n)?3 of 3 runs, \d+ s\n', capsys.readouterr().err)


class Timers(list):
    """Takes the place of `threading.Timer`: runs what it was given when a test asks for it."""

    def __call__(self, _seconds, function, arguments):
        self.append(lambda: function(*arguments))
        return threading.Thread()


def test_elsewhere_the_first_line_does_not_wait_for_the_first_run(monkeypatch, capsys):
    timers = Timers()
    monkeypatch.setattr(progress.threading, 'Timer', timers)
    counted = Progress(3)
    for place in (0, 1):        # as long as no run has ended
        timers[place]()
        assert capsys.readouterr().err == (
            '0 of 3 runs, time left unknown (starting, compiling: 0 s)\n')
    counted(3, 3)
    assert capsys.readouterr().err == '3 of 3 runs, 0 s\n'
    timers[2]()
    assert capsys.readouterr().err == ''
    counted = Progress(3)
    del counted                     # as after an error
    timers[3]()
    assert capsys.readouterr().err == ''
