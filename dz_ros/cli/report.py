"""``dz report RUN``: the page with figures and metrics, and the five numbers that tell most.

With ``--serve`` the run is shown in the browser instead, by the page of a running loop.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys

from dz_ros.analysis.counterpart import without_dead_zone
from dz_ros.analysis.view import View
from dz_ros.cli.bag_recover import beside
from dz_ros.cli.options import add_address
from dz_ros.cli.table import five_rows, format_table, window_title
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.recording.reader import read_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('run', type=Path, metavar='RUN', help='directory of a run, or its .mcap')
    parser.add_argument('--serve', action='store_true',
                        help='show the run in the browser, to scrub through, until Ctrl-C')
    parser.add_argument('--over', type=Path, metavar='RUN2',
                        help='with --serve: a second run to lay over the first')
    add_address(parser)
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='where the page and its pictures go; an older report there is '
                             'replaced (default: RUN-report, so that the recording stays as it '
                             'was)')
    parser.add_argument('--json', action='store_true',
                        help='print every number for programs; writes a report only with --out')
    parser.add_argument('--without-dead-zone', type=Path, metavar='RUN2', dest='without',
                        help='the run for figures 5 and 6 (default: simulate the one of RUN '
                             'with b_r = b_l = 0, m = 1)')
    parser.add_argument('--namespace', metavar='NS',
                        help='whose topics to read, where a run holds several loops')
    parser.add_argument('--window', type=float, nargs=2, metavar=('FROM', 'TO'),
                        help='instants the numbers are about [s] (default: the last 10 s, of a '
                             'short run the last half)')
    parser.add_argument('--kick', type=float, metavar='T',
                        help='instant of a disturbance the loop has to recover from [s]')


def run(arguments: argparse.Namespace) -> int:
    """Read, write the report, print the numbers."""
    data = read_run(arguments.run, arguments.namespace)
    if arguments.serve:
        return _serve(arguments, data)
    if arguments.over is not None:
        raise ConfigurationError('--over', str(arguments.over), 'goes with --serve; dz bag '
                                 'compare lays runs side by side in a report')
    window = None if arguments.window is None else (arguments.window[0], arguments.window[1])
    view = View.of(data, window=window, kick=arguments.kick)
    page = None
    if arguments.out is not None or not arguments.json:
        from dz_ros.analysis.report import write_report

        page = write_report(data, arguments.out or beside(arguments.run, 'report'),
                            without_dead_zone=_counterpart(view, arguments),
                            title=arguments.run.resolve().name, window=window,
                            kick=arguments.kick)
    if arguments.json:
        print(json.dumps(view.to_dict(), ensure_ascii=False, indent=2, allow_nan=False))
    else:
        print(format_table(window_title(view), five_rows(view)))
    if 'cut' in data.info:
        print(f'dz: note: the run was cut off: {data.info["cut"]}', file=sys.stderr)
    if page is not None:
        print(f'report: {page}', file=sys.stderr if arguments.json else sys.stdout)
    return 0


def _serve(arguments: argparse.Namespace, data: RunData) -> int:
    """Show one or two runs in the browser."""
    from dz_ros.cli.serve import serve

    runs = {arguments.run.resolve().name: data}
    if arguments.over is not None:
        name = arguments.over.resolve().name
        runs[f'{name} (2)' if name in runs else name] = read_run(arguments.over,
                                                                arguments.namespace)
    return serve(runs, arguments.host, arguments.port)


def _counterpart(view: View, arguments: argparse.Namespace) -> RunData | None:
    """Return the run without dead-zone: the one given, else a simulated one, if it exists."""
    if arguments.without is not None:
        return read_run(arguments.without, arguments.namespace)
    try:
        return without_dead_zone(view)
    except DzRosError:
        raise
    except (OverflowError, ValueError):
        print('dz: note: without dead-zone this loop diverges; figures 5 and 6 are left out',
              file=sys.stderr)
        return None
