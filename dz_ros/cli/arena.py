# SPDX-License-Identifier: Apache-2.0
"""``dz arena``: every law in every scenario, side by side."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from dz_ros.cli.interrupt import NOTHING_KEPT, prompt_end
from dz_ros.cli.progress import Progress, stage
from dz_ros.core.loop.compiled import available
from dz_ros.errors import ConfigurationError
from dz_ros.studies.arena import Plan, run_arena
from dz_ros.studies.arena_page import conditions, format_beaten, format_text, write_arena
from dz_ros.studies.entrants import IDEAL
from dz_ros.studies.scenarios import DURATION, SEEDS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('--laws', metavar='NAME,…', help='only these laws (default: all)')
    parser.add_argument('--scenarios', metavar='NAME;…',
                        help='only these scenarios, separated by semicolons (default: all)')
    parser.add_argument('--duration', type=float, default=DURATION, metavar='S',
                        help='length of every run [s] (default: %(default)s)')
    parser.add_argument('--seeds', type=int, default=SEEDS, metavar='N',
                        help='runs of the scenario with noise (default: %(default)s)')
    parser.add_argument('-j', '--jobs', type=int, default=0, metavar='N',
                        help='processes (default: one for each core)')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='write the page, its pictures and the CSV there')
    parser.add_argument('--csv', action='store_true',
                        help='every run as CSV on the standard output instead of tables')
    parser.add_argument('--ros', action='store_true',
                        help='run the first member of each chosen scenario as ROS nodes in '
                             'lockstep as well, and compare bit for bit with the offline loop')
    parser.add_argument('--retune', type=Path, metavar='FILE',
                        help="tune every law's free gains for each scenario and over all of "
                             'them, but the ideal ones; finished searches are kept in FILE and '
                             'not made again')
    parser.add_argument('--budget', type=int, default=400, metavar='N',
                        help='with --retune: gains tried in each search (default: %(default)s)')
    parser.add_argument('--searches', type=int, default=3, metavar='N',
                        help='with --retune: searches, each of its own seed (default: '
                             '%(default)s)')
    parser.add_argument('--cluster', metavar='ADDRESS',
                        help='with --retune: of a dask.distributed scheduler')
    parser.add_argument('--list', action='store_true', help='list laws and scenarios')
    parser.add_argument('--quiet', action='store_true', help='no progress')


def run(arguments: argparse.Namespace) -> int:
    """Compare; print tables; write what was asked for."""
    plan = plan_of(arguments)
    if arguments.list:
        for entrant in plan.entrants.values():
            print(f'{entrant.name:20} {entrant.summary}')
        for scenario in plan.scenarios.values():
            print(f'{scenario.name:20} {scenario.summary}')
        return 0
    if arguments.retune is not None:
        return _retune(arguments, plan)
    if arguments.ros:
        from dz_ros.cli.arena_ros import compare_with_ros
        try:
            return compare_with_ros(plan, quiet=arguments.quiet)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(NOTHING_KEPT) from None
    if not available() and not arguments.quiet:
        print("dz: note: without numba this takes long: pip install 'dz_ros[numba]'",
              file=sys.stderr)
    with prompt_end():
        arena = run_arena(plan, arguments.jobs, progress=Progress(plan.runs))
    if arguments.csv:
        print(arena.csv(), end='')
    else:
        print(format_text(arena), '', conditions(arena), '', format_beaten(arena), sep='\n')
    if arguments.out is not None:
        with prompt_end(lambda: 'the tables are whole, the page is not; the same command begins '
                        'again'), stage('drawing the page'):
            page = write_arena(arena, arguments.out)
        print(page, file=sys.stderr if arguments.csv else sys.stdout)
    return 0


def _retune(arguments: argparse.Namespace, plan: Plan) -> int:
    """Tune every law; print the tables."""
    from dz_ros.studies.retune import retune
    from dz_ros.studies.retune_page import (
        errors_table,
        gains_table,
        margins_table,
        summary,
        table,
    )

    for key, value, least in (('--budget', arguments.budget, 1),
                              ('--searches', arguments.searches, 1)):
        if value < least:
            raise ConfigurationError(key, value, f'must be at least {least}')
    laws = {name: item for name, item in plan.entrants.items() if not name.startswith(IDEAL)}
    searches = len(laws) * (1 + len(plan.scenarios)) * arguments.searches
    with prompt_end(lambda: f'finished searches are kept in {arguments.retune}; the same command '
                            'goes on'):
        found = retune(laws, list(plan.scenarios), arguments.retune, plan.duration, plan.seeds,
                       arguments.searches, arguments.budget, arguments.jobs, arguments.cluster,
                       Progress(searches))
    print(*summary(found), '', *table(found), '', *gains_table(found), '', *errors_table(found),
          '', *margins_table(found), sep='\n')
    return 0


def plan_of(arguments: argparse.Namespace) -> Plan:
    """Return what is to be compared.

    Raises:
        ConfigurationError: A duration or number of seeds that is not one, an unknown name.
    """
    if not 1.0 <= arguments.duration <= 1e5:
        raise ConfigurationError('--duration', arguments.duration, 'must be 1 to 100000 s')
    if not 1 <= arguments.seeds <= 10000:
        raise ConfigurationError('--seeds', arguments.seeds, 'must be 1 to 10000')
    if arguments.jobs < 0:
        raise ConfigurationError('--jobs', arguments.jobs, 'must be 0 (all cores) or more')
    laws = names(arguments.laws, ',')
    return Plan.of(laws, names(arguments.scenarios, ';'), arguments.duration, arguments.seeds)


def names(text: str | None, separator: str) -> list[str] | None:
    """Return the names of a list as typed."""
    if text is None:
        return None
    return [item.strip() for item in text.split(separator) if item.strip()]
