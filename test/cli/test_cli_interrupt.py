# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C at any instant: one line, exit code 130, no traceback, no process left behind."""

import os
from pathlib import Path
import re
import shlex
import signal
import subprocess
import sys
import time

import pytest

import dz_ros
from dz_ros.cli.verbs import VERBS

ROOT = str(Path(dz_ros.__file__).parents[1])
TIME_OUT = 300.0
"""A machine that is busy with other things is slow [s]."""
LONG = {
    'arena': ['arena', '--duration', '2000', '-j', '2'],
    'sweep': ['sweep', 'wang2004', '--over', 'controller.lambda=1:10:2000', '--out', 'a.csv',
              '-j', '2'],
    'tune': ['tune', 'wang2004', '--duration', '5000'],
    'simulate': ['simulate', 'wang2004', '--duration', '5000'],
}


def start(words, folder, imported='dz_ros.cli.main', **environment):
    """Start dz; return the process once it has imported a module."""
    printed = (folder / 'stderr.txt').open('w')      # a pipe that is not read would hold it up
    process = subprocess.Popen(
        [sys.executable, '-X', 'importtime', '-m', 'dz_ros', *words], cwd=folder,
        stdout=subprocess.PIPE, stderr=printed, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),   # of a job in background
        env={**os.environ, 'PYTHONPATH': ROOT, **environment})
    wanted = re.compile(rf'^import time:.*\| *{re.escape(imported)}$', re.MULTILINE)
    for _ in waiting(process, 0.001, f'{imported} was not imported'):
        if wanted.search((folder / 'stderr.txt').read_text()):
            return process


def waiting(process, period, what):
    """Yield once in a period [s] while a process runs; fail if it ends, or takes too long."""
    deadline = time.monotonic() + TIME_OUT
    while process.poll() is None:
        yield
        assert time.monotonic() < deadline, what
        time.sleep(period)
    raise AssertionError(f'{what}: exit code {process.returncode}')


def interrupt(process, group, folder):
    """Send Ctrl-C to the process, or as a terminal does to its group; return what it printed."""
    if process.poll() is None:
        (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=TIME_OUT)
    err = (folder / 'stderr.txt').read_text()
    return out, ''.join(line for line in err.splitlines(True)
                        if not line.startswith('import time:'))


def of_session(leader):
    """Return the processes of a session that still run."""
    found = []
    for entry in Path('/proc').glob('[0-9]*'):
        try:
            fields = (entry / 'stat').read_text().rpartition(')')[2].split()
        except OSError:
            continue
        if int(fields[3]) == leader and fields[0] != 'Z':
            found.append(entry.name)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(('imported', 'delay', 'group'), [
    ('dz_ros.runtime.import_path', 0.0, True), ('argparse', 0.0, False), ('numpy', 0.0, True),
    ('dz_ros.core.laws', 0.5, True), ('dz_ros.core.laws', 2.0, False)])
@pytest.mark.parametrize('verb', LONG)
def test_an_interrupt_is_one_line(verb, imported, delay, group, tmp_path):
    process = start(LONG[verb], tmp_path, imported)
    time.sleep(delay)       # the instant is the input of this test, not something waited for
    assert process.poll() is None
    out, err = interrupt(process, group, tmp_path)
    assert process.returncode == 130, err
    lines = [line for line in err.splitlines() if 'dz: interrupted' in line]
    assert len(lines) == 1, err
    assert err.splitlines()[-1] == lines[0]
    assert 'Traceback' not in out + err
    deadline = time.monotonic() + TIME_OUT
    while left := of_session(process.pid):
        assert time.monotonic() < deadline, left
        time.sleep(0.02)


def test_an_interrupt_inside_an_exec_of_text_ends_with_the_code_too(tmp_path):
    # Dataclasses are made so; with -m Python itself would then end the process by the signal.
    (tmp_path / 'interrupted.py').write_text(
        'import sys, dz_ros.cli.main as m, dz_ros.__main__ as d\n'
        'm._run = lambda words: exec("raise KeyboardInterrupt")\nsys.exit(d.main())\n')
    done = subprocess.run(
        [sys.executable, '-m', 'interrupted'], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, 'PYTHONPATH': f'{tmp_path}{os.pathsep}{ROOT}'})
    assert (done.returncode, done.stdout) == (130, ''), done.stderr
    assert done.stderr.startswith('dz: interrupted')
    assert done.stderr.count('\n') == 1


def test_an_interrupt_ends_with_its_code_even_where_the_end_of_python_would_crash(tmp_path):
    # As it can after an interrupt while code was being compiled.
    program = ('import atexit, os, sys, dz_ros.cli.main as m, dz_ros.__main__ as d\n'
               'class HalfMade:\n'
               '    def __del__(self, crash=os.abort):\n'
               '        crash()\n'
               'def work(words):\n'
               '    print("half done")\n'
               '    sys.half_made = HalfMade()\n'
               '    atexit.register(print, "tidied up")\n'
               '    raise KeyboardInterrupt("nothing is kept")\n'
               'm._run = work\nsys.exit(d.main())\n')
    done = subprocess.run([sys.executable, '-c', program], cwd=tmp_path, capture_output=True,
                          text=True, check=False, env={**os.environ, 'PYTHONPATH': ROOT})
    assert (done.returncode, done.stdout) == (130, 'half done\ntidied up\n'), done.stderr
    assert done.stderr == 'dz: interrupted: nothing is kept\n'


@pytest.mark.parametrize('verb', ['simulate', 'tune'])
def test_interrupts_while_it_ends_change_nothing(verb, tmp_path):
    process = start(LONG[verb], tmp_path, 'dz_ros.core.laws')
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.001)
    out, err = interrupt(process, False, tmp_path)
    assert process.returncode == 130, err
    assert 'Traceback' not in out + err
    assert err.splitlines()[-1].startswith('dz: interrupted')


def test_the_processes_of_doctor_leave_the_interrupt_to_it(tmp_path):
    process = start(['doctor', '--seconds', '5'], tmp_path, 'dz_ros.core.percentiles')
    found = []
    for _ in waiting(process, 0.01, 'nothing was measured'):
        found = [int(pid) for task in Path(f'/proc/{process.pid}/task').iterdir()
                 for pid in (task / 'children').read_text().split()]
        if found:
            break
    out, err = interrupt(process, True, tmp_path)
    assert process.returncode == 130, err
    assert 'Traceback' not in out + err
    deadline = time.monotonic() + TIME_OUT
    while any(of_session(pid) for pid in found):    # each leads a session of its own
        assert time.monotonic() < deadline, found
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.parametrize(('imported', 'delay', 'path'), [
    ('argparse', 0.0, ('simulate',)),       # before any verb is known
    *(('dz_ros.cli.main', delay, path) for delay in (0.0, 0.1) for path in sorted(VERBS))])
def test_no_verb_shows_a_traceback_while_it_starts(path, imported, delay, ros_domain, tmp_path):
    # Examples that name files which are not there end by themselves, with one line.
    words = [] if path == ('completion',) else shlex.split(VERBS[path].example)
    process = start([*path, *words], tmp_path, imported)
    time.sleep(delay)
    out, err = interrupt(process, True, tmp_path)
    assert 'Traceback' not in out + err, err
    if delay == 0.0:
        assert process.returncode == 130, (out, err)
        assert err.splitlines()[-1].startswith('dz: interrupted'), err
    for _ in range(500):
        if not of_session(process.pid):
            break
        time.sleep(0.02)
    assert not of_session(process.pid)


@pytest.mark.slow
def test_a_sweep_on_a_cluster_ends_at_once_and_leaves_the_cluster_usable(cluster, tmp_path):
    address, workers = cluster
    sweep = ['sweep', 'wang2004', '--duration', '20', '--cluster', address, '--over']
    for rows in (0, 2):
        table = tmp_path / f'{rows}.csv'
        process = start([*sweep, 'controller.lambda=1:10:20000', '--out', table.name], tmp_path)
        for _ in waiting(process, 0.01, 'no rows'):     # head and fingerprint are two lines
            if table.exists() and table.read_text().count('\n') >= 2 + rows:
                break
        _, err = interrupt(process, True, tmp_path)
        assert process.returncode == 130, err
        assert 'Traceback' not in err
        assert re.fullmatch(r'dz: interrupted: \d+ of 20000 runs are kept; the same command goes '
                            'on', err.splitlines()[-1]), err
        assert not of_session(process.pid)
        assert [worker.poll() for worker in workers] == [None, None]     # they are not its own
    done = subprocess.run([sys.executable, '-m', 'dz_ros', *sweep, 'controller.lambda=1:2:4',
                           '--out', 'whole.csv'], cwd=tmp_path, capture_output=True,
                          text=True, timeout=TIME_OUT, check=False,
                          env={**os.environ, 'PYTHONPATH': ROOT})
    assert done.returncode == 0, done.stderr
    assert (tmp_path / 'whole.csv').read_text().count('\n') == 2 + 4


@pytest.mark.slow
def test_a_sweep_names_what_is_kept(tmp_path):
    process = start([*LONG['sweep'], '--duration', '1'], tmp_path, NUMBA_DISABLE_JIT='1')
    sizes = set()       # of the file: its head, then a batch of rows each, counted before the next
    for _ in waiting(process, 0.02, 'no rows'):
        if (tmp_path / 'a.csv').exists():
            sizes.add((tmp_path / 'a.csv').stat().st_size)
        if len(sizes) > 4:
            break
    _, err = interrupt(process, True, tmp_path)
    last = err.splitlines()[-1]
    assert last.endswith('of 2000 runs are kept; the same command goes on'), err
    assert not last.startswith('dz: interrupted: 0 of')


def test_an_error_that_an_interrupt_was_turned_into_is_still_an_interrupt():
    """`from _ssl import …` made a TypeError of one, in the middle of making its own error."""
    program = ('import signal\n'
               'from dz_ros.cli.interrupt import prompt_end\n'
               'for interrupted in (False, True):\n'
               '    try:\n'
               '        with prompt_end(lambda: "all is kept"):\n'
               '            try:\n'
               '                signal.raise_signal(signal.SIGINT) if interrupted else 0\n'
               '            except KeyboardInterrupt:\n'
               '                pass\n'
               '            raise TypeError("expected a message argument")\n'
               '    except BaseException as error:\n'
               '        print(repr(error), flush=True)\n')
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          timeout=TIME_OUT, check=False, env={**os.environ, 'PYTHONPATH': ROOT})
    assert done.stdout.splitlines()[0] == "TypeError('expected a message argument')", done.stderr
    # Where the machine stalls the watching thread ends the process, with the same words.
    assert "KeyboardInterrupt('all is kept')" in done.stdout or (
        done.stderr == 'dz: interrupted: all is kept\n'), (done.stdout, done.stderr)
