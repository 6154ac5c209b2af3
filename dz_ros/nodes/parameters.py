"""ROS parameters from the one schema: overrides → checked configuration → declared parameters.

A node declares the sections it uses, every key with description, unit and range. What a node was
given is checked as a whole before anything is declared, so a user's mistake is one line in the
words of the schema.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
import math
from pathlib import Path
import sys
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dz_ros.core.configuration import Configuration, SECTIONS
from dz_ros.core.schema import Field, fields, parameter
from dz_ros.files import resolve_waypoints


@dataclass(frozen=True)
class PlantStructure:
    """What a controller or a trajectory needs to know of the plant's section."""

    model: str = parameter('wang2004', '', 'name of the plant, or package.module:Class',
                           structural=True)


_TYPES = {'float': Parameter.Type.DOUBLE, 'int': Parameter.Type.INTEGER,
          'bool': Parameter.Type.BOOL, 'str': Parameter.Type.STRING,
          'floats': Parameter.Type.DOUBLE_ARRAY, 'strings': Parameter.Type.STRING_ARRAY}


def overrides(node: Node, names: Container[str]) -> dict[str, Any]:
    """Return what the node was given on its command line or in parameter files.

    Args:
        node: The node.
        names: First parts of the keys wanted.
    """
    # rclpy offers no public way to see overrides of parameters that are not declared yet.
    given: Mapping[str, Parameter] = node._parameter_overrides
    found = {}
    for key, item in given.items():
        if key.partition('.')[0] in names:
            value = item.value
            found[key] = list(value) if isinstance(value, (tuple, list)) or hasattr(
                value, 'tolist') else value
    return found


def descriptor(item: Field) -> ParameterDescriptor:
    """Return description, unit and range of a parameter as ROS shows them."""
    spec = item.spec
    unit = f' [{spec.unit}]' if spec.unit else ''
    fixed = 'fixed: stop the loop and start it with another value' if spec.structural else ''
    made = ParameterDescriptor(type=_TYPES[item.kind].value, read_only=spec.structural,
                               description=spec.description + unit, additional_constraints='; '
                               .join(part for part in (spec.range_text(), fixed) if part))
    bounded = math.isfinite(spec.minimum) or math.isfinite(spec.maximum)
    if bounded and item.kind == 'float':
        made.floating_point_range = [FloatingPointRange(
            from_value=max(spec.minimum, -sys.float_info.max),
            to_value=min(spec.maximum, sys.float_info.max))]
    if bounded and item.kind == 'int':
        made.integer_range = [IntegerRange(from_value=int(max(spec.minimum, -2 ** 63)),
                                           to_value=int(min(spec.maximum, 2 ** 63 - 1)), step=1)]
    return made


def declare(node: Node, prefix: str, group: Any) -> None:
    """Declare every parameter of a group with the value it has.

    Values are given as overrides of their own, already checked and converted, so that an integer
    written for a float in a file is no error.
    """
    for item in fields(type(group)):
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

    Args:
        node: The node.
        *sections: Of loop (which brings process), safety, plant, structure (the plant's model and
            parameters alone, which is what a controller may know of it), controller, trajectory,
            driver, device (plant where the driver simulates it, structure otherwise). Without
            plant and driver the driver need not be installed.

    Raises:
        ConfigurationError: A key nobody knows or a value that is not allowed.
    """
    flat = overrides(node, SECTIONS)
    resolve_waypoints(flat, Path())     # relative to where the node was started
    c = Configuration.from_flat(flat, driven='plant' in sections or 'driver' in sections)
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
            declare(node, prefix, group)
    return c
