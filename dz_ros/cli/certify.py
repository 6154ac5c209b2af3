# SPDX-License-Identifier: Apache-2.0
"""``dz certify``: bounds on the tracking error that hold for the sampled, delayed loop.

Exit code 0 where the loop is certified for every delay, 1 where it is not.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
import textwrap

from dz_ros.cli.interrupt import prompt_end
from dz_ros.cli.options import add_configuration, read_configuration
from dz_ros.cli.output import print_json
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.certificate import Certificate, certify
from dz_ros.core.units import Units
from dz_ros.errors import ConfigurationError
from dz_ros.runs.metrics import jsonable
from dz_ros.studies.certified_runs import certificate_picture, random_runs, reached

NOT_CERTIFIED = 1
WIDTH = 96
RUNS = 20
"""Simulated runs for each delay that the bounds are compared with."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_configuration(parser)
    parser.add_argument('--delay', type=int, metavar='D',
                        help='largest loop delay, in samples; every one from 0 on is covered '
                             "(default: 1, or the configuration's own where that is larger)")
    parser.add_argument('--picture', type=Path, metavar='FILE',
                        help=f'draw the bounds over {RUNS} simulated runs for each delay (PNG)')
    parser.add_argument('--json', action='store_true', help='bounds and words as JSON')


def run(arguments: argparse.Namespace) -> int:
    """Certify; print bounds and what they rest on; return 1 where a delay is not certified."""
    if arguments.delay is not None and not 0 <= arguments.delay <= 20:
        raise ConfigurationError('--delay', arguments.delay, 'must be 0 to 20 samples')
    if arguments.picture is not None and arguments.picture.exists():
        raise ConfigurationError('--picture', str(arguments.picture),
                                 'exists already; choose another file')
    configuration = read_configuration(arguments)
    largest = (max(1, configuration.loop.delay) if arguments.delay is None else arguments.delay)
    with prompt_end(), stage('enclosing the loop for each delay') as step:
        found = certify(configuration, range(largest + 1), progress=step)
    if arguments.json:
        print_json(jsonable({'certified': found.certified,
                             'error_bound': list(found.error_bound), **asdict(found)}))
    else:
        print(format_certificate(found, configuration))
    if arguments.picture is not None:
        with prompt_end(), stage(f'simulating {RUNS} runs for each delay, drawing'):
            runs = [list(random_runs(configuration, found, item.delay, RUNS))
                    for item in found.delays]
            arguments.picture.write_bytes(certificate_picture(found, runs).png())
        if not arguments.json:
            for item, own in zip(found.delays, runs, strict=True):
                most = max(reached(each)[0] for each in own)
                print(f'delay {item.delay}: {len(own)} runs reach |x̃| = {most:.3g}')
    return 0 if found.certified else NOT_CERTIFIED


def format_certificate(found: Certificate, configuration: Configuration) -> str:
    """Return the certificate as text: bounds, then what is assumed, proven and not."""
    behind = Units.of(configuration.plant).behind
    s = behind('x^(n-1)')
    lines = [f'{configuration.law.name} on {configuration.plant.name}, '
             f'{configuration.loop.rate:g} Hz: '
             + ('certified' if found.certified else 'NOT CERTIFIED')]
    for item in found.delays:
        bounds = ', '.join(f'|x̃{i + 1}| <= {bound:.3g}{behind(f"x^({i})")}'
                           for i, bound in enumerate(item.error_bound))
        lines.append(f'  delay {item.delay}: ' + ('' if item.certified else 'not certified. ')
                     + (f'{bounds}; |s| <= {item.s_bound:.3g}{s}, ε = {item.epsilon:.3g}{s}; '
                        f'fades in {item.fade:.2g} s' if item.error_bound else 'no bound'))
        lines += _wrapped(item.failed, '    fails: ')
        if item.change:
            lines += _wrapped((item.change,), '    → ')
    for title, sentences in (('assumed', found.assumed), ('proven by this machine', found.proven),
                             ('not proven', found.not_proven)):
        lines += ['', title, *_wrapped(sentences, '  - ')]
    return '\n'.join(lines)


def _wrapped(sentences: tuple[str, ...], mark: str) -> list[str]:
    """Return sentences as lines behind a mark."""
    return [line for item in sentences
            for line in textwrap.wrap(item, WIDTH, initial_indent=mark,
                                      subsequent_indent=' ' * len(mark))]
