# SPDX-License-Identifier: Apache-2.0
"""``dz bag whatif RUN --set KEY=VALUE …``: the recorded loop again with something changed.

Of a run of several axes all are simulated, with the change in each of them or in that of --axis.
One axis alone is simulated where --axis names one that nothing couples to the others, with the
change made.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
import time
from typing import Any

from dz_ros.cli.bag.compare import side_by_side
from dz_ros.cli.bag.recover import beside
from dz_ros.cli.offline import simulate_machine, simulate_offline
from dz_ros.cli.options import add_recording, read_recording, refuse_existing, window
from dz_ros.cli.output import note_run, print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.axes import spoken
from dz_ros.core.axes_keys import axis_seed
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import flat_parameters, load_configuration
from dz_ros.identification.estimation.prediction_error import Fit
from dz_ros.replay.whatif import (
    answer,
    answer_axes,
    FITS_ONE,
    of_axis,
    Plan,
    plan,
    plan_axes,
    plan_axis,
)
from dz_ros.report.axes import write_comparisons
from dz_ros.report.compare import compare
from dz_ros.runs.axes import axis_name, axis_run, choose_axis, named_axis


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
                        help='where the comparison goes, of several axes the summary, with a '
                             'page in a folder for each axis; an older one there is replaced '
                             '(default: RUN-whatif)')


def run(arguments: argparse.Namespace) -> int:
    """Plan, simulate, compare, write.

    Raises:
        ConfigurationError: Nothing to change, or a fit of axes that depend on each other.
        RunExistsError: The recording exists.
    """
    overrides = flat_parameters(None, arguments.overrides)
    if not overrides and not arguments.fit:
        raise ConfigurationError('--set', '', 'what if what? give KEY=VALUE, e.g. '
                                 'controller.epsilon=0.01')
    refuse_existing(arguments.record)
    whole, axis = read_recording(arguments.run, arguments.namespace), arguments.axis
    if whole.axes and axis is None:
        return _all_axes(arguments, whole, overrides)
    data = choose_axis(whole, axis)
    with stage('fitting the plant' if arguments.fit else 'reading what ran'):
        if axis is None:
            keys = (None if arguments.config is None else
                    flat_parameters(arguments.config, namespace=arguments.namespace or ''))
            planned = plan(data, overrides, given=keys, fit=arguments.fit)
        else:
            planned = plan_axis(whole, axis, overrides, fit=arguments.fit,
                                given=_given(arguments, whole, (axis,)).get(axis))
    if whole.axes and planned.coupled:
        return _all_axes(arguments, whole, of_axis(overrides, axis))
    return _one_axis(arguments, data, planned, overrides)


def _given(arguments: argparse.Namespace, whole: RunData,
           axes: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return axis → the keys of --config, of some axes of a run; the file may have others.

    The noise of an axis is that of its place in the run.

    Raises:
        ConfigurationError: The file cannot be used, or lacks one of the axes.
    """
    if arguments.config is None:
        return {}
    machine = load_configuration(arguments.config, (), arguments.namespace or '')
    lacking = [name for name in axes if name not in machine.axis_names]
    if lacking:
        has = spoken(machine.axis_names) if machine.axes else 'one axis, without a name'
        raise ConfigurationError('--config', arguments.config, f'is of {has}, and lacks '
                                 f'{spoken(lacking)} of the run')
    return {name: {**machine.axis(name).to_flat(), 'loop.seed': axis_seed(
        machine.loop.seed, whole.axes.index(name) if whole.axes else 0)} for name in axes}


def _one_axis(arguments: argparse.Namespace, data: RunData, planned: Plan,
              overrides: Mapping[str, Any]) -> int:
    """Answer for a run of one axis, or for one axis that does not depend on others."""
    if planned.fit is not None:
        print_lines(fit_lines(planned.fit))
    begin = time.perf_counter()
    done = simulate_offline(planned.configuration, planned.memory)
    elapsed = time.perf_counter() - begin
    name = arguments.run.resolve().name
    made = named_axis(answer(planned, done, name, time.time_ns()), axis_name(data))
    _record(arguments, made, planned.memory or done.configuration.law.initial_memory())
    out = arguments.out or beside(arguments.run, 'whatif')
    page = _compare(arguments, {'': data}, {'': made}, overrides, out)
    _conclude(arguments, data, planned.notes, f'{done.t[-1]:g} s of loop in {elapsed:.2g} s', page)
    return 0


def _all_axes(arguments: argparse.Namespace, whole: RunData,
              overrides: Mapping[str, Any]) -> int:
    """Answer for all axes of a machine; the change may be that of --axis, which is then shown.

    Raises:
        ConfigurationError: The plant is to be fitted, which is done for one axis.
    """
    axis = arguments.axis
    if arguments.fit:
        raise ConfigurationError('--fit', True, FITS_ONE)
    with stage('reading what ran'):
        planned = plan_axes(whole, overrides, given=_given(arguments, whole, whole.axes))
    begin = time.perf_counter()
    done = simulate_machine(planned.configuration, planned.memories)
    elapsed = time.perf_counter() - begin
    made = answer_axes(planned, done, arguments.run.resolve().name, time.time_ns())
    _record(arguments, made, [number for memory, item in zip(
        planned.memories, planned.configuration.each, strict=True)
        for number in memory or item.law.initial_memory()])
    shown = whole.axes if axis is None else (axis,)
    page = _compare(arguments, {name: axis_run(whole, name) for name in shown},
                    {name: axis_run(made, name) for name in shown}, overrides,
                    arguments.out or beside(arguments.run, 'whatif'))
    length = next(iter(done.values())).t[-1]
    _conclude(arguments, whole, planned.notes, f'{length:g} s of loop, {len(done)} axes, in '
              f'{elapsed:.2g} s', page)
    return 0


def _record(arguments: argparse.Namespace, made: RunData, memory: Sequence[float]) -> None:
    """Write the answer where --record asks for it."""
    if arguments.record is not None:
        from dz_ros.recording.save import save_run, state_configuration

        with stage(f'writing {arguments.record}'):
            save_run(state_configuration(made, memory), arguments.record)


def _compare(arguments: argparse.Namespace, runs: Mapping[str, RunData],
             made: Mapping[str, RunData], overrides: Mapping[str, Any],
             out: Path) -> Path:
    """Compare each axis, write the page or pages; print the numbers, return the page to open."""
    name = arguments.run.resolve().name
    with stage('comparing, drawing pictures') as step:
        comparisons = {axis: compare({name: data, 'what if': made[axis]},
                                     window=window(arguments), pulse=arguments.pulse)
                       for axis, data in runs.items()}
        page = write_comparisons(comparisons, out, title=f'{name}, and what if '
                                 f'{_words(overrides) or "fitted"}', progress=step)
    print_lines(side_by_side(comparisons))
    return page


def _conclude(arguments: argparse.Namespace, data: RunData, notes: Sequence[str], done: str,
              page: Path) -> None:
    """Print notes, how long it took, and what was written."""
    print_lines(f'note: {text}' for text in notes)
    note_run(data)
    print_lines([done])
    if arguments.record is not None:
        print_lines([f'recording: {arguments.record}'])
    print_lines(f'comparison: {page}')


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
