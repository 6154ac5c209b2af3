# SPDX-License-Identifier: Apache-2.0
"""``dz simulate``: the offline loop; its samples to a CSV file, its run to a recording."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
import sys
import time

import numpy as np

from dz_ros.cli.offline import simulate_machine
from dz_ros.cli.options import (
    add_configuration,
    read_machine,
    refuse_existing,
    require_folder,
)
from dz_ros.cli.output import print_lines, whole_file, write_csv
from dz_ros.cli.progress import stage
from dz_ros.cli.table import format_table, metric_rows, window_title
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.offline import Run
from dz_ros.core.signals import TERM_NAMES
from dz_ros.errors import ConfigurationError
from dz_ros.report.view import View
from dz_ros.runs.axes import each_axis, named_axis


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--csv', metavar='FILE',
                        help='write every sample: k, t, the true state, the reference, v, w, the '
                             "law's signals, its terms; - is the standard output")
    parser.add_argument('--record', type=Path, metavar='DIR',
                        help='write the run as a recording that dz and rosbag2 read')


def run(arguments: argparse.Namespace) -> int:
    """Simulate; write what was asked for; print the metrics."""
    configuration = read_machine(arguments)
    to_stdout = arguments.csv == '-'
    csv = None if arguments.csv is None or to_stdout else Path(arguments.csv)
    if csv is not None:
        refuse_existing(csv, 'file')
        require_folder(csv)
    if arguments.record is not None:
        refuse_existing(arguments.record)
        if csv is not None and csv.resolve() == arguments.record.resolve():
            raise ConfigurationError('--csv', str(csv), 'must not be the directory of --record')
    done = simulate_machine(configuration)
    data = named_axis(from_runs(done, configuration, time.time_ns()), arguments.axis)
    if arguments.record is not None:
        from dz_ros.recording.save import save_run, state_configuration

        memory = [number for item in configuration.each for number in item.law.initial_memory()]
        with stage(f'writing {arguments.record}'):
            save_run(state_configuration(data, memory), arguments.record)
    if csv is not None:
        file = csv.open('x', encoding='ascii', newline='')
        with whole_file(csv), file, stage(f'writing {csv}'):
            write_csv(all_columns(done), file)
    if to_stdout:
        write_csv(all_columns(done), sys.stdout)
    for name, run in each_axis(data).items():
        with stage('computing the metrics'):
            view = View.of(run)
        title = window_title(view)
        print_lines(format_table(f'axis {name}: {title}' if name else title, metric_rows(view)),
                    file=sys.stderr if to_stdout else sys.stdout)
    return 0


def all_columns(runs: Mapping[str, Run]) -> dict[str, np.ndarray]:
    """Return the CSV's columns of all axes: k and t once, the others as ``yaw.v``."""
    found: dict[str, np.ndarray] = {}
    for axis, run in runs.items():
        found.update((name if name in ('k', 't') or not axis else f'{axis}.{name}', values)
                     for name, values in columns(run).items())
    return found


def columns(run: Run) -> dict[str, np.ndarray]:
    """Return the CSV's columns by name: k, t, x…, xd…, v, w, the law's signals, its terms."""
    order = run.x.shape[1]
    return {
        'k': np.arange(len(run.t)), 't': run.t,
        **{f'x{i}': run.x[:, i] for i in range(order)},
        **{f'xd{i}': run.x_d[:, i] for i in range(order + 1)},
        'v': run.v,
        'w': run.truth[:, 0],
        **{name: run.column(name) for name in run.configuration.law.signal_names},
        **{name: run.column(name) for name in TERM_NAMES},
    }
