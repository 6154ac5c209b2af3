# SPDX-License-Identifier: Apache-2.0
"""Keys of the axes of a loop: ``axes.yaw.controller.lambda`` overrides ``controller.lambda``.

The sections plant, controller, trajectory, driver and safety are the default of every axis;
``axes.NAME.`` before a key gives it for one axis. The loop and the process are those of the
machine, and so are the holds of the section safety, because sequence, watchdogs and mode are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dz_ros.errors import ConfigurationError, suggestion

AXES = 'axes'
"""First part of the keys of one axis."""
AXIS_SECTIONS = ('plant', 'controller', 'trajectory', 'driver', 'safety')
"""Sections of which an axis may have keys of its own."""
MACHINE_SECTIONS = ('loop', 'process')
"""Sections that are the machine's."""
MACHINE_SAFETY = ('command_hold', 'state_hold', 'reference_hold', 'echo_limit', 'fault_after',
                  'estimates')
"""Keys of the section safety that are the machine's."""


def axis_key(axis: str, key: str) -> str:
    """Return the key of one axis."""
    return f'{AXES}.{axis}.{key}'


def parts(key: str) -> tuple[str, str]:
    """Return (axis, key without it); axis is '' for a key of all axes or of the machine."""
    if not key.startswith(f'{AXES}.'):
        return '', key
    _, _, rest = key.partition('.')
    axis, _, own = rest.partition('.')
    return axis, own


def section_of(key: str) -> str:
    """Return the section that a key belongs to: controller of ``axes.yaw.controller.lambda``."""
    return parts(key)[1].partition('.')[0]


def axis_seed(seed: Any, place: int) -> Any:
    """Return the seed of an axis by its place in `loop.axes`, so that no two have the same noise.

    What is no seed is returned as it is; the schema refuses it.
    """
    return (seed + place) % 2 ** 63 if type(seed) is int else seed


def is_machines(key: str) -> bool:
    """Return whether a key, without an axis, has one value for the whole machine."""
    section, _, name = key.partition('.')
    return section not in AXIS_SECTIONS or (section == 'safety' and name in MACHINE_SAFETY)


def split_keys(flat: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the keys of all axes, and axis → its own, without their first two parts.

    Raises:
        ConfigurationError: A key that an axis cannot have of its own, or no key of an axis at all.
    """
    common: dict[str, Any] = {}
    own: dict[str, dict[str, Any]] = {}
    for key, value in flat.items():
        axis, rest = parts(key)
        if not axis and rest == key:
            common[key] = value
            continue
        if not axis or '.' not in rest:
            raise ConfigurationError(key, value, 'must be axes.NAME.SECTION.KEY, e.g. '
                                     'axes.yaw.controller.lambda')
        section = section_of(key)
        if section not in (*AXIS_SECTIONS, *MACHINE_SECTIONS):
            raise ConfigurationError(key, value, f'unknown section {section}; an axis has its own '
                                     + ', '.join(AXIS_SECTIONS) + suggestion(section,
                                                                             AXIS_SECTIONS))
        if is_machines(rest):
            raise ConfigurationError(key, value, f'{rest} is one for all axes of the machine; an '
                                     f'axis has its own {", ".join(AXIS_SECTIONS)}')
        own.setdefault(axis, {})[rest] = value
    return common, own


def check_axes(own: Mapping[str, Mapping[str, Any]], names: Sequence[str]) -> None:
    """Check that keys are of axes that there are.

    Raises:
        ConfigurationError: They are not.
    """
    for axis, keys in own.items():
        if axis not in names:
            key, value = next(iter(keys.items()))
            known = (f'loop.axes names {", ".join(names)}' if names
                     else 'loop.axes names no axes')
            raise ConfigurationError(axis_key(axis, key), value,
                                     f'{known}, not {axis}{suggestion(axis, names)}')
