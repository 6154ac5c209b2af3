# SPDX-License-Identifier: Apache-2.0
"""One axis of a run of several, as a run of this axis alone.

Tables, metrics, reports, audits and comparisons are about one axis; they take what `axis_run`
gives. Its channels are views of the same numbers, its configuration that of a loop of this axis
alone, and its events state that configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dz_ros.core.axes import is_name, spoken
from dz_ros.core.axes_keys import axis_seed, is_machines, parts, section_of
from dz_ros.core.dataset import RunData
from dz_ros.core.events import ConfigurationEvent, EventError, parse
from dz_ros.errors import RecordingError, suggestion

ONE_AXIS = 'one axis, without a name'
CUT_FROM = 'axes'
"""Key of the info of one axis of a run of several: names of all of them; absent = it ran alone."""


def axis_flat(flat: Mapping[str, Any], axis: str) -> dict[str, Any]:
    """Return the dotted keys of a loop of one axis, from those of a machine.

    A section of which the axis has keys of its own has no others: those of the machine are those
    of its first axis.
    """
    own = {rest: value for name, rest, value in
           ((*parts(key), value) for key, value in flat.items()) if name == axis}
    whole = {section_of(key) for key in own}
    found = {key: value for key, value in flat.items() if not parts(key)[0] and not (
        section_of(key) in whole and not is_machines(key))}
    names = flat.get('loop.axes')
    if isinstance(names, (list, tuple)) and axis in names:
        found['loop.axes'] = []
        if 'loop.seed' in flat:
            found['loop.seed'] = axis_seed(flat['loop.seed'], list(names).index(axis))
    return {**found, **own}


def axis_name(run: RunData) -> str:
    """Return the name of the axis of a run of one axis; '' = it has several, or none is stated.

    It is stated by the description (`info['axis']`) of one axis of a machine, and else by the
    configuration (`loop.axes`).
    """
    if run.axes:
        return ''
    stated = run.configuration.get('loop.axes')
    name: Any = run.info.get('axis')
    if name is None and isinstance(stated, (list, tuple)) and len(stated) == 1:
        name = stated[0]
    return name if isinstance(name, str) and is_name(name) else ''


def named_axis(run: RunData, axis: str | None) -> RunData:
    """Return a run of one axis that ran alone, with the name of the axis; None or '' = none."""
    return replace(run, info={**run.info, 'axis': axis}) if axis else run


def _alone(run: RunData) -> str:
    """Return what a run of one axis is of, as text."""
    name = axis_name(run)
    return f'axis {name} alone' if name else ONE_AXIS


def axis_run(run: RunData, axis: str) -> RunData:
    """Return the run of one axis.

    Args:
        run: A run of several axes, or of this one alone.
        axis: Name of the axis.

    Raises:
        RecordingError: The run has no such axis, or a topic with messages of others.
    """
    names = run.axes
    if not names and axis and axis_name(run) == axis:
        return run      # the messages of one axis do not name it
    if axis not in names:
        known = f'it has {", ".join(names)}' if names else f'it is of {_alone(run)}'
        raise RecordingError(f'the run has no axis {axis}: {known}{suggestion(axis, names)}')
    for name, channel in run.channels.items():
        if len(channel) and axis not in channel.axes:
            found = f'axes {", ".join(channel.axes)}' if channel.axes else 'one axis'
            raise RecordingError(f'the messages of {name} are of {found}, the run has axes '
                                 f'{", ".join(names)}: not recorded of one loop')
    configuration = axis_flat(run.configuration, axis)
    info = {**run.info, 'axis': axis, CUT_FROM: ', '.join(names)}
    for name, key in (('plant', 'plant.model'), ('law', 'controller.law')):
        if key in configuration:
            info[name] = str(configuration[key])
    return RunData({name: channel.axis(axis) for name, channel in run.channels.items()
                    if axis in channel.axes}, configuration, info, tuple(
                        (time, node, axis_text(text, axis, names))
                        for time, node, text in run.events))


def axis_text(text: str, axis: str, names: tuple[str, ...]) -> str:
    """Return the text of an event as a node of this axis alone would publish it."""
    if '"configuration"' not in text:
        return text
    try:
        event = parse(text)
    except EventError:
        return text
    if not isinstance(event, ConfigurationEvent):
        return text
    memory = event.memory
    if memory is not None and len(memory) % len(names) == 0:
        size = len(memory) // len(names)
        begin = names.index(axis) * size
        memory = memory[begin:begin + size]
    return replace(event, configuration=axis_flat(event.configuration, axis),
                   memory=memory).to_json()


def each_axis(run: RunData) -> dict[str, RunData]:
    """Return axis → its run; a run of one axis is called ''."""
    return {name: axis_run(run, name) for name in run.axes} or {'': run}


def same_axes(runs: Mapping[str, RunData]) -> dict[str, dict[str, RunData]]:
    """Return axis → name → run of this axis, in the order of the first run's axes.

    Args:
        runs: Name → run; the axes of a later run may be in another order. None at all = one axis,
            '', without runs.

    Raises:
        RecordingError: The runs have not the same axes.
    """
    each = {name: each_axis(run) for name, run in runs.items()}
    if not each:
        return {'': {}}
    first = next(iter(each))
    for name, axes in each.items():
        if axes.keys() == each[first].keys():
            continue
        both = bool(runs[first].axes and runs[name].axes)
        alone = [(first, [axis for axis in each[first] if axis not in axes]),
                 (name, [axis for axis in axes if axis not in each[first]])]
        known = {*runs[first].axes, *runs[name].axes}
        choices = [axis_name(runs[item]) for item in (first, name)
                   if axis_name(runs[item]) in known]
        raise RecordingError('the runs must have the same axes: ' + ', '.join(
            f'{"only " if both else ""}{item} has '
            f'{spoken(names) if names[0] else _alone(runs[item])}'
            for item, names in alone if names)
            + (f'; choose it with --axis {choices[0]}' if choices else ''))
    return {axis: {name: axes[axis] for name, axes in each.items()} for axis in each[first]}


def choose_axis(run: RunData, axis: str | None) -> RunData:
    """Return the run of the axis asked for, or the only one.

    Raises:
        RecordingError: The run has several and none was asked for, or not this one.
    """
    if axis is not None:
        return axis_run(run, axis)
    require_one(run)
    return run


def require_one(run: RunData, choice: str = '--axis') -> None:
    """Refuse a run of several axes.

    Args:
        run: The run.
        choice: What chooses one of its axes, for the message.

    Raises:
        RecordingError: It is.
    """
    if run.axes:
        raise RecordingError(f'the run has axes {", ".join(run.axes)}; choose one with {choice}')
