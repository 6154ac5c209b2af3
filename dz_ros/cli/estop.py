"""``dz estop``: the safe command at both ends of a loop, at once and until reset."""

from __future__ import annotations

import argparse

from dz_ros.cli.operator import add_namespace, do_once


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_namespace(parser)


def run(arguments: argparse.Namespace) -> int:
    """Do it; return 0, or 2 where a node is not there or refuses."""
    return do_once('estop', arguments.namespace)
