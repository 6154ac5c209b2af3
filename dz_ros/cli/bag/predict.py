# SPDX-License-Identifier: Apache-2.0
"""``dz bag predict RUN --config CONFIG``: what a plant explains of a recording."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
import math
from pathlib import Path
import sys
from typing import Any

from dz_ros.cli.options import (
    add_recording,
    one_axis,
    read_recording,
    refuse_existing,
    require_folder,
)
from dz_ros.cli.output import aligned, note_run, print_json, print_lines
from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.loop.coupled import knows_others
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import flat_parameters, load_configuration
from dz_ros.identification.plant_prediction import predict, Prediction, with_own_constant
from dz_ros.replay.whatif import base_configuration
from dz_ros.runs.axes import choose_axis

LENGTHS = (math.inf, 5.0, 1.0)
"""Of the parts [s]; ∞ = once."""
WORST = -10.0
"""A share below has two digits."""
SHOWN = 1e-3
"""A constant term of the recording's own is printed where it explains this share more."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_recording(parser)
    parser.add_argument('--config', metavar='CONFIG',
                        help='whose plant: a file or the name of a configuration that comes with '
                             'dz_ros (default: that of the run itself)')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        dest='overrides', help='change one key of the configuration, e.g. '
                        'plant.constant_force=-3; may be repeated')
    parser.add_argument('--picture', type=Path, metavar='FILE',
                        help='draw measured and predicted states; a PNG that must not exist')
    parser.add_argument('--json', action='store_true', help='the numbers as JSON')
    parser.epilog = ('The plant is driven by the recorded commands alone, from the first '
                     'measurement on. 100 % is a perfect prediction, 0 % is that of the mean.')


def run(arguments: argparse.Namespace) -> int:
    """Simulate, print, draw.

    Raises:
        ConfigurationError: There is no plant, or one that couples several axes.
        RecordingError: The run cannot be read or has no states and commands.
        RunExistsError: The picture exists.
    """
    refuse_existing(arguments.picture, 'file')
    if arguments.picture is not None:
        require_folder(arguments.picture)
    whole_run = read_recording(arguments.run, arguments.namespace)
    c = _configuration(arguments, whole_run)
    data = choose_axis(whole_run, arguments.axis if whole_run.axes else None)
    if knows_others(c):
        raise ConfigurationError('plant.model', c.plant.name, 'moves several axes together: '
                                 'must be of one axis to be predicted alone')
    other = _other_units(c, data)
    with stage('simulating'):
        found = {length: predict(data, c, length) for length in LENGTHS}
        own = with_own_constant(data, c)
    whole = found[math.inf]
    better = None if own is None else predict(data, own[0])
    lines = [*prediction_lines(found, c)]
    if own is not None and better is not None:
        lines += _own_lines(own, whole, better, c)
    notes = [text for text in (other, f'{whole.lost} samples beside holes are not predicted'
                               if whole.lost else '') if text]
    if arguments.json:
        print_json({'begun': [_numbers(length, item) for length, item in found.items()],
                    'own_constant': None if own is None or better is None or not explains_more(
                        whole, better) else {'changed': _changed(own[0], c),
                                             **_numbers(math.inf, better)},
                    'units': list(c.plant.state_units[:whole.measured.shape[1]]),
                    'notes': notes})
    else:
        print_lines([f'plant {c.plant.name} of {arguments.config or "the run itself"}, driven by '
                     f'the commands of {arguments.run} alone', *lines,
                     *(f'note: {text}' for text in notes)])
    note_run(data)
    if arguments.picture is not None:
        from dz_ros.identification.prediction_plot import draw

        arguments.picture.write_bytes(draw(whole, c).png())
        print_lines([f'picture: {arguments.picture}'],
                    sys.stderr if arguments.json else sys.stdout)
    return 0


def explains_more(whole: Prediction, better: Prediction) -> bool:
    """Return whether a prediction explains more of the first state, by what is worth a line."""
    return better.explained[0] - whole.explained[0] > SHOWN


def _numbers(length: float, item: Prediction) -> dict[str, Any]:
    """Return a prediction as JSON has it; None where the plant diverged or nothing moved."""
    return {'every_s': length if math.isfinite(length) else None, 'parts': len(item.starts),
            'explained': [share if math.isfinite(share) else None for share in item.explained],
            'rms': [rms if math.isfinite(rms) else None for rms in item.rms]}


def _changed(after: Configuration, before: Configuration) -> dict[str, float]:
    """Return the keys of which one configuration has another number, with that number."""
    now, was = after.to_flat(), before.to_flat()
    return {key: value for key, value in now.items()
            if isinstance(value, float) and value != was[key]}


def _configuration(arguments: argparse.Namespace, data: RunData) -> Configuration:
    """Return whose plant predicts.

    Raises:
        ConfigurationError: Neither the run nor --config has one.
    """
    if arguments.config is not None:
        namespace = arguments.namespace or ''
        found = load_configuration(arguments.config, arguments.overrides, namespace)
        given = flat_parameters(arguments.config, arguments.overrides, namespace)
        if not any('plant' in key.split('.') for key in given):
            raise ConfigurationError('--config', arguments.config, 'must have a section plant')
        return one_axis(found, arguments.axis)
    flat = base_configuration(choose_axis(data, arguments.axis))
    if not any(key.startswith('plant.') for key in flat):
        raise ConfigurationError('--config', '', 'must name the configuration of the plant: the '
                                 'run states none')
    return Configuration.from_untrusted(flat, flat_parameters(None, arguments.overrides), False)


def _other_units(c: Configuration, data: RunData) -> str:
    """Return how the units of a plant's states differ from those of the run; '' = they do not."""
    flat = base_configuration(data)
    if not any(key.startswith('plant.') for key in flat):
        return ''
    try:
        own = Configuration.from_untrusted(flat, {}, False).plant.state_units
    except ConfigurationError:      # a plant of a package that this run is not to import
        return ''
    ours = c.plant.state_units
    return '' if ours == own else (f'states of plant {c.plant.name} are in {", ".join(ours)}, '
                                   f'those of the run in {", ".join(own)}')


def prediction_lines(found: Mapping[float, Prediction], c: Configuration) -> Iterator[str]:
    """Yield a table: how often it begins, what is explained of each measured state.

    Args:
        found: Length of a part [s] → the prediction.
        c: Units of the states.
    """
    units = c.plant.state_units
    count = next(iter(found.values())).measured.shape[1]
    rows = [('begun', 'parts', *(f'{text} of x{i}' + (f' [{units[i]}]' if text == 'RMS' else '')
                                 for i in range(count) for text in ('explained', 'RMS')))]
    for length, item in found.items():
        numbers = [text for share, rms in zip(item.explained, item.rms, strict=True)
                   for text in (percent(share), f'{rms:.3g}')]
        rows.append(('once' if math.isinf(length) else f'every {length:g} s',
                     str(len(item.starts)), *numbers))
    yield from aligned(rows, (0,))


def percent(share: float) -> str:
    """Return a share as text; with more digits the nearer to all it is."""
    if math.isnan(share):
        return 'it does not move'
    if math.isinf(share):
        return 'diverges'
    if share < WORST:
        return f'{100.0 * share:.2g} %'
    left = 100.0 * (1.0 - share)
    digits = 2 if left >= 0.1 or left < 1e-9 else min(6, math.ceil(-math.log10(left)) + 1)
    return f'{100.0 * share:.{digits}f} %'


def _own_lines(own: tuple[Configuration, int], whole: Prediction, better: Prediction,
               c: Configuration) -> Iterator[str]:
    """Yield what the constant term of the recording itself would change, if it is much."""
    changed, number = own
    if not explains_more(whole, better):
        return
    before = c.to_flat()
    keys = ', '.join(f'{key} = {value:.4g} in place of {before[key]:.4g}'
                     for key, value in _changed(changed, c).items())
    yield (f'with the a{number} that suits this recording best, {keys}: '
           f'{percent(better.explained[0])} of x0, begun once')
