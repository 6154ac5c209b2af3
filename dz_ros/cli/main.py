# SPDX-License-Identifier: Apache-2.0
"""``dz``: finds the verb, loads it alone, turns errors into one line and an exit code.

Exit codes: 0 done; 1 something failed while running, or a check found an error; 2 a mistake in
what was asked for; 130 interrupted (Ctrl-C); 141 the reader of the output has gone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import importlib
import os
import re
import signal
import sys
from typing import Any, NoReturn

from dz_ros.cli import forked
from dz_ros.cli.interrupt import INTERRUPTED
from dz_ros.cli.interrupt import line as interrupt_line
from dz_ros.cli.progress import silence
from dz_ros.cli.verbs import GROUPS, NOUNS, Verb, VERBS
from dz_ros.errors import DzRosError, suggestion
from dz_ros.runtime.import_path import drop_current_folder
from dz_ros.runtime.os_signals import ENDS, ignore_ends, restore_handlers
from dz_ros.version import version

USER_ERROR = 2
BROKEN_PIPE = 128 + 13


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
            # Not its help, whose examples have options of verbs; without the dashes all have.
            options = re.findall(r'--([a-z][a-z-]*)', self.verb.format_usage())
            from dz_ros.core.renamed import OPTIONS

            message += (f'; it is called {OPTIONS[wrong[1]]} now' if wrong[1] in OPTIONS
                        else suggestion(wrong[1].lstrip('-'), options, '--'))
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
        forked.allow(sys.argv[1:])
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
            restore_handlers(previous)


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
