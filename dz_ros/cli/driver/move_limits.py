# SPDX-License-Identifier: Apache-2.0
"""Limits and plan of moves that are given on a command line."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, TypeVar

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.errors import ConfigurationError
from dz_ros.identification.experiment.plan import Limits, Plan

Group = TypeVar('Group', Limits, Plan)


def add_limits(parser: argparse.ArgumentParser, title: str) -> Any:
    """Declare an option for each limit and each key of the plan; return the group they are in."""
    group = parser.add_argument_group(title)
    for item in (*schema.fields(Limits), *schema.fields(Plan)):
        group.add_argument(f'--{item.name}', type=int if item.kind == 'int' else float,
                           metavar=item.name[0].upper(), help=f'{item.spec.description}'
                           f' [{item.spec.unit}]' + (f' (default: {item.default:g})'
                                                     if item.default else ''))
    return group


def given_limits(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return name → value of the options that were given."""
    names = [item.name for kind in (Limits, Plan) for item in schema.fields(kind)]
    return {name: getattr(arguments, name) for name in names
            if getattr(arguments, name) is not None}


def needed_limits(c: Configuration) -> dict[str, str]:
    """Return name → unit of the limits that have no default."""
    driver = c.make_driver()
    found = {'travel': driver.state_units[0], 'effort': driver.command_unit}
    if c.plant.order > 1:
        found['speed'] = driver.state_units[1]
    return found


def build_limits(given: Mapping[str, Any], c: Configuration) -> tuple[Limits, Plan]:
    """Return limits and plan of values by name.

    Raises:
        ConfigurationError: One is missing or not allowed, or the device allows less.
    """
    for name, unit in needed_limits(c).items():
        if name not in given:
            raise ConfigurationError(f'--{name}', None, f'must be given [{unit}]: only you know '
                                     f'what {c.make_driver().name} may do where it stands')

    def built(kind: type[Group]) -> Group:
        return schema.build(kind, {item.name: given[item.name] for item in schema.fields(kind)
                                   if item.name in given}, '--')

    limits, plan = built(Limits), built(Plan)
    if c.plant.order > 1 and limits.speed <= 0.0:
        raise ConfigurationError('--speed', limits.speed, 'must be > 0')
    least = min(HostedDriver(c).limit, c.plant_settings.command_limit or limits.effort,
                c.safety.command_limit or limits.effort)
    if limits.effort > least:
        raise ConfigurationError('--effort', limits.effort, f'must be <= {least:g}, the limit of '
                                 'the device or of the configuration')
    return limits, plan
