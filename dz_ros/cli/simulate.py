"""``dz simulate``: the loop off line; its samples to a CSV file, its run to a recording."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import sys
import time
from typing import TextIO

import numpy as np

from dz_ros.analysis.view import View
from dz_ros.cli.offline import simulate_offline
from dz_ros.cli.options import add_configuration, read_configuration
from dz_ros.cli.table import format_table, metric_rows, window_title
from dz_ros.core.dataset import from_run
from dz_ros.core.loop import Run
from dz_ros.errors import ConfigurationError, RunExistsError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--csv', metavar='FILE',
                        help='write every sample: k, t, the true state, the reference, v, w, the '
                             'estimates, s, s_eps; - is the standard output')
    parser.add_argument('--record', type=Path, metavar='DIR',
                        help='write the run as a recording that dz and rosbag2 read')


def run(arguments: argparse.Namespace) -> int:
    """Simulate; write what was asked for; print the metrics."""
    configuration = read_configuration(arguments)
    to_stdout = arguments.csv == '-'
    csv = None if arguments.csv is None or to_stdout else Path(arguments.csv)
    if csv is not None:
        _refuse_existing(csv, 'file')
        _require_folder(csv)
    if arguments.record is not None:
        _refuse_existing(arguments.record, 'directory')
        if csv is not None and csv.resolve() == arguments.record.resolve():
            raise ConfigurationError('--csv', str(csv), 'must not be the directory of --record')
    done = simulate_offline(configuration)
    data = from_run(done, time.time_ns())
    if arguments.record is not None:
        from dz_ros.recording.save import save_run

        save_run(data, arguments.record)
    if csv is not None:
        with csv.open('x', encoding='ascii', newline='') as file:
            write_csv(done, file)
    if to_stdout:
        write_csv(done, sys.stdout)
    view = View.of(data)
    print(format_table(window_title(view), metric_rows(view)),
          file=sys.stderr if to_stdout else sys.stdout)
    return 0


def columns(run: Run) -> dict[str, np.ndarray]:
    """Return the CSV's columns after k by name: t, x…, xd…, v, w, the law's signals, s, s_eps."""
    order = run.x.shape[1]
    return {
        't': run.t,
        **{f'x{i}': run.x[:, i] for i in range(order)},
        **{f'xd{i}': run.x_d[:, i] for i in range(order + 1)},
        'v': run.v,
        'w': run.truth[:, 0],
        **{name: run.column(name) for name in run.configuration.law.signal_names},
        's': run.column('s'),
        's_eps': run.column('s_eps'),
    }


def write_csv(run: Run, file: TextIO) -> None:
    """Write a header and one line a sample, 17 significant digits: nothing is lost."""
    table = columns(run)
    file.write(','.join(('k', *table)) + '\n')
    file.writelines(_lines(np.column_stack(list(table.values()))))


def _lines(table: np.ndarray) -> Iterator[str]:
    form = ','.join(['%d'] + ['%.17g'] * table.shape[1]) + '\n'
    for k, row in enumerate(table.tolist()):
        yield form % (k, *row)


def _refuse_existing(path: Path, kind: str) -> None:
    """Refuse to overwrite.

    Raises:
        RunExistsError: There is something of that name.
    """
    if path.exists() or path.is_symlink():
        raise RunExistsError(f'{path}: exists already and is never overwritten; choose another '
                             f'{kind}')


def _require_folder(path: Path) -> None:
    """Find out before computing anything whether a file could be written there.

    Raises:
        NotADirectoryError: Its folder does not exist.
    """
    if not path.absolute().parent.is_dir():
        raise NotADirectoryError(20, 'no such directory', str(path.absolute().parent))
