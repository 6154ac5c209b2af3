"""``dz check``: what a configuration promises and what it does not, rule by rule.

Exit code 0 where it may run, warnings or not; 1 where a rule finds an error. controller_node
applies the same rules when it starts and refuses on the same errors
(`controller.override_checks` starts it all the same). Of λ it only tries whether the loop is lost
from x(0) with the one configured; how far that is from the limit is found here.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import asdict
import json
import textwrap

from dz_ros.analysis.metrics import jsonable
from dz_ros.cli.options import add_configuration, read_configuration
from dz_ros.core.configuration import Configuration
from dz_ros.core.design_rules import check
from dz_ros.core.finding import ERROR, Finding, INFO, WARNING, worst
from dz_ros.core.stability import has_slope, lambda_limit
from dz_ros.errors import ConfigurationError

FOUND_ERRORS = 1
WIDTH = 96


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--disturbance', type=float, metavar='D',
                        help='largest disturbance to withstand, in the unit of x^(n); without '
                             "this what the plant's model gives along the reference")
    parser.add_argument('--quick', action='store_true',
                        help='leave out the stability limit on lambda, which takes simulations')
    parser.add_argument('--json', action='store_true', help='every finding as JSON')


def run(arguments: argparse.Namespace) -> int:
    """Check; print a block for each finding; return 1 where one is an error."""
    disturbance = arguments.disturbance
    if disturbance is not None and not 0.0 <= disturbance < float('inf'):
        raise ConfigurationError('--disturbance', disturbance, 'must be a finite number >= 0')
    configuration = read_configuration(arguments)
    findings = check(configuration, disturbance,
                     None if arguments.quick else stability_limit(configuration))
    if arguments.json:
        print(json.dumps({'worst': worst(findings),
                          'findings': [jsonable(asdict(item)) for item in findings]},
                         ensure_ascii=False, indent=2))
    else:
        print(format_findings(findings))
    return FOUND_ERRORS if worst(findings) == ERROR else 0


def stability_limit(configuration: Configuration) -> float | None:
    """Return the largest λ of a calm loop [1/s]; None where the law has no λ."""
    return lambda_limit(configuration) if has_slope(configuration) else None


def format_findings(findings: Iterable[Finding]) -> str:
    """Return a block for each finding, the gravest last, where a terminal shows it."""
    ordered = sorted(findings, key=lambda item: (INFO, WARNING, ERROR).index(item.level))
    blocks = []
    for item in ordered:
        mark = '' if item.level == INFO else f'{item.level.upper()}: '
        lines = textwrap.wrap(f'{mark}{item.words}', WIDTH - 4)
        if item.change:
            lines += textwrap.wrap(f'→ {item.change}', WIDTH - 4, subsequent_indent='  ')
        blocks.append('\n'.join([item.rule, *(f'    {line}' for line in lines)]))
    count = {level: sum(item.level == level for item in ordered) for level in (ERROR, WARNING)}
    verdict = ', '.join(f'{number} {level}{"" if number == 1 else "s"}'
                        for level, number in count.items())
    return '\n\n'.join([*blocks, verdict])
