# SPDX-License-Identifier: Apache-2.0
"""``dz bag export RUN --csv|--parquet|--mat``: a run as one table for other programs.

One row for each sample, joined as in the report: seq, t, states, reference, command, terms of the
law, truth where the run has it. Names and units are printed; an unknown number is NaN, in CSV
empty.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
import re
from typing import Any

import numpy as np

from dz_ros.cli.bag.recover import beside
from dz_ros.cli.options import add_recording, read_axes, refuse_existing, require_folder
from dz_ros.cli.output import note_run, print_lines, whole_file, write_csv
from dz_ros.cli.progress import stage
from dz_ros.core.dataset import RunData
from dz_ros.errors import MissingDependencyError
from dz_ros.runs.setting import Setting
from dz_ros.runs.table import RunTable

Columns = dict[str, np.ndarray]
LONGEST_VARIABLE = 63
"""Characters of a MATLAB variable's name."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_recording(parser)
    kinds = parser.add_mutually_exclusive_group()
    for kind, text in (('csv', 'text, 17 digits (default)'), ('parquet', 'Apache Parquet: pandas, '
                       'polars, DuckDB'), ('mat', 'MATLAB level 5: load(FILE)')):
        kinds.add_argument(f'--{kind}', dest='kind', action='store_const', const=kind, help=text)
    parser.set_defaults(kind='csv')
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='file to write, which must not exist (default: RUN-table.KIND)')


def run(arguments: argparse.Namespace) -> int:
    """Write the table.

    Raises:
        RunExistsError: The file exists.
        MissingDependencyError: --parquet without pyarrow.
    """
    suffix = f'table.{arguments.kind}'
    out = arguments.out or beside(arguments.run, suffix)
    refuse_existing(out, 'file')
    require_folder(out)
    runs = read_axes(arguments)
    with stage('joining samples'):
        table, units = columns(runs)
    data = next(iter(runs.values()))
    if arguments.kind == 'csv':
        file = out.open('x', encoding='utf-8', newline='')
        with whole_file(out), file, stage(f'writing {out}'):
            write_csv(table, file)
    else:
        with whole_file(out), stage(f'writing {out}'):
            WRITERS[arguments.kind](table, out)
    print_lines(', '.join(f'{name} [{unit}]' if unit else name for name, unit in units.items()))
    note_run(data)
    if arguments.kind == 'mat':
        print_lines(f'{name} is {own} in the file'
                    for name, own in variables(table).items() if own != name)
    print_lines(f'{out}: {len(table["t"])} samples, {len(table)} columns')
    return 0


def columns(runs: Mapping[str, RunData]) -> tuple[Columns, dict[str, str]]:
    """Return the columns and their units; of several axes seq and t once, others as ``yaw.v``."""
    table: Columns = {}
    units: dict[str, str] = {}
    for axis, run in runs.items():
        own = RunTable.of(run).columns
        names = {name: name if name in ('seq', 't') or not axis else f'{axis}.{name}'
                 for name in own}
        table.update((names[name], item) for name, item in own.items())
        units.update((names[name], unit) for name, unit in
                     Setting.of(run).column_units(own).items())
    return table, {name: units[name] for name in table}


def write_parquet(table: Columns, out: Path) -> None:
    """Write the table as Parquet.

    Raises:
        MissingDependencyError: pyarrow is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise MissingDependencyError("Parquet needs pyarrow: pip install 'dz_ros[parquet]'"
                                     ) from None
    parquet.write_table(pyarrow.table(dict(table)), out)


def write_mat(table: Columns, out: Path) -> None:
    """Write each column as a MATLAB variable, a column vector."""
    from scipy.io import savemat

    names = variables(table)
    savemat(out, {names[name]: np.asarray(item, float) for name, item in table.items()},
            appendmat=False, oned_as='column', long_field_names=True)


def variables(names: Iterable[str]) -> dict[str, str]:
    """Return name → the MATLAB variable it becomes: as it is where it can be one, and no two one.

    Anything else would be left out of the file, or take another's place.
    """
    found: dict[str, str] = {}
    for name in names:
        plain = re.sub(r'[^A-Za-z0-9_]', '_', name)
        plain = (plain if plain[:1].isalpha() else f'x{plain}')[:LONGEST_VARIABLE]
        own, count = plain, 1
        while own in found.values():
            count += 1
            own = f'{plain[:LONGEST_VARIABLE - 6]}_{count}'
        found[name] = own
    return found


WRITERS: dict[str, Callable[[Columns, Path], Any]] = {
    'parquet': write_parquet, 'mat': write_mat}
