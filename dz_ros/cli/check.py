# SPDX-License-Identifier: Apache-2.0
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
import textwrap

from dz_ros.cli.options import add_configuration, read_machine
from dz_ros.cli.output import print_json
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import ERROR, Finding, INFO, WARNING, worst
from dz_ros.core.design.rules import check
from dz_ros.core.design.stability import has_slope, lambda_limit
from dz_ros.errors import ConfigurationError
from dz_ros.runs.metrics import jsonable

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
    configuration = read_machine(arguments)
    found = {name: check(item, disturbance, None if arguments.quick else stability_limit(item))
             for name, item in configuration.axes or (('', configuration),)}
    if arguments.json:
        each = {name: {'worst': worst(findings),
                       'findings': [jsonable(asdict(item)) for item in findings]}
                for name, findings in found.items()}
        print_json(each[''] if '' in each else {
            'worst': worst([item for findings in found.values() for item in findings]),
            'axes': each})
    else:
        print('\n\n'.join(format_findings(findings) if not name else
                          f'== axis {name}\n\n{format_findings(findings)}'
                          for name, findings in found.items()))
    return FOUND_ERRORS if any(worst(findings) == ERROR for findings in found.values()) else 0


def stability_limit(configuration: Configuration) -> float | None:
    """Return the largest λ of a calm loop [1/s]; None where the law has no λ."""
    if not has_slope(configuration):
        return None
    with stage('searching the largest λ of a calm loop'):
        return lambda_limit(configuration)


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
