# SPDX-License-Identifier: Apache-2.0
"""``dz arena --ros``: chosen runs of the comparison through ROS nodes, held against the loop.

Each is the loop as processes in lockstep, recorded, read back and compared bit for bit with the
same configuration offline. `controller.override_checks` is set: a comparison also runs what the
design rules advise against.
"""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

import numpy as np

from dz_ros.cli.processes import check_rclpy
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, RunData
from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import write_parameters
from dz_ros.recording.reader import read_run
from dz_ros.studies.arena import Plan

COMPARED = {'state': 'x', 'command': 'v', 'terms': ''}
"""Channel → how the labels begin that are compared; '' = all of the law's own numbers."""
DIFFERENT = 1


def compare_with_ros(plan: Plan, quiet: bool = False) -> int:
    """Run the first member of every entrant in every scenario; return 1 where a bit differs.

    Raises:
        MissingDependencyError: rclpy is not installed.
    """
    check_rclpy()
    failed = 0
    for (entrant, scenario, member), flat in plan.configurations().items():
        if member:
            continue
        configuration = Configuration.from_flat(
            {**flat, 'loop.timing': 'lockstep', 'controller.override_checks': True})
        verdict = compare_one(configuration, quiet)
        failed += bool(verdict)
        print(f'{entrant}, {scenario}: {verdict or "equal, bit for bit"}', flush=True)
    return DIFFERENT if failed else 0


def compare_one(configuration: Configuration, quiet: bool = False) -> str:
    """Return what differs between a run through ROS and one offline; '' = nothing."""
    with tempfile.TemporaryDirectory(prefix='dz_ros-') as folder:
        file, recording = Path(folder) / 'parameters.yaml', Path(folder) / 'run'
        write_parameters(configuration, file)
        done = subprocess.run(
            [sys.executable, '-m', 'dz_ros', 'run', str(file), '--quiet', '--record',
             str(recording)], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, check=False)
        if not quiet and done.returncode:
            print(done.stdout, file=sys.stderr, end='')
        if done.returncode:
            return f'dz run failed with exit code {done.returncode}'
        return difference(read_run(recording), from_run(simulate(configuration)))


def difference(through_ros: RunData, offline: RunData) -> str:
    """Return the first number that differs, as text; '' = none does."""
    for name, begin in COMPARED.items():
        found, wanted = through_ros.channels.get(name), offline.channels[name]
        if found is None:
            return f'{name} was not recorded'
        # What waits for its answer for long is sent again: each message has its own sample.
        seq = found['seq']
        known = np.unique(seq)
        # The last sample has no successor: a loop that ends may leave its command out.
        if len(known) < len(wanted) - 1 or not np.array_equal(known, np.arange(len(known))):
            return f'{name} has {len(known)} of {len(wanted)} samples'
        rows = np.flatnonzero(seq < len(wanted))
        sample = seq[rows].astype(np.int64)
        for label in wanted.labels:
            if not label.startswith(begin) or label in _OF_TRANSPORT:
                continue
            place = _first_difference(found[label][rows], wanted[label][sample])
            if place is not None:
                return (f'{name}.{label} differs from sample {sample[place]} on: '
                        f'{found[label][rows[place]]!r} instead of '
                        f'{wanted[label][sample[place]]!r}')
    return ''


_OF_TRANSPORT = frozenset({'seq', 'stamp', 'echo_seq', 'echo_stamp', 'round_trip', 'hold'})


def _first_difference(found: Any, wanted: Any) -> int | None:
    differing = np.flatnonzero(~((found == wanted) | (np.isnan(found) & np.isnan(wanted))))
    return int(differing[0]) if len(differing) else None
