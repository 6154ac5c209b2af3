# SPDX-License-Identifier: Apache-2.0
"""``dz bag compare RUN RUN …``: metrics side by side, overlaid figures on one page.

Runs of several axes are compared axis by axis, or --axis alone; of a single such run its axes are.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
import json
from pathlib import Path
import sys

from dz_ros.cli.bag.recover import beside
from dz_ros.cli.options import add_recording, read_chosen, read_recording, window
from dz_ros.cli.output import aligned, note_problems, note_run, print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError
from dz_ros.report.axes import compare_axes
from dz_ros.report.compare import Comparison
from dz_ros.runs.axes import each_axis


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_recording(parser, numbers=True, many=True)
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='where the page and its pictures go, of several axes the summary, '
                             'with a page in a folder for each axis; an older comparison there '
                             'is replaced, but for the pages of axes that these runs have not '
                             '(default: FIRST-RUN-comparison)')
    parser.add_argument('--json', action='store_true',
                        help='print every number for programs; writes a page only with --out')


def run(arguments: argparse.Namespace) -> int:
    """Compare; write the page, print the table.

    Raises:
        ConfigurationError: Fewer than two runs.
        RecordingError: A run cannot be read, or the runs have not the same axes.
    """
    runs: dict[str, RunData] = {}
    title = ''
    if len(arguments.runs) == 1 and arguments.axis is None:
        runs = each_axis(read_recording(arguments.runs[0], arguments.namespace))
        title = f'{arguments.runs[0].resolve().name}: '
    else:
        for name, path in zip(names(arguments.runs), arguments.runs, strict=True):
            runs[name] = read_chosen(arguments, path)
    if len(runs) < 2:
        raise ConfigurationError('RUN', [str(item) for item in arguments.runs],
                                 'must be at least two to compare, or one of several axes')
    with stage('computing the metrics'):
        comparisons = compare_axes(runs, window=window(arguments), pulse=arguments.pulse)
    page = None
    if arguments.out is not None or not arguments.json:
        from dz_ros.report.axes import write_comparisons

        out = arguments.out or beside(arguments.runs[0], 'comparison')
        with stage('drawing pictures') as step:
            page = write_comparisons(comparisons, out, title=title + ' · '.join(runs),
                                     progress=step)
    if arguments.json:
        found = {axis: comparison.to_dict() for axis, comparison in comparisons.items()}
        print(json.dumps(found.get('', {'axes': found}), indent=2, allow_nan=False))
    else:
        print_lines(side_by_side(comparisons))
    for name, data in runs.items():
        note_run(data, name)
    code = note_problems({f'{name}, axis {axis}' if axis else name: view.setting
                          for axis, comparison in comparisons.items()
                          for name, view in comparison.views.items()}, arguments.allow_import)
    if page is not None:
        print_lines(f'comparison: {page}', sys.stderr if arguments.json else sys.stdout)
    return code


def names(paths: Sequence[Path]) -> list[str]:
    """Return a short name for each run: as few last parts of its path as differ."""
    whole = [path.resolve() for path in paths]
    for count in range(1, max(len(path.parts) for path in whole) + 1):
        found = ['/'.join(path.parts[-count:]) for path in whole]
        if len(set(found)) == len(found):
            return found
    return [f'{index + 1}: {path.name}' for index, path in enumerate(whole)]


def side_by_side(comparisons: Mapping[str, Comparison]) -> list[str]:
    """Return the metrics as lines, one column a run, and below them the keys that differ.

    Args:
        comparisons: Axis → comparison; one axis is called ''.
    """
    return [line for axis, comparison in comparisons.items()
            for line in ([f'axis {axis}'] if axis else []) + _of_one(comparison)]


def _of_one(comparison: Comparison) -> list[str]:
    heads = list(comparison.views)
    windows = ['{:.4g} to {:.4g} s'.format(*view.metrics.window)
               for view in comparison.views.values()]
    found = aligned([['', *heads], ['window', *windows], *comparison.rows()])
    differing = comparison.differences()
    if differing:
        found += ['', *aligned([['differs', *heads], *differing])]
    return found
