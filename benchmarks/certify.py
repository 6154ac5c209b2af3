# SPDX-License-Identifier: Apache-2.0
"""Certificates of every configuration that comes with dz_ros, beside simulated runs.

    python benchmarks/certify.py                    1000 runs for each delay
    python benchmarks/certify.py --runs 100         fewer
    python benchmarks/certify.py --write            write the table into docs/certificate.md
    python benchmarks/certify.py --write NAME …     only the rows of these configurations

Exits with 1 where a run inside the assumptions of a certificate exceeds its bound.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.certificate import certify
from dz_ros.core.design.intervals import NotEnclosedError
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration, shipped_configurations
from dz_ros.studies.certified_runs import random_runs, reached

PAGE = Path(__file__).resolve().parent.parent / 'docs' / 'certificate.md'
BEGIN, END = '<!-- table -->', '<!-- end of table -->'


def main() -> int:
    """Certify every configuration and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--runs', type=int, default=1000, help='for each delay')
    parser.add_argument('--write', action='store_true', help=f'write the table into {PAGE.name}')
    parser.add_argument('names', nargs='*', metavar='NAME', help='only these configurations')
    arguments = parser.parse_args()
    head = ['| configuration | law | delay | certified | bound on the error | largest in '
            f'{arguments.runs} runs | bound on \\|s\\| / ε | what fails, what would do |',
            f'|{"---|" * 8}']
    exceeded = False
    for name in arguments.names or shipped_configurations():
        found, broken = rows(name, arguments.runs)
        exceeded |= broken
        print(*found, sep='\n', flush=True)
        if arguments.write:
            replace_rows(head, name, found)
    return int(exceeded)


def replace_rows(head: list[str], name: str, found: list[str]) -> None:
    """Put the rows of a configuration into the page's table, which is sorted by name."""
    before, _, rest = PAGE.read_text(encoding='utf-8').partition(BEGIN)
    table, _, after = rest.partition(END)
    kept = [line for line in table.strip().splitlines()[2:]
            if line.split('|')[1].strip().partition(',')[0] != f'`{name}`']
    lines = sorted((*kept, *found), key=lambda line: line.split('|')[1])
    PAGE.write_text('\n'.join([before + BEGIN, *head, *lines, END + after]), encoding='utf-8')


def rows(name: str, count: int) -> tuple[list[str], bool]:
    """Return the lines of one configuration, of several axes of each, and as `rows_of`."""
    machine = load_configuration(name)
    found = [rows_of(f'`{name}`' + (f', {axis}' if axis else ''), own, count)
             for axis, own in machine.axes or (('', machine),)]
    return [line for lines, _ in found for line in lines], any(broken for _, broken in found)


def rows_of(title: str, configuration: Configuration, count: int) -> tuple[list[str], bool]:
    """Return the lines of one axis, and whether a run exceeds its bound."""
    head = f'| {title} | `{configuration.law.name}`'
    try:
        certificate = certify(configuration)
    except (ConfigurationError, NotEnclosedError) as error:
        return [f'{head} | | no | | | | {error} |'], False
    unit = configuration.plant.state_units[0]
    shown, exceeded = [], False
    for item in certificate.delays:
        most = np.zeros(configuration.plant.order)
        bound = ''
        if item.error_bound:
            bound = f'{item.error_bound[0]:.3g}' + ('' if unit == '1' else f' {unit}')
        if item.certified:
            for run in random_runs(configuration, certificate, item.delay, count):
                most = np.maximum(most, reached(run))
            exceeded |= bool((most > np.asarray(item.error_bound)).any())
        share = f'{item.s_bound:.3g} / {item.epsilon:.3g}' if item.error_bound else ''
        why = '; '.join(item.failed) + (f' → {item.change}' if item.change else '')
        why = why.replace('|', '\\|')
        reach = f'{most[0]:.3g}' if item.certified else ''
        shown.append(f'{head} | {item.delay} | {"**yes**" if item.certified else "no"} | {bound} '
                     f'| {reach} | {share} | {why} |')
    return shown, exceeded


if __name__ == '__main__':
    sys.exit(main())
