# SPDX-License-Identifier: Apache-2.0
"""``dz bag whatif RUN --set KEY=VALUE …``: the recorded loop again with something changed."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
import time
from typing import Any

from dz_ros.cli.bag.compare import side_by_side
from dz_ros.cli.bag.recover import beside
from dz_ros.cli.offline import simulate_offline
from dz_ros.cli.options import add_recording, read_one, refuse_existing, window
from dz_ros.cli.output import note_run, print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.loop.coupled import knows_others
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import flat_parameters, load_configuration
from dz_ros.identification.estimation.prediction_error import Fit
from dz_ros.replay.whatif import answer, plan
from dz_ros.report.compare import compare, write_comparison


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_recording(parser, numbers=True)
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides',
                        help='what to change: a gain, the law, the trajectory, the dead-zone, '
                             'loop.delay, …; the value as YAML; may be repeated')
    parser.add_argument('--fit', action='store_true',
                        help='estimate a_i, b_r, b_l, b·m_r, b·m_l of the plant model from the '
                             'log and use them')
    parser.add_argument('--config', metavar='FILE',
                        help='what ran, for bags without it')
    parser.add_argument('--record', type=Path, metavar='DIR',
                        help='write the answer as a recording; must not exist')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='where the comparison goes; an older one there is replaced '
                             '(default: RUN-whatif)')


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
    refuse_existing(arguments.record)
    data = read_one(arguments)
    given = None if arguments.config is None else flat_parameters(
        arguments.config, namespace=arguments.namespace or '')
    if given is not None and arguments.axis is not None:
        given = load_configuration(arguments.config, (), arguments.namespace or '').axis(
            arguments.axis).to_flat()
    with stage('fitting the plant' if arguments.fit else 'reading what ran'):
        planned = plan(data, overrides, given=given, fit=arguments.fit)
    if planned.fit is not None:
        print_lines(fit_lines(planned.fit))
    begin = time.perf_counter()
    done = simulate_offline(planned.configuration, planned.memory)
    elapsed = time.perf_counter() - begin
    alone = knows_others(planned.configuration)
    name = arguments.run.resolve().name
    made = answer(planned, done, name, time.time_ns())
    if arguments.record is not None:
        from dz_ros.recording.save import save_run, state_configuration

        memory = planned.memory or done.configuration.law.initial_memory()
        with stage(f'writing {arguments.record}'):
            save_run(state_configuration(made, memory), arguments.record)
    with stage('comparing, drawing pictures'):
        comparison = compare({name: data, 'what if': made}, window=window(arguments),
                             pulse=arguments.pulse)
        page = write_comparison(comparison, arguments.out or beside(arguments.run, 'whatif'),
                                title=f'{name}, and what if {_words(overrides) or "fitted"}'
                                + (' (of this axis alone, the others at rest)' if alone else ''))
    print_lines(side_by_side(comparison))
    print_lines(f'note: {text}' for text in planned.notes)
    if alone:
        print_lines(['note: plant or law couple this axis to others; the answer is that of the '
                     'axis alone, the others at rest'])
    note_run(data)
    print_lines(f'{done.t[-1]:g} s of loop in {elapsed:.2g} s')
    if arguments.record is not None:
        print_lines(f'recording: {arguments.record}')
    print_lines(f'comparison: {page}')
    return 0


def fit_lines(fit: Fit) -> Iterator[str]:
    """Yield the estimates with their confidence."""
    yield (f'plant {fit.model} fitted to {fit.samples} states in {fit.stretches} stretches, '
           '95 % confidence:')
    for item in fit.estimates:
        if item.seen:
            yield f'  {item.name:<5} {item.value:>12.6g}  ± {item.half_width:.2g}'
        else:
            yield f'  {item.name:<5} {item.value:>12.6g}  kept: the log does not show it'
    yield (f'  b and m show only as their product: b = {fit.b:.6g} is kept, so '
           f'm_r = {fit["b·m_r"].value / fit.b:.6g}, m_l = {fit["b·m_l"].value / fit.b:.6g}')
    yield '  residual (RMS): ' + ', '.join(
        f'{value:.3g} of x{i}' for i, value in enumerate(fit.residual))


def _words(overrides: Mapping[str, Any]) -> str:
    return ', '.join(f'{key} = {value}' for key, value in overrides.items())
