# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from the one schema: overrides → checked configuration → declared parameters.

A node declares the sections it uses, every key with description, unit and range. What a node was
given is checked as a whole before anything is declared, so a user's mistake is one line in the
words of the schema.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dz_ros.core.axes_keys import AXES, axis_key, is_machines, parts
from dz_ros.core.configuration import Configuration, SECTIONS
from dz_ros.core.schema import Field, fields, parameter
from dz_ros.files.configurations import resolve_waypoints


@dataclass(frozen=True)
class PlantStructure:
    """The part of the plant's section that a controller or a trajectory needs."""

    model: str = parameter('wang2004', '', 'name of the plant, or package.module:Class',
                           structural=True)


PARAMETER_TYPES = {'float': Parameter.Type.DOUBLE, 'int': Parameter.Type.INTEGER,
                   'bool': Parameter.Type.BOOL, 'str': Parameter.Type.STRING,
                   'floats': Parameter.Type.DOUBLE_ARRAY, 'strings': Parameter.Type.STRING_ARRAY}


def overrides(node: Node, names: Container[str]) -> dict[str, Any]:
    """Return what the node was given, on its command line or in files, of some sections."""
    # rclpy offers no public way to see overrides of parameters that are not declared yet.
    given: Mapping[str, Parameter] = node._parameter_overrides
    found = {}
    for key, item in given.items():
        if key.partition('.')[0] in names:
            # An empty array has no type, so rcl calls it not set.
            value = [] if item.type_ == Parameter.Type.NOT_SET else item.value
            found[key] = list(value) if isinstance(value, (tuple, list)) or hasattr(
                value, 'tolist') else value
    return found


def descriptor(item: Field) -> ParameterDescriptor:
    """Return description, unit and range as ROS shows them; a range open at an end is text."""
    spec = item.spec
    unit = f' [{item.unit}]' if item.unit else ''
    fixed = 'fixed: stop the loop and start it with another value' if spec.structural else ''
    made = ParameterDescriptor(type=PARAMETER_TYPES[item.kind].value, read_only=spec.structural,
                               description=spec.description + unit, additional_constraints='; '
                               .join(part for part in (spec.range_text(), fixed) if part))
    bounded = math.isfinite(spec.minimum) and math.isfinite(spec.maximum)
    if bounded and item.kind == 'float':
        made.floating_point_range = [FloatingPointRange(from_value=float(spec.minimum),
                                                        to_value=float(spec.maximum))]
    if bounded and item.kind == 'int' and spec.maximum < 2 ** 63 - 1:
        made.integer_range = [IntegerRange(from_value=int(spec.minimum),
                                           to_value=int(spec.maximum), step=1)]
    return made


def declare(node: Node, prefix: str, group: Any,
            wanted: Callable[[str], bool] = lambda key: bool(key)) -> None:
    """Declare every parameter of a group with the value it has.

    Values are given as overrides of their own, already checked and converted, so that an integer
    written for a float in a file is no error.

    Args:
        node: The node.
        prefix: Section.
        group: Values.
        wanted: Whether a key, without its axis, is to be declared.
    """
    for item in fields(type(group)):
        if not wanted(parts(f'{prefix}.{item.name}')[1]):
            continue
        value = getattr(group, item.attribute)
        if isinstance(value, tuple):
            value = list(value)
        name = f'{prefix}.{item.name}'
        node._parameter_overrides.pop(name, None)
        if node.has_parameter(name):
            continue
        made = descriptor(item)
        if value == []:
            # An empty array has no type of its own in rclpy; left unset it means the default.
            made.dynamic_typing = True
            node.declare_parameter(name, None, made)
        else:
            node.declare_parameter(name, value, made)


def configure(node: Node, *sections: str) -> Configuration:
    """Return the configuration a node was given, with the sections it uses declared.

    The whole configuration is checked, whatever the node uses of it, so that parts that do not
    fit together are found by each of them.

    Of several axes, the machine's keys are declared and those of each axis, ``axes.NAME.…``; keys
    of all axes only give those their values.

    Args:
        node: The node.
        *sections: Of loop (which brings process), safety, plant, structure (the plant's model and
            parameters alone, which is what a controller may know of it), controller, trajectory,
            driver, device (plant where the driver simulates it, structure otherwise). Without
            plant and driver the driver need not be installed.

    Raises:
        ConfigurationError: An unknown key or a value that is not allowed.
    """
    flat = overrides(node, (*SECTIONS, AXES))
    resolve_waypoints(flat, Path())     # relative to where the node was started
    c = Configuration.from_flat(flat, driven='plant' in sections or 'driver' in sections)
    if not c.axes:
        _declare_sections(node, c, sections, '', lambda _: True)
        return c
    _declare_sections(node, c, sections, '', is_machines)
    for axis, own in c.axes:
        _declare_sections(node, own, sections, axis_key(axis, ''),
                          lambda key: not is_machines(key))
    return c


def _declare_sections(node: Node, c: Configuration, sections: Sequence[str], before: str,
                      wanted: Callable[[str], bool]) -> None:
    """Declare the sections that a node uses, of an axis with its prefix."""
    groups = {
        'loop': (('loop', c.loop), ('process', c.process)),
        'safety': (('safety', c.safety),),
        'plant': (('plant', c.plant_settings), ('plant', c.plant.parameters),
                  ('plant.dead_zone', c.dead_zone)),
        'structure': (('plant', PlantStructure(c.plant_settings.model)),
                      ('plant', c.plant.parameters)),
        'controller': (('controller', c.controller_settings), ('controller', c.law.gains)),
        'trajectory': (('trajectory', c.trajectory_settings),
                       ('trajectory', c.trajectory.parameters)),
        'driver': (('driver', c.driver_settings), ('driver', c.driver_parameters)),
    }
    groups['device'] = groups['plant' if c.driver_class.lockstep else 'structure']
    for section in sections:
        for prefix, group in groups[section]:
            declare(node, f'{before}{prefix}', group, wanted)
