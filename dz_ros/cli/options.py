"""Arguments that several verbs share."""

from __future__ import annotations

import argparse
import sys

from dz_ros.core.configuration import Configuration
from dz_ros.files import load_configuration


def add_configuration(parser: argparse.ArgumentParser) -> None:
    """Declare CONFIG, --duration and --set."""
    parser.add_argument('config', nargs='?', default='robust', metavar='CONFIG',
                        help='configuration file, or the name of one that comes with dz_ros, see '
                             'dz list configurations (default: %(default)s)')
    parser.add_argument('--duration', metavar='S',
                        help='length of the run [s], short for --set loop.duration=S')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides',
                        help='change one key of the configuration, the value as YAML, e.g. '
                             'controller.lambda=2; may be repeated')


def add_address(parser: argparse.ArgumentParser) -> None:
    """Declare --host and --port of the page in the browser."""
    parser.add_argument('--host', default='127.0.0.1', metavar='ADDRESS',
                        help='where the page is to be reached; another address than this '
                             "machine's own 127.0.0.1 asks everybody for the printed token")
    parser.add_argument('--port', type=int, default=0, metavar='N',
                        help='port of the page (default: the first free one from 8420 on)')


def read_configuration(arguments: argparse.Namespace) -> Configuration:
    """Return the configuration asked for; say which typed keys it has no use for.

    Raises:
        ConfigurationError: It cannot be used.
    """
    overrides = list(arguments.overrides)
    if arguments.duration is not None:
        overrides.append(f'loop.duration={arguments.duration}')
    configuration = load_configuration(arguments.config, overrides)
    typed = {override.partition('=')[0].strip() for override in overrides}
    for key in configuration.set_aside:
        if key in typed:
            print(f'dz: note: {key} is set aside: {configuration.plant.name}, '
                  f'{configuration.law.name} and {configuration.trajectory.name} do not use it',
                  file=sys.stderr)
    return configuration
