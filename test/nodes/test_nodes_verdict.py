# SPDX-License-Identifier: Apache-2.0
"""The end of `dz run`: one verdict, exit code 1 for a latched fault, 0 for a planned end."""

import json
import os
import re
import signal

import pytest

pytest.importorskip('rclpy', reason='needs rclpy')

pytestmark = pytest.mark.ros
DZ = ('-m', 'dz_ros')


@pytest.fixture
def run(processes, ros_domain, patient):
    def start(*words, script=()):
        return processes(*DZ, 'run', 'servo', '--quiet', *patient, '--set', 'driver.name=mock',
                         '--set', f'driver.script={json.dumps(list(script))}', *map(str, words))
    return start


@pytest.mark.parametrize('recorded', [False, True])
def test_a_latched_fault_fails_the_run(run, tmp_path, recorded):
    loop = run('--duration', '2', *(('--record', tmp_path / 'run') if recorded else ()),
               script=('200- fault over-temperature',))
    assert loop.wait() == 1
    verdict = next(line for line in loop.output.splitlines() if line.startswith('verdict: '))
    assert verdict.startswith('verdict: FAILED: ')
    assert 'ended in a latched fault' in verdict
    assert 'over-temperature' in verdict
    assert ('dz report' in loop.output.splitlines()[-1])


def test_a_planned_end_is_no_failure(run, tmp_path):
    loop = run('--duration', '1', '--record', tmp_path / 'run')
    assert loop.wait() == 0, loop.output
    lines = loop.output.splitlines()
    # A busy machine may have skipped samples, which the line then adds.
    first = next(n for n, line in enumerate(lines) if line.startswith('verdict: no failure'))
    assert lines[first + 1] == '  planned end; recording complete'
    assert lines[-1] == f'next: dz report {tmp_path / "run"}'
    assert any('max |x̃|' in line for line in lines[first:])


@pytest.mark.parametrize('recorded', [False, True])
def test_a_node_that_was_killed_fails_the_run(processes, children, ros_domain, tmp_path, patient,
                                              recorded):
    loop = processes(*DZ, 'run', 'servo', *patient, '--duration', '600',
                     *(('--record', tmp_path / 'run') if recorded else ()))
    found = children(loop, 3 + recorded)
    loop.wait_for_line(' s   error ')
    os.kill(found['trajectory_node'], signal.SIGKILL)
    assert loop.wait() == 1, loop.output
    verdict = next(line for line in loop.output.splitlines() if line.startswith('verdict: '))
    assert verdict.startswith('verdict: FAILED: trajectory_node failed (killed by SIGKILL)')


def test_samples_that_the_recorder_lost_fail_the_run(processes, children, ros_domain, tmp_path,
                                                     patient):
    loop = processes(*DZ, 'run', 'wang2004', *patient, '--set', 'loop.rate=500', '--set',
                     'safety.state_hold=500', '--set', 'safety.command_hold=250',
                     '--duration', '600', '--record', tmp_path / 'run')
    recorder = children(loop, 4)['recorder_node']
    loop.wait_for_line(' s   error ')

    def time():
        return float(re.findall(r'^t +([\d.]+) s', loop.output, re.MULTILINE)[-1])

    begin, line = time(), 1
    os.kill(recorder, signal.SIGSTOP)
    while time() < begin + 10.0:    # 5000 samples; publishers keep 1000
        line += 1
        loop.wait_for_line(' s   error ', nth=line)
    os.kill(recorder, signal.SIGCONT)
    loop.wait_for_line(' s   error ', nth=line + 2)
    assert loop.interrupt() == 1, loop.output
    verdict = next(item for item in loop.output.splitlines() if item.startswith('verdict: '))
    assert verdict.startswith('verdict: FAILED: samples lost: ')
    assert re.search(r'\d+ of state', verdict)
