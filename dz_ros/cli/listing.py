# SPDX-License-Identifier: Apache-2.0
"""``dz list [KIND [PART]]``: what a configuration can choose from, and every key it can have."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
import re

from dz_ros.core.configuration import every_field
from dz_ros.core.driven import DRIVERS
from dz_ros.core.laws import LAWS
from dz_ros.core.plants import PLANTS
from dz_ros.core.registry import Registry
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.errors import ConfigurationError, DzRosError, suggestion
from dz_ros.files.configurations import shipped_configurations

Lines = Iterator[tuple[str, str]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('kind', nargs='?', metavar='KIND',
                        help=f'{", ".join(KINDS)} (default: all)')
    parser.add_argument('part', nargs='?', default='', metavar='PART',
                        help='only what has this in its name, e.g. dz list keys lambda')


def run(arguments: argparse.Namespace) -> int:
    """Print one line for each item: its name and what it is."""
    kind = arguments.kind
    if kind is not None and kind not in KINDS:
        raise ConfigurationError('KIND', kind, f'must be one of {", ".join(KINDS)}'
                                 f'{suggestion(kind, KINDS)}; see dz list --help')
    for name in KINDS if kind is None else (kind,):
        if kind is None:
            print(f'{name}:')
        lines = [line for line in KINDS[name]() if arguments.part.lower() in line[0].lower()]
        width = max((len(item) for item, _ in lines), default=0)
        for item, summary in lines:
            print(f'{"" if kind else "  "}{item:<{width}}  {summary}')
        if arguments.part and not lines:
            known = [item for item, _ in KINDS[name]()]
            raise ConfigurationError('PART', arguments.part, f'no name in {kind} has it'
                                     + suggestion(arguments.part.lower(), known))
    return 0


def _registered(registry: Registry) -> Callable[[], Lines]:
    """Return a function that yields (name, summary) of a registry, with errors of broken ones."""
    def found() -> Lines:
        for name, item in registry.all().items():
            yield name, (f'(not usable) {item}' if isinstance(item, DzRosError)
                         else str(item.summary))
    return found


def _configurations() -> Lines:
    """Yield (name, first sentence of the comment at the top) of the shipped configurations."""
    for name, path in shipped_configurations().items():
        words: list[str] = []
        for line in path.read_text(encoding='utf-8').splitlines():
            if not line.startswith('#'):
                break
            words += line.lstrip('#').split()
        # A sentence ends before a capital letter; "et al. 2022" goes on.
        yield name, re.split(r'\.(?: (?=[A-Z])|$)', ' '.join(words))[0]


def _keys() -> Lines:
    """Yield (key, meaning, unit, range, default) of every key of every installed class."""
    for key, field in every_field().items():
        details = [field.unit and f'[{field.unit}]', field.spec.range_text(),
                   f'default {field.default!r}']
        yield key, f'{field.spec.description}; {", ".join(filter(None, details))}'


KINDS: Mapping[str, Callable[[], Lines]] = {
    'plants': _registered(PLANTS), 'laws': _registered(LAWS),
    'trajectories': _registered(TRAJECTORIES), 'drivers': _registered(DRIVERS),
    'configurations': _configurations, 'keys': _keys}
