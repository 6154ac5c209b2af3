# SPDX-License-Identifier: Apache-2.0
"""``dz bag import FILE --out RUN --map SIGNAL=COLUMN,…``: a run of another tool's log."""

from __future__ import annotations

import argparse
from pathlib import Path

from dz_ros.cli.options import read_configuration
from dz_ros.cli.output import print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.errors import RecordingError, RunExistsError, RunNotFoundError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('file', type=Path, metavar='FILE',
                        help='CSV file whose first line names the columns, or a bag (MCAP, '
                             'rosbag2), whose columns are /topic/field, e.g. '
                             '/joint_states/position[0]')
    parser.add_argument('--out', type=Path, metavar='RUN', required=True,
                        help='directory to write; must not exist')
    parser.add_argument('--map', metavar='MAP', required=True, dest='mapping',
                        help='SIGNAL=COLUMN,…: stamp [s], x0 … , xd0 …, v, in the units of the '
                             'plant; a factor and an offset may follow a column, as in '
                             'x0=angle_deg*0.0174533 or x0=angle*deg+0.1')
    parser.add_argument('--config', metavar='CONFIG', default='robust_eso',
                        help='plant, rate and law that go with the log: a file or the name of '
                             'one that comes with dz_ros (default: %(default)s)')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides', help='change one key of the configuration')
    parser.add_argument('--resample', action='store_true',
                        help='take the values at multiples of 1/loop.rate; without it the rows '
                             'keep their own times, which must be near these')
    parser.add_argument('--axis', metavar='NAME',
                        help='this axis alone, of a configuration of several; a log is of one')
    parser.set_defaults(duration=None, namespace='')


def run(arguments: argparse.Namespace) -> int:
    """Read, convert, write, print what is missing.

    Raises:
        RunExistsError: RUN exists.
        RunNotFoundError: FILE does not.
        RecordingError: FILE holds none of it.
    """
    from dz_ros.recording.import_columns import read_bag
    from dz_ros.recording.import_csv import is_table, read_table, table_names
    from dz_ros.recording.import_map import check_signals, parse_source, split_map
    from dz_ros.recording.import_run import import_run
    from dz_ros.recording.run_source import open_source
    from dz_ros.recording.save import save_run

    path, out = arguments.file, arguments.out
    if out.exists():
        raise RunExistsError(f'{out}: exists already; recordings are never overwritten: choose '
                             'another directory')
    if not path.exists():
        raise RunNotFoundError(f'{path}: there is no such file')
    c = read_configuration(arguments)
    texts = split_map(arguments.mapping)
    check_signals(list(texts), c.plant.order)
    table = is_table(path)
    names = table_names(path) if table else None
    sources = {signal: parse_source(text, names) for signal, text in texts.items()}
    wanted = list(dict.fromkeys(source.column for source in sources.values()))
    with stage(f'reading {path}'):
        found = read_table(path, wanted) if table else read_bag(open_source(path), wanted)
    if not any(len(column.values) for column in found.chosen.values()):
        raise RecordingError(f'{path}: there is no row in it')
    with stage('converting'):
        done = import_run(found.chosen, sources, c, arguments.resample,
                          path.stat().st_mtime_ns)
    with stage(f'writing {out}'):
        save_run(done.run, out)
    state = done.run.channels['state']
    print_lines([f'{len(state)} samples, {state["stamp"][-1]:.4g} s, plant {c.plant.name}',
                 *(f'  {signal} [{_unit(signal, c)}] = {text}' for signal, text in texts.items()),
                 *(f'note: {text}' for text in done.notes), f'recording: {out}'])
    return 0


def _unit(signal: str, c: Configuration) -> str:
    """Return the unit a signal must have."""
    if signal in ('stamp', 'v'):
        return 's' if signal == 'stamp' else c.plant.actuator_unit
    place = int(signal.lstrip('xd'))
    units = c.plant.state_units
    return units[place] if place < len(units) else f'{units[-1]}/s'
