# SPDX-License-Identifier: Apache-2.0
"""``dz completion SHELL``: code for the shell's start-up file that completes verbs and options."""

from __future__ import annotations

import argparse

from dz_ros.errors import MissingDependencyError

SHELLS = ('bash', 'zsh', 'fish')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('shell', choices=SHELLS, help='shell to complete in')


def run(arguments: argparse.Namespace) -> int:
    """Print the code.

    Raises:
        MissingDependencyError: argcomplete is not installed.
    """
    try:
        import argcomplete
    except ImportError:
        raise MissingDependencyError('completion needs argcomplete: pip install '
                                     "'dz_ros[completion]'") from None
    print(argcomplete.shellcode(['dz'], shell=arguments.shell))
    return 0
