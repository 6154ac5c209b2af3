# SPDX-License-Identifier: Apache-2.0
"""How fast sweeps are reported to be: compilation is left out wherever it happens."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import pytest

BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'
COMPILING, RATE = 5.0, 140.0


@pytest.mark.parametrize(('jobs', 'cluster'), [(1, None), (2, None), (1, 'tcp://somewhere')])
def test_compiling_is_left_out(jobs, cluster, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(BENCHMARKS)
    sweeps = importlib.import_module('sweeps')
    now, compiled = [0.0], []

    def run_sweep(plan, _out, jobs, cluster):
        """Take the time that a sweep takes; only processes of its own compile each time."""
        if not compiled or (jobs > 1 and cluster is None):
            now[0] += COMPILING
        compiled.append(jobs)
        now[0] += len(plan) / RATE

    monkeypatch.setattr(sweeps, 'run_sweep', run_sweep)
    monkeypatch.setattr(sweeps, 'time', SimpleNamespace(perf_counter=lambda: now[0]))
    assert sweeps.throughput(jobs, 1000, tmp_path, cluster) == pytest.approx(RATE)
