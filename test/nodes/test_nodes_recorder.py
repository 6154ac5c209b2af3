# SPDX-License-Identifier: Apache-2.0
"""The recorder in a running loop, while its disk fills up, its run disappears, or it is killed."""

from contextlib import suppress
import itertools
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import sys
import time

import pytest

from dz_ros.errors import DzRosError
from dz_ros.recording.reader import read_run
from dz_ros.recording.recover import recover

pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('ros_domain')]

DZ = (sys.executable, '-m', 'dz_ros')
PROGRESS = 't  '
PATIENT = tuple(word for key, value in {
    'loop.duration': 0, 'safety.state_hold': 200, 'safety.command_hold': 100,
    'safety.echo_limit': 200, 'safety.fault_after': 2000}.items()
    for word in ('--set', f'{key}={value}'))
"""A loop without end that a machine which others use as well does not bring into fault."""


def goes_on(run, lines=3):
    """Wait for further lines of progress of `dz run`, which come once a second."""
    seen = run.output.count(PROGRESS)
    run.wait_for_line(PROGRESS, nth=seen + lines)


def wait_for_messages(run, folder, timeout=180.0):
    """Wait until messages of a run that is being recorded can be read: a chunk is on the disk."""
    deadline = time.monotonic() + timeout
    for attempt in itertools.count():
        with suppress(DzRosError):
            if recover(run, folder / f'attempt{attempt}').messages:
                return
        assert time.monotonic() < deadline, 'the recorder writes no chunk'
        time.sleep(0.05)


def test_a_disk_that_fills_up_and_is_freed_costs_nothing(processes, small_disk, none_missing):
    disk = small_disk('4m')
    filler = disk.fill(left=60_000)
    run = processes(*disk.enter, *DZ, 'run', *PATIENT, '--record', disk.path / 'run')
    line = run.wait_for_line('cannot be written: No space left on device')
    assert 'ERROR' in line
    assert 'recorder_node' in line
    assert '16 MB wait in memory' in line
    goes_on(run)
    filler.unlink()
    assert 'messages lost meanwhile: 0' in run.wait_for_line('is written again')
    goes_on(run, 1)
    assert run.interrupt() == 0, run.output
    assert 'none missing' in run.output
    data = read_run(disk.outside / 'run')
    assert 'cut' not in data.info
    for name, channel in data.channels.items():
        assert none_missing(channel), name


def test_a_disk_that_stays_full_is_named_and_what_it_holds_kept(processes, small_disk, tmp_path):
    disk = small_disk('200k')
    run = processes(*disk.enter, *DZ, 'run', *PATIENT, '--record', disk.path / 'run')
    run.wait_for_line('cannot be written: No space left on device')
    goes_on(run)
    assert run.interrupt() == 2, run.output
    assert 'Traceback' not in run.output
    assert 'none missing' not in run.output
    written, lost = map(int, re.search(r'(\d+) messages in .*, (\d+) lost; the recording is not '
                                       'complete', run.output).groups())
    assert lost > 0
    assert recover(disk.outside / 'run', tmp_path / 'whole').messages == written > 0
    assert [item.name for item in (disk.outside / 'run').iterdir()] == ['run_0.mcap']


def test_a_disk_full_from_the_start_is_one_line(processes, small_disk):
    disk = small_disk('100k')
    disk.fill(left=0)
    run = processes(*disk.enter, *DZ, 'run', *PATIENT, '--record', disk.path / 'run')
    assert run.wait() == 2
    assert 'Traceback' not in run.output
    assert 'recorder_node: error: ' in run.output
    assert 'No space left on device' in run.output
    assert not (disk.outside / 'run').exists()


def test_a_run_that_is_removed_is_reported_at_once_and_can_be_saved(processes, tmp_path):
    run = processes(*DZ, 'run', *PATIENT, '--record', tmp_path / 'run')
    goes_on(run, 2)
    shutil.rmtree(tmp_path / 'run')
    line = run.wait_for_line('was removed while it was recorded')
    words = shlex.split(line[line.index('dz bag recover'):].partition(';')[0])
    saved = recover(Path(words[3]), tmp_path / 'saved')
    assert f'{saved.messages} messages are lost' in line
    goes_on(run)
    assert run.interrupt() == 2, run.output
    assert 'Traceback' not in run.output
    assert re.search(r'0 messages in .*/run, [1-9]\d* lost; the recording is not complete',
                     run.output)
    assert not (tmp_path / 'run').exists()


@pytest.mark.parametrize('what', ['directory', 'file'])
def test_a_run_that_is_moved_is_reported_and_recorded_where_it_is_now(processes, tmp_path, what,
                                                                      none_missing):
    run = processes(*DZ, 'run', *PATIENT, '--record', tmp_path / 'run')
    goes_on(run, 1)
    if what == 'directory':
        (tmp_path / 'run').rename(tmp_path / 'moved')
    else:
        (tmp_path / 'moved').mkdir()
        (tmp_path / 'run/run_0.mcap').rename(tmp_path / 'moved/renamed.mcap')
    line = run.wait_for_line('was moved to')
    assert line.endswith(f'moved to {tmp_path}/moved while it was recorded; the recording goes on '
                         'there')
    goes_on(run, 1)
    assert run.interrupt() == 0, run.output
    assert f'messages in {tmp_path}/moved, none missing' in run.output
    assert (tmp_path / 'moved/metadata.yaml').exists()
    data = read_run(tmp_path / 'moved')
    assert 'cut' not in data.info
    assert none_missing(data.channels['state'])


def test_metadata_that_cannot_be_written_is_one_line(processes, tmp_path):
    run = processes(*DZ, 'run', *PATIENT, '--record', tmp_path / 'run')
    goes_on(run, 1)
    (tmp_path / 'run/metadata.yaml.tmp').mkdir()
    assert run.interrupt() == 2, run.output
    assert 'metadata.yaml cannot be written' in run.output
    assert 'Traceback' not in run.output
    written = int(re.search(r'(\d+) messages in .*, 0 lost; the recording is not complete',
                            run.output)[1])
    assert recover(tmp_path / 'run', tmp_path / 'whole').messages == written


@pytest.mark.parametrize(('number', 'meaning'), [
    (signal.SIGKILL, 'killed by SIGKILL'), (signal.SIGINT, 'ended before the plant')])
def test_a_recorder_that_ends_does_not_end_the_loop(processes, children, tmp_path, number,
                                                    meaning):
    run = processes(*DZ, 'run', *PATIENT, '--record', tmp_path / 'run')
    goes_on(run, 1)
    wait_for_messages(tmp_path / 'run', tmp_path)
    os.kill(children(run, 4)['recorder_node'], number)
    assert 'the loop goes on' in run.wait_for_line(f'recorder_node has ended ({meaning})')
    goes_on(run)
    assert run.interrupt() == 1, run.output
    assert f'recorder_node failed ({meaning})' in run.output
    assert recover(tmp_path / 'run', tmp_path / 'whole').messages > 0


def test_a_recorder_that_is_stopped_holds_up_neither_the_loop_nor_its_end(processes, children,
                                                                          tmp_path):
    run = processes(*DZ, 'run', *PATIENT, '--record', tmp_path / 'run')
    goes_on(run, 1)
    os.kill(children(run, 4)['recorder_node'], signal.SIGSTOP)
    goes_on(run)
    assert run.interrupt() == 0, run.output
    assert ' messages in ' in run.output
    assert 'cut' not in read_run(tmp_path / 'run').info


@pytest.mark.parametrize('target', ['/dev/full', 'a pipe without a reader'])
def test_output_that_cannot_be_written_does_not_end_the_loop(processes, tmp_path, target):
    words = shlex.join([*DZ, 'run', *PATIENT, '--duration', '2', '--record',
                        str(tmp_path / 'run')])
    end = '> /dev/full' if target == '/dev/full' else '| true'
    run = processes('sh', '-c', f'({words}; echo code $? >&2) {end}')
    run.wait()
    assert 'code 0' in run.output, run.output
    assert 'Traceback' not in run.output
    assert read_run(tmp_path / 'run').channels['state']['stamp'][-1] > 1.9


@pytest.mark.parametrize('verb', ['run', 'replay'])
def test_a_killed_verb_leaves_no_file_behind(processes, children, tmp_path, run, verb):
    (tmp_path / 'temporary').mkdir()
    words = ('run', *PATIENT) if verb == 'run' else ('bag', 'replay', run, '--loop')
    started = processes(*DZ, *words, TMPDIR=str(tmp_path / 'temporary'))
    nodes = children(started, 3 if verb == 'run' else 1)
    if verb == 'run':
        started.wait_for_line(PROGRESS)
    started.signal(signal.SIGKILL)
    started.wait()
    deadline = time.monotonic() + 60.0
    while any(Path(f'/proc/{pid}').exists() for pid in nodes.values()):
        assert time.monotonic() < deadline, 'a node goes on without its verb'
        time.sleep(0.05)
    assert list((tmp_path / 'temporary').iterdir()) == []
