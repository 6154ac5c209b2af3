"""``dz``: finds the verb, loads it alone, turns errors into one line and an exit code.

Exit codes: 0 done; 1 something failed while running, or a check found an error; 2 a mistake in
what was asked for; 130 interrupted (Ctrl-C); 141 nobody reads the output any more.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
import importlib
import os
import sys
from typing import Any, NoReturn

from dz_ros.errors import DzRosError
from dz_ros.version import version

USER_ERROR = 2
INTERRUPTED = 128 + 2
BROKEN_PIPE = 128 + 13


@dataclass(frozen=True)
class Verb:
    """One thing ``dz`` does.

    Attributes:
        module: Module with ``add_arguments(parser)`` and ``run(arguments) -> int``.
        summary: One line for ``--help``.
    """

    module: str
    summary: str


VERBS = {
    ('run',): Verb('run', 'run the loop as ROS 2 nodes, each a process, in real time'),
    ('status',): Verb('status', 'show how the nodes of running loops are, live'),
    ('estop',): Verb('estop', 'stop a loop: the safe command at both ends, until reset'),
    ('reset',): Verb('reset', 'release e-stop and faults of a loop, the actuator first'),
    ('doctor',): Verb('doctor', 'say what this machine permits a loop and what that would gain'),
    ('simulate',): Verb('simulate', 'run the loop off line, as fast as the machine goes'),
    ('check',): Verb('check', 'say what a configuration promises and what it does not'),
    ('arena',): Verb('arena', 'compare every law in every scenario'),
    ('sweep',): Verb('sweep', 'run thousands of loops over keys of a configuration; draw them'),
    ('tune',): Verb('tune', 'propose gains from bounds, rate, delay and effort'),
    ('driver', 'identify'): Verb('driver_identify', 'move a device to find its dead-zone, or read '
                                 'it from a run'),
    ('driver', 'emulate'): Verb('driver_emulate', 'be a device, to try its driver without it'),
    ('report',): Verb('report', "make a run's report: figures, timing, table of metrics"),
    ('list',): Verb('listing', 'list plants, laws, trajectories or configurations'),
    ('bag', 'info'): Verb('bag_info', 'say what a recorded run holds'),
    ('bag', 'replay'): Verb('bag_replay', 'publish a run again, or feed it to a controller'),
    ('bag', 'recover'): Verb('bag_recover', 'make a readable run of one that was cut off'),
    ('bag', 'audit'): Verb('bag_audit', 'recompute a run and compare it bit for bit'),
    ('bag', 'compare'): Verb('bag_compare', 'lay runs side by side: metrics and figures'),
    ('bag', 'whatif'): Verb('bag_whatif', 'run a recorded loop again with something changed'),
    ('driver', 'list'): Verb('driver_list', 'list the drivers, and why one cannot load'),
    ('driver', 'check'): Verb('driver_check', 'hold a driver to its contract, check by check'),
}
"""Words → verb; two words are a noun and its verb, as ``ros2`` groups its own."""

NOUNS = {'bag': 'recorded runs', 'driver': 'actuators'}
"""Noun → what its verbs are about."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, and whose options are never guessed from a prefix."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{'allow_abbrev': False, **settings})

    def error(self, message: str) -> NoReturn:
        """End with the exit code of a user's mistake."""
        self.exit(USER_ERROR, f'dz: error: {message}; {self.prog} --help says more\n')


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code.

    Args:
        argv: Arguments without the program's name; None = those of this process.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, 'reconfigure'):
            stream.reconfigure(errors='replace')    # a terminal without ε shows ?
    try:
        arguments = _parser(words).parse_args(words)
        code: int = arguments.do(arguments)
        sys.stdout.flush()
        return code
    except SystemExit as end:       # how argparse ends after --help or an error
        return end.code if isinstance(end.code, int) else 0
    except DzRosError as error:
        return _complain(str(error))
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # Whatever is still in the buffer must not be written when the interpreter ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        place = f'{error.filename}: ' if error.filename else ''
        return _complain(f'{place}{error.strerror or error}')


def _complain(message: str) -> int:
    """Print one line of what is wrong."""
    print(f'dz: error: {" ".join(message.split())}', file=sys.stderr)
    return USER_ERROR


def _parser(words: Sequence[str]) -> Parser:
    """Return the parser for these words: every verb by name, the one meant with its arguments."""
    parser = Parser(
        prog='dz', description='Adaptive control behind an actuator with an unknown dead-zone.',
        epilog='dz VERB --help says more.')
    parser.add_argument('--version', action='version', version=f'dz_ros {version()}')
    verbs = parser.add_subparsers(metavar='VERB', required=True, title='verbs')
    nouns: dict[str, argparse._SubParsersAction[Parser]] = {}
    for path, verb in VERBS.items():
        group = verbs
        if len(path) == 2:
            noun = path[0]
            if noun not in nouns:
                below = [item for item in VERBS if item[0] == noun]
                summary = f'{NOUNS[noun]}: {", ".join(item[1] for item in below)}'
                nouns[noun] = verbs.add_parser(noun, help=summary, description=summary)\
                    .add_subparsers(metavar='VERB', required=True, title='verbs')
            group = nouns[noun]
        own = group.add_parser(path[-1], help=verb.summary,
                               description=f'{verb.summary[0].upper()}{verb.summary[1:]}.')
        if tuple(words[:len(path)]) == path:
            module = importlib.import_module(f'dz_ros.cli.{verb.module}')
            module.add_arguments(own)
            own.set_defaults(do=module.run)
    return parser
