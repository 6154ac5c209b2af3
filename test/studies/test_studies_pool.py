# SPDX-License-Identifier: Apache-2.0
"""Tasks of a study on processes and on a cluster: few in flight, none lost."""

import os
import signal
import subprocess
import sys
import tracemalloc

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.errors import MissingDependencyError
from dz_ros.studies import pool
from dz_ros.studies import sweep as module
from dz_ros.studies.sweep import run_sweep
from dz_ros.studies.sweep_plan import parse_axes, SweepPlan

BASE = Configuration.from_flat({'loop.duration': 2.0, 'plant.substeps': 1,
                                'plant.noise': [0.0, 0.0]}).to_flat()


def test_without_dask_the_cluster_is_refused(monkeypatch):
    monkeypatch.setattr(pool, 'find_spec', lambda name: None)
    with pytest.raises(MissingDependencyError, match=r'dz_ros\[cluster\]'):
        list(pool.execute([(abs, (-1,))], cluster='tcp://127.0.0.1:1'))


class Counted:
    """Tasks without end in sight, and how many of them are begun and not handed on."""

    def __init__(self, count, function=abs):
        self.taken = self.handed = self.most = 0
        self._count, self._function = count, function

    def __iter__(self):
        for place in range(self._count):
            self.taken += 1
            self.most = max(self.most, self.taken - self.handed)
            yield self._function, (-place,)

    def collect(self, **how):
        found = []
        for result in pool.execute(self, **how):
            self.handed += 1
            found.append(result)
        return found


@pytest.mark.parametrize('jobs', [1, 2])
def test_few_tasks_are_in_flight_and_every_result_comes_once(jobs):
    tasks = Counted(200)
    assert sorted(tasks.collect(jobs=jobs)) == [(place, place) for place in range(200)]
    assert tasks.most <= pool.AHEAD * jobs


def test_results_are_forgotten_when_they_are_handed_on():
    tasks = ((bytes, (1_000_000,)) for _ in range(60))
    tracemalloc.start()
    try:
        assert sum(len(result) for _, result in pool.execute(tasks, 2)) == 60_000_000
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_what_was_begun_last_is_not_begun_first():
    # One job: strictly in order; the first results come before the last tasks are made.
    seen = []
    for place, _ in pool.execute(((seen.append, (item,)) for item in range(9)), 1):
        assert seen == list(range(place + 1))


def test_results_carry_their_place():
    assert sorted(pool.execute([(abs, (-place,)) for place in range(5)], 1)) == [
        (place, place) for place in range(5)]


@pytest.mark.slow
def test_a_killed_worker_loses_no_result(cluster, tmp_path, monkeypatch):
    address, workers = cluster
    monkeypatch.setattr(module, 'CHUNK', 1)
    monkeypatch.setattr(pool, 'SCHEDULER_TIMEOUT', 60)
    plan = SweepPlan(BASE, parse_axes(['controller.epsilon=0.01:0.05:12']))
    killed = []

    def kill_one(done, _total, _what):
        if done >= 3 and not killed:
            os.kill(workers[0].pid, signal.SIGKILL)
            killed.append(done)

    run_sweep(plan, tmp_path / 'cluster.csv', cluster=address, progress=kill_one)
    assert killed
    assert workers[0].wait() == -signal.SIGKILL
    run_sweep(plan, tmp_path / 'here.csv', 1)
    assert (tmp_path / 'cluster.csv').read_bytes() == (tmp_path / 'here.csv').read_bytes()


@pytest.mark.slow
def test_few_tasks_are_in_flight_on_a_cluster(cluster):
    tasks = Counted(60)
    assert sorted(tasks.collect(cluster=cluster[0])) == [(place, place) for place in range(60)]
    assert tasks.most <= pool.AHEAD * 2


def test_no_scheduler_is_one_line():
    pytest.importorskip('distributed', reason='dask.distributed is not installed: no cluster')
    code = ('import dz_ros.studies.pool as pool, sys; pool.SCHEDULER_TIMEOUT = 1\n'
            'from dz_ros.errors import ConfigurationError\n'
            'try: list(pool.execute([(abs, (1,))], cluster="tcp://127.0.0.1:9"))\n'
            'except ConfigurationError as error: sys.exit("no scheduler" not in str(error))\n'
            'sys.exit(3)')
    assert subprocess.run([sys.executable, '-c', code], timeout=300, check=False,
                          capture_output=True).returncode == 0
