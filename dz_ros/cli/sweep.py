# SPDX-License-Identifier: Apache-2.0
"""``dz sweep``: thousands of runs over any keys of a configuration; ``dz sweep plot``: their maps.

A sweep goes on where it was ended: the same command again does what is missing.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from dz_ros.cli.interrupt import prompt_end
from dz_ros.cli.options import add_configuration, read_configuration
from dz_ros.cli.progress import Progress, stage
from dz_ros.errors import ConfigurationError
from dz_ros.report.report import write_files
from dz_ros.studies.outcome import require_end
from dz_ros.studies.sweep import read_sweep, run_sweep
from dz_ros.studies.sweep_pictures import pictures
from dz_ros.studies.sweep_plan import parse_axes, SAMPLERS, SweepPlan

PLOT = 'plot'
"""In the place of CONFIG: draw a sweep instead of running one."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.usage = ('dz sweep CONFIG --over KEY=a:b:n … --out FILE [options]\n'
                    '       dz sweep plot FILE [--out DIR] [--x KEY] [--y KEY]')
    add_configuration(parser)
    parser.add_argument('file', nargs='?', type=Path, metavar='FILE',
                        help='after plot: the file of a sweep')
    parser.add_argument('--over', action='append', default=[], metavar='KEY=a:b:n',
                        help='a key and its values: a:b:n, a:b:n:log or v1,v2,…; KEY[i] is one '
                             'number of an array; may be repeated')
    parser.add_argument('--sampler', choices=SAMPLERS, default='grid',
                        help='how the axes are filled (default: %(default)s)')
    parser.add_argument('--samples', type=int, default=0, metavar='N',
                        help='runs of --sampler random or sobol')
    parser.add_argument('--seed', type=int, default=0, metavar='N',
                        help='seed of the sampler (default: %(default)s)')
    parser.add_argument('-j', '--jobs', type=int, default=0, metavar='N',
                        help='processes (default: one for each core)')
    parser.add_argument('--cluster', metavar='ADDRESS',
                        help='run on the workers of this dask.distributed scheduler, e.g. '
                             'tcp://host:8786')
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='.csv or .parquet; of plot: the directory of the pictures')
    parser.add_argument('--x', metavar='KEY', help='of plot: key along the horizontal axis')
    parser.add_argument('--y', metavar='KEY', help='of plot: key along the vertical axis')
    parser.add_argument('--quiet', action='store_true', help='no progress')


def run(arguments: argparse.Namespace) -> int:
    """Run a sweep, or draw one."""
    if arguments.config == PLOT:
        return plot(arguments)
    if arguments.file is not None:
        raise ConfigurationError('FILE', str(arguments.file), 'belongs after plot; the file of a '
                                 'sweep is --out FILE')
    out = arguments.out
    if out is None or out.suffix not in ('.csv', '.parquet'):
        raise ConfigurationError('--out', None if out is None else str(out),
                                 'must be a file that ends in .csv or .parquet')
    if not out.absolute().parent.is_dir():
        raise ConfigurationError('--out', str(out), 'its folder does not exist')
    if arguments.jobs < 0:
        raise ConfigurationError('--jobs', arguments.jobs, 'must be 0 (all cores) or more')
    if arguments.seed < 0:
        raise ConfigurationError('--seed', arguments.seed, 'must be >= 0')
    configuration = read_configuration(arguments)
    plan = SweepPlan(configuration.to_flat(), parse_axes(arguments.over), arguments.sampler,
                     arguments.samples, arguments.seed)
    if 'loop.duration' not in {axis.key for axis in plan.axes}:
        require_end(configuration)
    plan.check()
    progress = Progress(len(plan))

    def kept() -> str:
        return f'{progress.done} of {len(plan)} runs are kept; the same command goes on'

    with prompt_end(kept):
        lost = run_sweep(plan, out, arguments.jobs, arguments.cluster, progress, progress.resume)
    print(f'{out}: {len(plan)} runs, {lost} of them lost')
    return 0


def plot(arguments: argparse.Namespace) -> int:
    """Draw the maps of a sweep."""
    if arguments.file is None:
        raise ConfigurationError('FILE', None, 'name the file of a sweep: dz sweep plot FILE')
    with stage(f'reading {arguments.file}'):
        rows = read_sweep(arguments.file)
    with stage('drawing maps'):
        drawn = pictures(rows, arguments.x, arguments.y)
    out = arguments.out or arguments.file.with_name(f'{arguments.file.stem}-maps')
    write_files(out, {f'{picture.name}.png': picture.png() for picture in drawn})
    for picture in drawn:
        print(out / f'{picture.name}.png')
        print(picture.caption, file=sys.stderr)
    return 0
