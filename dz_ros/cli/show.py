# SPDX-License-Identifier: Apache-2.0
"""``dz show CONFIG``: the whole configuration a run would have: values, units, sources."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import json
from typing import Any

from dz_ros.cli.options import add_configuration, configuration_overrides, read_machine
from dz_ros.cli.output import print_json, print_lines
from dz_ros.core.axes_keys import axis_key, is_machines, parts
from dz_ros.core.configuration import Configuration
from dz_ros.core.units import Units
from dz_ros.files.configurations import find_configuration, flat_parameters

LONGEST = 60
"""Characters of a value that are shown; all with --json."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--json', action='store_true', help='one JSON object, keys to values')


def run(arguments: argparse.Namespace) -> int:
    """Print each key with its value, unit and source."""
    configuration = read_machine(arguments)
    if arguments.json:
        print_json(configuration.to_flat())
        return 0
    given = flat_parameters(arguments.config, (), arguments.namespace)
    typed = flat_parameters(None, configuration_overrides(arguments))
    print_lines(f'{arguments.config}: {find_configuration(arguments.config)}')
    if arguments.axis is not None:
        given, typed = (axis_values(item, arguments.axis) for item in (given, typed))
    if not configuration.axes:
        print_lines(lines(configuration, given, typed))
        return 0
    print_lines(lines(configuration, given, typed, is_machines))
    for name, item in configuration.axes:
        print_lines(lines(item, axis_values(given, name), axis_values(typed, name),
                          lambda key: not is_machines(key), axis_key(name, '')))
    return 0


def axis_values(flat: dict[str, Any], axis: str) -> dict[str, Any]:
    """Return the keys that give values of an axis, its own and those of all."""
    return {parts(key)[1]: value for key, value in flat.items() if parts(key)[0] in ('', axis)}


def lines(c: Configuration, given: dict[str, Any], typed: dict[str, Any],
          wanted: Callable[[str], bool] = lambda key: bool(key),
          prefix: str = '') -> Iterator[str]:
    """Yield a line for each key, by section, then the keys that are set aside.

    Args:
        c: The configuration.
        given: Keys of the file.
        typed: Keys of the command line.
        wanted: Whether a key is to be shown.
        prefix: Put before each key: that of an axis.
    """
    known = c.fields()
    units = Units.of(c.plant)
    width = len(prefix) + max(len(key) for key in known if not parts(key)[0])
    for key, value in c.to_flat().items():
        if parts(key)[0] or not wanted(key):
            continue
        unit = _unit(units, known[key].spec.unit)
        text = json.dumps(value, ensure_ascii=False)
        text = text if len(text) <= LONGEST else f'{text[:LONGEST]}…'
        source = '--set' if key in typed else 'file' if key in given else 'default'
        shown = f'[{unit}]' if unit not in ('', '1') else ''
        yield f'{prefix + key:<{width}}  {text} {shown}'.rstrip() + f'  ({source})'
    for key in filter(wanted, c.set_aside):
        reason = (f'does not fit {c.plant.name}' if key in c.misfitting
                  else 'another class of its section owns it')
        yield f'{prefix + key:<{width}}  set aside: {reason}'


def _unit(units: Units, text: str) -> str:
    """Return the unit of a parameter for a plant; of a list with different ones each of them."""
    if text == 'state units':
        return ', '.join(units.state)
    return units.resolve_words(text)
