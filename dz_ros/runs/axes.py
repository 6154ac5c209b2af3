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

from dz_ros.core.axes_keys import axis_seed, is_machines, parts, section_of
from dz_ros.core.dataset import RunData
from dz_ros.core.events import ConfigurationEvent, EventError, parse
from dz_ros.errors import RecordingError, suggestion


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


def axis_run(run: RunData, axis: str) -> RunData:
    """Return the run of one axis.

    Args:
        run: A run of several axes.
        axis: Name of the axis.

    Raises:
        RecordingError: The run has no such axis, or a topic with messages of others.
    """
    names = run.axes
    if not names and list(run.configuration.get('loop.axes') or ()) == [axis]:
        return run      # the messages of one axis do not name it
    if axis not in names:
        known = f'it has {", ".join(names)}' if names else 'it is of one axis, without a name'
        raise RecordingError(f'the run has no axis {axis}: {known}{suggestion(axis, names)}')
    for name, channel in run.channels.items():
        if len(channel) and axis not in channel.axes:
            found = f'axes {", ".join(channel.axes)}' if channel.axes else 'one axis'
            raise RecordingError(f'the messages of {name} are of {found}, the run has axes '
                                 f'{", ".join(names)}: not recorded of one loop')
    configuration = axis_flat(run.configuration, axis)
    info = {**run.info, 'axis': axis}
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


def choose_axis(run: RunData, axis: str | None) -> RunData:
    """Return the run of the axis asked for, or the only one.

    Raises:
        RecordingError: The run has several and none was asked for, or not this one.
    """
    if axis is not None:
        return axis_run(run, axis)
    require_one(run)
    return run


def require_one(run: RunData) -> None:
    """Refuse a run of several axes.

    Raises:
        RecordingError: It is.
    """
    if run.axes:
        raise RecordingError(f'the run has axes {", ".join(run.axes)}; choose one with --axis')
