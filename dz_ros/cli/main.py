# SPDX-License-Identifier: Apache-2.0
"""``dz``: finds the verb, loads it alone, turns errors into one line and an exit code.

Exit codes: 0 done; 1 something failed while running, or a check found an error; 2 a mistake in
what was asked for; 130 interrupted (Ctrl-C); 141 the reader of the output has gone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
import importlib
import os
import re
import signal
import sys
from typing import Any, NoReturn

from dz_ros.cli.interrupt import INTERRUPTED
from dz_ros.cli.interrupt import line as interrupt_line
from dz_ros.cli.progress import silence
from dz_ros.errors import DzRosError, suggestion
from dz_ros.runtime.import_path import drop_current_folder
from dz_ros.runtime.signals import ENDS, ignore_ends
from dz_ros.version import version

USER_ERROR = 2
BROKEN_PIPE = 128 + 13


@dataclass(frozen=True)
class Verb:
    """One verb of ``dz``.

    Attributes:
        module: Module with ``add_arguments(parser)`` and ``run(arguments) -> int``.
        summary: One line for ``--help``.
        example: Arguments after the verb, as one would type them.
    """

    module: str
    summary: str
    example: str = ''


GROUPS: dict[str, dict[tuple[str, ...], Verb]] = {
    'running loops': {
        ('run',): Verb('run', 'run the loop as ROS 2 nodes, each a process, in real time',
                       'wang2004 --duration 20 --record runs/a --live'),
        ('status',): Verb('status', 'show the diagnostics of running loops, live', '--once'),
        ('estop',): Verb('operator', 'stop a loop: the safe command at both ends, until reset',
                         '--namespace left'),
        ('reset',): Verb('operator', 'release e-stop and faults of a loop, the actuator first',
                         '--namespace left'),
        ('doctor',): Verb('doctor', 'measure what this machine permits a loop, and the gain'),
    },
    'configurations and simulation': {
        ('list',): Verb('listing', 'list plants, laws, trajectories, drivers, configurations, '
                        'keys', 'laws'),
        ('show',): Verb('show', 'print a whole configuration: values, units, sources',
                        'pendulum --set controller.lambda=2'),
        ('check',): Verb('check', 'print what a configuration promises and what it does not',
                         'robust_eso'),
        ('certify',): Verb('certify', 'prove bounds on the error of the sampled, delayed loop',
                           'robust_eso'),
        ('simulate',): Verb('simulate', 'run the loop offline, as fast as the machine goes',
                            'pendulum --csv pendulum.csv'),
        ('tune',): Verb('tune', 'propose gains from bounds, rate, delay and effort',
                        'robust --effort 20 --out tuned.yaml'),
        ('sweep',): Verb('sweep', 'run thousands of loops over keys of a configuration; draw them',
                         'robust --over controller.lambda=1:10:20 --out sweep.csv'),
        ('arena',): Verb('arena', 'compare every law in every scenario', '--laws robust_eso,pid'),
    },
    'recorded runs': {
        ('report',): Verb('report', "make a run's report: figures, timing, table of metrics",
                          'runs/a'),
        ('bag', 'info'): Verb('bag.info', 'print what a recorded run holds', 'runs/a'),
        ('bag', 'import'): Verb('bag.import_', "make a run of another tool's log: CSV or any bag",
                                "log.csv --out runs/log --config axis --map 'stamp=t,x0=x,v=u'"),
        ('bag', 'export'): Verb('bag.export', 'write a run as a table for MATLAB, pandas, '
                                'spreadsheets', 'runs/a --csv'),
        ('bag', 'compare'): Verb('bag.compare', 'put runs side by side: metrics and figures',
                                 'runs/a runs/b'),
        ('bag', 'whatif'): Verb('bag.whatif', 'run a recorded loop again with something changed',
                                'runs/a --set controller.epsilon=0.01'),
        ('bag', 'audit'): Verb('bag.audit', 'recompute a run and compare it bit for bit',
                               'runs/a'),
        ('bag', 'replay'): Verb('bag.replay', 'publish a run again, or feed it to a controller',
                                'runs/a --rate 2'),
        ('bag', 'recover'): Verb('bag.recover', 'make a readable run of one that was cut off',
                                 'runs/a'),
    },
    'actuators': {
        ('driver', 'list'): Verb('driver.list', 'list the drivers, and why one cannot load'),
        ('driver', 'check'): Verb('driver.check', "verify a driver's contract, check by check",
                                  'mock'),
        ('driver', 'emulate'): Verb('driver.emulate', 'be a device, to try its driver without it',
                                    'serial'),
        ('driver', 'commission'): Verb('driver.commission', 'go from a new device to a running '
                                       'loop, step by step', 'serial --out servo-first'),
        ('driver', 'identify'): Verb('driver.identify', 'move a device to find its dead-zone, or '
                                     'read it from a run', '--from runs/a'),
    },
    'the shell': {
        ('completion',): Verb('completion', 'print the code that completes dz in a shell',
                              'bash >> ~/.bashrc'),
    },
}
"""Heading → words → verb; two words are a noun and its verb, as ``ros2`` groups its own."""
VERBS = {path: verb for group in GROUPS.values() for path, verb in group.items()}

NOUNS = {'bag': 'recorded runs', 'driver': 'actuators'}
"""Noun → the subject of its verbs."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, and whose options are never guessed from a prefix.

    Attributes:
        verb: Parser of the verb that was typed; its options are those a misspelt one may mean.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{'allow_abbrev': False, **settings})
        self.verb: Parser = self

    def error(self, message: str) -> NoReturn:
        """End with the exit code of a user's mistake."""
        wrong = re.match(r'unrecognized arguments: (--[^\s=]+)', message)
        if wrong is not None:
            options = re.findall(r'--[a-z][a-z-]*', self.verb.format_help())
            from dz_ros.core.renamed import OPTIONS

            message += (f'; it is called {OPTIONS[wrong[1]]} now' if wrong[1] in OPTIONS
                        else suggestion(wrong[1], options))
        chosen = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        if chosen is not None:
            message += suggestion(chosen[1], re.findall(r"[^', ]+", chosen[2]))
        self.exit(USER_ERROR, f'dz: error: {message}; see {self.verb.prog} --help\n')


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code.

    Args:
        argv: Arguments without the program's name; None = those of this process, which is to end
            after that: signals that ask it to are ignored from then on.
    """
    if argv is None:
        drop_current_folder()
    previous = {number: signal.getsignal(number) for number in ENDS}
    try:
        return _run(list(sys.argv[1:] if argv is None else argv))
    except KeyboardInterrupt as end:
        if argv is None:        # objects that were interrupted half-made have nothing to print
            sys.unraisablehook = lambda _: None
        print(interrupt_line(str(end)), file=sys.stderr)
        return INTERRUPTED
    finally:
        if argv is None:
            ignore_ends()
        else:
            for number, handler in previous.items():
                if signal.getsignal(number) is not handler:
                    signal.signal(number, handler)


def _run(words: Sequence[str]) -> int:
    """Run one command line and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, 'reconfigure'):
            stream.reconfigure(errors='replace')    # a terminal without ε shows ?
    if '_ARGCOMPLETE' in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser_of(os.environ.get('COMP_LINE', '').split()[1:]))
    parser = parser_of(words)
    try:
        if words and words[0] not in {path[0] for path in VERBS} and not words[0].startswith('-'):
            parser.error(f'no verb {words[0]!r}'
                         + suggestion(words[0], {path[0] for path in VERBS}))
        arguments = parser.parse_args(words)
    except SystemExit as end:       # how argparse ends after --help or an error
        return end.code if isinstance(end.code, int) else 0
    if not hasattr(arguments, 'do'):
        arguments.parser.print_help()
        return 0
    if signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, None):
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        silence(any(getattr(arguments, name, False) for name in ('quiet', 'json')))
        if getattr(arguments, 'allow_import', None):
            from dz_ros.core.registry import allow_import

            allow_import(*arguments.allow_import)
        code: int = arguments.do(arguments)
        sys.stdout.flush()
        return code
    except SystemExit as end:
        # No verb ends so: a plant, a law or a driver of the user's own did, whatever its code.
        return _complain(f'code that was imported ended the program: SystemExit({end.code!r})')
    except DzRosError as error:
        return _complain(str(error))
    except BrokenPipeError:
        # Whatever is still in the buffer must not be written when the interpreter ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        place = f'{error.filename}: ' if error.filename else ''
        return _complain(f'{place}{error.strerror or error}')


def _complain(message: str) -> int:
    """Print one line of what is wrong."""
    from dz_ros.core.text import printable

    print(f'dz: error: {printable(" ".join(message.split()))}', file=sys.stderr)
    return USER_ERROR


def parser_of(words: Sequence[str]) -> Parser:
    """Return the parser for these words: every verb by name, the one meant with its arguments."""
    parser = Parser(
        prog='dz', formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Adaptive control behind an actuator with an unknown dead-zone.',
        epilog=_overview())
    parser.set_defaults(parser=parser)
    parser.add_argument('--version', action='version', version=f'dz_ros {version()}')
    verbs = parser.add_subparsers(metavar='VERB', help=argparse.SUPPRESS)
    nouns: dict[str, argparse._SubParsersAction[Parser]] = {}
    for path, verb in VERBS.items():
        group = verbs
        if len(path) == 2:
            noun = path[0]
            if noun not in nouns:
                made = verbs.add_parser(noun, description=f'{NOUNS[noun].capitalize()}.')
                made.set_defaults(parser=made)
                nouns[noun] = made.add_subparsers(metavar='VERB', title='verbs')
            group = nouns[noun]
        own = group.add_parser(path[-1], help=verb.summary,
                               description=f'{verb.summary[0].upper()}{verb.summary[1:]}.')
        if tuple(words[:len(path)]) == path:
            module = importlib.import_module(f'dz_ros.cli.{verb.module}')
            module.add_arguments(own)
            own.epilog = ' '.join(filter(None, (own.epilog, _example(path, verb))))
            own.set_defaults(do=module.run, words=path)
            parser.verb = own.verb = own
    return parser


def _example(path: Sequence[str], verb: Verb) -> str:
    return f'Example: dz {" ".join(path)} {verb.example}'.rstrip()


def _overview() -> str:
    """Return the verbs by group, each with an example."""
    lines = []
    for title, group in GROUPS.items():
        lines.append(f'{title}:')
        for path, verb in group.items():
            lines += [f'  {" ".join(path):17} {verb.summary}',
                      f'  {"":17}   dz {" ".join(path)} {verb.example}'.rstrip()]
        lines.append('')
    return '\n'.join([*lines, 'dz VERB --help: options.'])
