"""``dz bag whatif RUN --set KEY=VALUE …``: the recorded loop again with something changed."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
import sys
import time
from typing import Any

from dz_ros.analysis.compare import compare, write_comparison
from dz_ros.analysis.fit import Fit
from dz_ros.analysis.whatif import answer, plan
from dz_ros.cli.bag_compare import side_by_side
from dz_ros.cli.bag_recover import beside
from dz_ros.cli.offline import simulate_offline
from dz_ros.errors import ConfigurationError, RunExistsError
from dz_ros.files import flat_parameters
from dz_ros.recording.reader import read_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('run', type=Path, metavar='RUN',
                        help='directory of a run or of a rosbag2 bag, or its .mcap or .db3')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides',
                        help='what to change: a gain, the law, the trajectory, the dead-zone, '
                             'loop.delay, …; the value as YAML; may be repeated')
    parser.add_argument('--fit', action='store_true',
                        help='estimate a_i, b·m, b_r, b_l of the plant model from the log and '
                             'use them')
    parser.add_argument('--config', metavar='FILE',
                        help='what ran, for bags that do not say it')
    parser.add_argument('--record', type=Path, metavar='DIR',
                        help='write the answer as a recording; must not exist')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='where the comparison goes; an older one there is replaced '
                             '(default: RUN-whatif)')
    parser.add_argument('--window', type=float, nargs=2, metavar=('FROM', 'TO'),
                        help='instants the numbers are about [s]')
    parser.add_argument('--namespace', metavar='NS',
                        help='whose topics to read, where a run holds several loops')


def run(arguments: argparse.Namespace) -> int:
    """Plan, simulate, compare, write.

    Raises:
        ConfigurationError: Nothing to change.
        RunExistsError: The recording exists.
    """
    overrides = flat_parameters(None, arguments.overrides)
    if not overrides and not arguments.fit:
        raise ConfigurationError('--set', '', 'what if what? give KEY=VALUE, e.g. '
                                 'controller.epsilon=0.01')
    if arguments.record is not None and arguments.record.exists():
        raise RunExistsError(f'{arguments.record}: exists already; recordings are never '
                             'overwritten: choose another directory')
    data = read_run(arguments.run, arguments.namespace)
    given = None if arguments.config is None else flat_parameters(arguments.config)
    planned = plan(data, overrides, given=given, fit=arguments.fit)
    if planned.fit is not None:
        print('\n'.join(fit_lines(planned.fit)))
    begin = time.perf_counter()
    done = simulate_offline(planned.configuration, planned.memory)
    elapsed = time.perf_counter() - begin
    name = arguments.run.resolve().name
    made = answer(planned, done, name, time.time_ns())
    if arguments.record is not None:
        from dz_ros.recording.save import save_run

        save_run(made, arguments.record)
    window = None if arguments.window is None else (arguments.window[0], arguments.window[1])
    comparison = compare({name: data, 'what if': made}, window=window)
    page = write_comparison(comparison, arguments.out or beside(arguments.run, 'whatif'),
                            title=f'{name}, and what if {_words(overrides) or "fitted"}')
    print('\n'.join(side_by_side(comparison)))
    for note in planned.notes:
        print(f'note: {note}')
    if 'cut' in data.info:
        print(f'dz: note: the run was cut off: {data.info["cut"]}', file=sys.stderr)
    print(f'{done.t[-1]:g} s of loop in {elapsed:.2g} s')
    if arguments.record is not None:
        print(f'recording: {arguments.record}')
    print(f'comparison: {page}')
    return 0


def fit_lines(fit: Fit) -> Iterator[str]:
    """Yield the estimates with their confidence."""
    yield (f'plant {fit.model} fitted to {fit.samples} states in {fit.segments} segments, '
           '95 % confidence:')
    for item in fit.estimates:
        if item.seen:
            yield f'  {item.name:<4} {item.value:>12.6g}  ± {item.half_width:.2g}'
        else:
            yield f'  {item.name:<4} {item.value:>12.6g}  kept: the log does not show it'
    yield (f'  b and m show only as their product: b = {fit.b:.6g} is kept, so '
           f'm = {fit.m:.6g}')
    yield '  residual (RMS): ' + ', '.join(
        f'{value:.3g} of x{i}' for i, value in enumerate(fit.residual))


def _words(overrides: Mapping[str, Any]) -> str:
    return ', '.join(f'{key} = {value}' for key, value in overrides.items())
