"""``dz bag compare RUN RUN …``: metrics side by side, overlaid figures on one page."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
from pathlib import Path
import sys

from dz_ros.analysis.compare import compare, Comparison
from dz_ros.cli.bag_recover import beside
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError
from dz_ros.recording.reader import read_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('runs', type=Path, nargs='+', metavar='RUN',
                        help='directory of a run, or its .mcap; two or more')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='where the page and its pictures go; an older comparison there is '
                             'replaced (default: FIRST-RUN-comparison)')
    parser.add_argument('--json', action='store_true',
                        help='print every number for programs; writes a page only with --out')
    parser.add_argument('--window', type=float, nargs=2, metavar=('FROM', 'TO'),
                        help='instants the numbers are about [s] (default: the last 10 s of each, '
                             'of a short run the last half)')
    parser.add_argument('--kick', type=float, metavar='T',
                        help='instant of a disturbance the loops have to recover from [s]')
    parser.add_argument('--namespace', metavar='NS',
                        help='whose topics to read, where a run holds several loops')


def run(arguments: argparse.Namespace) -> int:
    """Compare; write the page, print the table.

    Raises:
        ConfigurationError: Fewer than two runs.
    """
    if len(arguments.runs) < 2:
        raise ConfigurationError('RUN', [str(item) for item in arguments.runs],
                                 'must be at least two to compare')
    runs: dict[str, RunData] = {}
    for name, path in zip(names(arguments.runs), arguments.runs, strict=True):
        runs[name] = read_run(path, arguments.namespace)
    window = None if arguments.window is None else (arguments.window[0], arguments.window[1])
    comparison = compare(runs, window=window, kick=arguments.kick)
    page = None
    if arguments.out is not None or not arguments.json:
        from dz_ros.analysis.compare import write_comparison

        out = arguments.out or beside(arguments.runs[0], 'comparison')
        page = write_comparison(comparison, out, title=' · '.join(runs))
    if arguments.json:
        print(json.dumps(comparison.to_dict(), ensure_ascii=False, indent=2, allow_nan=False))
    else:
        print('\n'.join(side_by_side(comparison)))
    for name, data in runs.items():
        if 'cut' in data.info:
            print(f'dz: note: {name} was cut off: {data.info["cut"]}', file=sys.stderr)
    if page is not None:
        print(f'comparison: {page}', file=sys.stderr if arguments.json else sys.stdout)
    return 0


def names(paths: Sequence[Path]) -> list[str]:
    """Return a short name for each run: as few last parts of its path as tell them apart."""
    whole = [path.resolve() for path in paths]
    for count in range(1, max(len(path.parts) for path in whole) + 1):
        found = ['/'.join(path.parts[-count:]) for path in whole]
        if len(set(found)) == len(found):
            return found
    return [f'{index + 1}: {path.name}' for index, path in enumerate(whole)]


def side_by_side(comparison: Comparison) -> list[str]:
    """Return the metrics as lines, one column a run, and below them the keys that differ."""
    heads = list(comparison.views)
    windows = ['{:.4g} to {:.4g} s'.format(*view.metrics.window)
               for view in comparison.views.values()]
    found = columns([['', *heads], ['window', *windows], *comparison.rows()])
    differing = comparison.differences()
    if differing:
        found += ['', *columns([['differs', *heads], *differing])]
    return found


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines, the first column left, the others right aligned."""
    def visible(text: str) -> int:
        return len(text.replace('\N{COMBINING TILDE}', ''))

    widths = [max(visible(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ['  '.join(
        row[i] + ' ' * (widths[i] - visible(row[i])) if i == 0
        else ' ' * (widths[i] - visible(row[i])) + row[i]
        for i in range(len(row))).rstrip() for row in rows]
