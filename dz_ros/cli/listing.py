"""``dz list plants|laws|trajectories|configurations``: what a configuration can choose from."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import re

from dz_ros.core.registry import Registry
from dz_ros.errors import DzRosError
from dz_ros.files import shipped_configurations

KINDS = ('plants', 'laws', 'trajectories', 'configurations')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('kind', choices=KINDS, metavar='KIND', help=', '.join(KINDS))


def run(arguments: argparse.Namespace) -> int:
    """Print one line for each thing: its name and what it is."""
    lines = list(_configurations() if arguments.kind == 'configurations'
                 else _registered(arguments.kind))
    width = max((len(name) for name, _ in lines), default=0)
    for name, summary in lines:
        print(f'{name:<{width}}  {summary}')
    return 0


def _registered(kind: str) -> Iterator[tuple[str, str]]:
    """Yield (name, summary) of ours and of what other packages bring, with what ails them."""
    from dz_ros.core.laws import LAWS
    from dz_ros.core.plants import PLANTS
    from dz_ros.core.trajectories import TRAJECTORIES

    registries: dict[str, Registry] = {'plants': PLANTS, 'laws': LAWS,
                                       'trajectories': TRAJECTORIES}
    for name, found in registries[kind].all().items():
        if isinstance(found, DzRosError):
            yield name, f'(not usable) {found}'
        else:
            yield name, found.summary


def _configurations() -> Iterator[tuple[str, str]]:
    """Yield (name, first sentence of the comment at the top) of the shipped configurations."""
    for name, path in shipped_configurations().items():
        words: list[str] = []
        for line in path.read_text(encoding='utf-8').splitlines():
            if not line.startswith('#'):
                break
            words += line.lstrip('#').split()
        # A sentence ends before a capital letter; "et al. 2022" goes on.
        yield name, re.split(r'\.(?: (?=[A-Z])|$)', ' '.join(words))[0]
