# SPDX-License-Identifier: Apache-2.0
"""``dz driver list``: what is installed, its order and units, and why one cannot load."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from importlib.util import find_spec
import textwrap
from typing import Any

from dz_ros.cli.output import print_json
from dz_ros.core import schema
from dz_ros.core.driven import DRIVERS
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.hosted import error_text
from dz_ros.errors import DzRosError

WIDTH = 88
STEPS = {'resolution': 'the position', 'command_resolution': 'the command'}
"""Attribute of a driver, the step of a signal, and that signal."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('--json', action='store_true', help='as JSON, parameters included')


def run(arguments: argparse.Namespace) -> int:
    """Print two lines for each driver; return 0."""
    rows = [describe(name, found) for name, found in DRIVERS.all().items()]
    if arguments.json:
        print_json(rows)
        return 0
    width = max(len(row['name']) for row in rows)
    for row in rows:
        print(f'{row["name"]:<{width}}  {row["summary"] or "(not usable)"}')
        for line in _details(row):
            print(f'{"":<{width}}  {line}')
    return 0


def describe(name: str, found: Any) -> dict[str, Any]:
    """Return what is known of a driver, with what keeps it from loading."""
    row: dict[str, Any] = {'name': name, 'summary': '', 'order': None, 'units': '', 'from': '',
                           'simulated': None, 'steps': [], 'missing': [], 'error': '',
                           'parameters': []}
    if isinstance(found, DzRosError):
        row['error'] = str(found)
        return row
    try:
        return row | _read(found)
    except Exception as error:  # noqa: BLE001  a foreign class must not end the list
        return row | {'error': error_text('cannot be read', error)}


def _read(found: Any) -> dict[str, Any]:
    """Return the attributes of a driver's class."""
    own = found.state_units is not Driver.state_units or (
        found.command_unit is not Driver.command_unit)
    return {
        'summary': str(found.summary), 'order': int(found.order),
        'units': 'of its own' if own else "the plant's",
        'steps': [key for key in STEPS if getattr(found, key) is not getattr(Driver, key)],
        'from': f'{found.__module__}:{found.__name__}', 'simulated': bool(found.lockstep),
        'missing': [module for module in found.requires if not is_there(module)],
        'parameters': [f'driver.{item.name}' for item in schema.fields(found.Parameters)]}


def _details(row: dict[str, Any]) -> Iterator[str]:
    """Yield the lines below a driver's name."""
    if row['error']:
        yield row['error']
        return
    order = 'any order' if row['order'] == 0 else f'order {row["order"]}'
    kind = ', simulated' if row['simulated'] else ''
    yield f'{order}, units {row["units"]}{kind}; {row["from"]}'
    for key, words in STEPS.items():
        yield f'step of {words}: ' + (f'its own, or driver.{key}' if key in row['steps'] else
                                      f'driver.{key}')
    if row['parameters']:
        yield from textwrap.wrap(' '.join(row['parameters']), WIDTH)
    if row['missing']:
        yield f'cannot be opened here: {", ".join(row["missing"])} is not installed'


def is_there(module: str) -> bool:
    """Return whether a module is installed."""
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):
        return False
