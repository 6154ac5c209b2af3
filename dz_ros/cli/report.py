# SPDX-License-Identifier: Apache-2.0
"""``dz report RUN``: the page with figures and metrics, and the five most important numbers.

With ``--serve`` the run is shown in the browser instead, by the page of a running loop; of several
axes a summary, and this page for each.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
import json
from pathlib import Path
import sys

from dz_ros.cli.bag.recover import beside
from dz_ros.cli.options import (
    add_address,
    add_recording,
    check_address,
    read_axes,
    read_chosen,
    read_one,
    window,
)
from dz_ros.cli.output import note, note_problems, note_run, print_lines
from dz_ros.cli.progress import stage
from dz_ros.cli.table import five_rows, format_table, window_title
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.report.compare import compare, Comparison
from dz_ros.report.reference_run import without_dead_zone
from dz_ros.report.verdict import judge
from dz_ros.report.view import View
from dz_ros.runs.axes import same_axes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_recording(parser, numbers=True)
    parser.add_argument('--serve', action='store_true',
                        help='show the run in the browser, to scrub through, until Ctrl-C; of '
                             'several axes a summary with a page for each')
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


def run(arguments: argparse.Namespace) -> int:
    """Read, write the report, print the numbers."""
    check_address(arguments, arguments.serve)
    if arguments.serve:
        return _serve(arguments)
    if arguments.over is not None:
        raise ConfigurationError('--over', str(arguments.over), 'goes with --serve; dz bag '
                                 'compare lays runs side by side in a report')
    runs = read_axes(arguments)
    if '' not in runs:
        return _report_axes(arguments, runs)
    data = runs['']
    with stage('computing the metrics'):
        view = View.of(data, window=window(arguments), pulse=arguments.pulse)
    page = None
    if arguments.out is not None or not arguments.json:
        from dz_ros.report.report import write_report

        other = _reference_run(view, arguments)
        with stage('drawing pictures') as step:
            page = write_report(data, arguments.out or beside(arguments.run, 'report'),
                                without_dead_zone=other, title=arguments.run.resolve().name,
                                window=window(arguments), pulse=arguments.pulse, progress=step)
    if arguments.json:
        verdict = judge(view)
        print(json.dumps({**view.to_dict(), 'verdict': {
            'failures': verdict.failures, 'facts': verdict.facts}}, indent=2, allow_nan=False))
    else:
        print_lines(judge(view).lines())
        print_lines(format_table(window_title(view), five_rows(view)))
    note_run(data)
    code = note_problems({'the run': view.setting}, arguments.allow_import)
    if page is not None:
        print_lines(f'report: {page}', sys.stderr if arguments.json else sys.stdout)
    return code


def _report_axes(arguments: argparse.Namespace, runs: dict[str, RunData]) -> int:
    """Write the summary of a run of several axes and the report of each; print the numbers."""
    with stage('computing the metrics'):
        views = {name: View.of(run, window=window(arguments), pulse=arguments.pulse)
                 for name, run in runs.items()}
    page = None
    if arguments.out is not None or not arguments.json:
        from dz_ros.report.axes import write_axes_report

        if arguments.without is not None:
            raise ConfigurationError('--without-dead-zone', str(arguments.without),
                                     'is of one axis; choose it with --axis')
        others = {name: _reference_run(view, arguments) for name, view in views.items()}
        with stage('drawing pictures') as step:
            page = write_axes_report(
                runs, arguments.out or beside(arguments.run, 'report'),
                without_dead_zone=others, title=arguments.run.resolve().name,
                window=window(arguments), pulse=arguments.pulse, progress=step)
    if arguments.json:
        print(json.dumps({'axes': {name: {**view.to_dict(), 'verdict': {
            'failures': judge(view).failures, 'facts': judge(view).facts}}
            for name, view in views.items()}}, indent=2, allow_nan=False))
    else:
        for name, view in views.items():
            print_lines([f'axis {name}', *judge(view).lines()])
            print_lines(format_table(window_title(view), five_rows(view)))
    note_run(next(iter(runs.values())))
    code = note_problems({f'axis {name}': view.setting for name, view in views.items()},
                         arguments.allow_import)
    if page is not None:
        print_lines(f'report: {page}', sys.stderr if arguments.json else sys.stdout)
    return code


def _serve(arguments: argparse.Namespace) -> int:
    """Show one or two runs in the browser.

    Raises:
        ConfigurationError: --out or --json, which are of a report.
        RecordingError: A run cannot be read, or the two have not the same axes.
    """
    if arguments.json or arguments.out is not None:
        name, value = ('--json', True) if arguments.json else ('--out', str(arguments.out))
        raise ConfigurationError(name, value, 'does not go with --serve, which writes no report')
    from dz_ros.cli.serve import serve

    runs: dict[str, RunData] = {}
    for path in filter(None, (arguments.run, arguments.over)):
        name = path.resolve().name
        runs[f'{name} (2)' if name in runs else name] = read_chosen(arguments, path)
    axes = same_axes(runs)
    if '' in axes:
        return serve(axes, {}, arguments.host, arguments.port)
    with stage('computing the metrics'):
        comparisons = {axis: _views(arguments, named) for axis, named in axes.items()}
    return serve(axes, comparisons, arguments.host, arguments.port)


def _views(arguments: argparse.Namespace, runs: Mapping[str, RunData]) -> Comparison:
    """Return one run looked at, or two with the tolerance of the first, as `dz bag compare`."""
    if len(runs) > 1:
        return compare(runs, window=window(arguments), pulse=arguments.pulse)
    return Comparison({name: View.of(run, window=window(arguments), pulse=arguments.pulse)
                       for name, run in runs.items()})


def _reference_run(view: View, arguments: argparse.Namespace) -> RunData | None:
    """Return the run without dead-zone: the one given, else a simulated one, if it exists."""
    if arguments.without is not None:
        return read_one(arguments, arguments.without)
    try:
        with stage('simulating the run without dead-zone'):
            return without_dead_zone(view)
    except DzRosError:
        raise
    except (OverflowError, ValueError):
        note('without dead-zone this loop diverges; figures 5 and 6 are left out')
        return None
