# SPDX-License-Identifier: Apache-2.0
"""What ``dz driver identify`` prints and writes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import json
from pathlib import Path

from dz_ros.cli.tune import NUMBERS
from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import Finding, INFO
from dz_ros.errors import ConfigurationError, MissingDependencyError
from dz_ros.identification.characteristic_plot import draw
from dz_ros.identification.estimation.physical_parameters import (
    parameters_with,
    parameters_with_gain,
)
from dz_ros.identification.estimation.pipeline import Identified
from dz_ros.identification.estimation.prediction_error import Fit
from dz_ros.identification.estimation.static_friction import static_friction_note
from dz_ros.identification.proposal import known_bounds
from dz_ros.runs.metrics import jsonable
from dz_ros.studies.tune import Proposal


def doubts(found: Identified, breakaway: Sequence[float], c: Configuration) -> tuple[str, ...]:
    """Return what the bounds do not hold, each in one line."""
    sticks = static_friction_note(found, breakaway, c)
    return (*found.notes, sticks) if sticks else found.notes


def result_lines(found: Identified, c: Configuration,
                 breakaway: Sequence[float]) -> Iterator[str]:
    """Yield the dead-zone and its bounds, a line each, and what they do not hold."""
    count = len(found.times)
    yield (f'{count} repeats, {len(found.stretches)} stretches of motion, commands act '
           f'{found.delay} samples late')
    yield f'  {"":6} {"mean":>10} {"bounds":>23} {"spread":>10} {"noise":>10} {"drift":>10}'
    for item in found.bounds.values():
        yield (f'  {item.name:6} {item.value:>10.4g} [{item.low:>10.4g},{item.high:>10.4g}] '
               f'{item.spread:>10.2g} {item.noise:>10.2g} {item.drift:>10.2g}')
    yield (f'  b_r, b_l in {c.plant.actuator_unit}; b and m show only as their product: '
           f'b = {c.plant.b:.6g} is kept')
    if found.friction_counted:
        yield ('  friction and constant force are counted in: the motion shows no dead-zone '
               'beside them, b_r and b_l are what a slow motion has to overcome')
    words = [f'a{i + 1} = {value:.4g}' for i, value in enumerate(found.a.tolist())]
    if found.stretches[0].y.shape[1] > len(words):
        words.append(f'share of the modelled disturbance = {found.disturbance:.4g}')
    yield ('  ' + ', '.join(words) + f'; residual {found.residual:.3g}, noise of the measurement '
           f'{found.noise:.2g}')
    for note in doubts(found, breakaway, c):
        yield f'  note: {note}'


def plant_lines(fitted: Fit | None, c: Configuration, counted: bool) -> Iterator[str]:
    """Yield the plant refined by prediction error; without a dead-zone what its slope is part of.

    Args:
        fitted: The plant; None = there is none.
        c: The model that it is of.
        counted: Whether friction is counted in.
    """
    if fitted is None:
        return
    yield f'plant {fitted.model} refined by prediction error over the motion, 95 % confidence:'
    for item in fitted.estimates:
        yield f'  {item.name:6} {item.value:>10.4g}' + (
            f' ± {item.half_width:.2g}' if item.seen else ' kept')
    try:
        keys = parameters_with(c.plant, fitted.a)
    except ConfigurationError:
        return
    before = schema.to_dict(c.plant.parameters)
    changed = [f'{name.partition(".")[2]} = {value:.4g}' for name, value in keys.items()
               if value != before[name.partition('.')[2]]]
    if changed:
        yield f'  that is {", ".join(changed)}'
    right, left = fitted['b·m_r'], fitted['b·m_l']
    both = 0.5 * (right.value + left.value)
    if not (counted and right.seen and left.seen) or (
            abs(right.value - left.value) > right.half_width + left.half_width):
        return
    ways = [', '.join(f'{name.partition(".")[2]} = {value:.4g}' for name, value in keys.items())
            for keys in parameters_with_gain(c.plant, fitted.a, both) if keys]
    if ways:
        yield f'  were it without a dead-zone, of slope 1: {"; or ".join(ways)}'


def write_bounds(found: Identified, fitted: Fit | None, c: Configuration,
                 breakaway: Sequence[float], out: Path) -> None:
    """Write bounds, numbers and, where matplotlib is installed, the picture."""
    keys = known_bounds(c, found)
    section = [f'    {key.partition(".")[2]}: [{value[0]!r}, {value[1]!r}]'
               for key, value in keys.items()]
    _new(out / 'bounds.yaml', '\n'.join(
        ['/**:', '  ros__parameters:', '    controller:',
         *(f'  {line}' for line in section)]) + '\n')
    numbers = {
        'bounds': keys, 'breakaway': list(breakaway), 'delay': found.delay,
        'stretches': len(found.stretches), 'residual': found.residual,
        'a': found.a.tolist(), 'b': c.plant.b, 'times': found.times.tolist(),
        'friction_counted': found.friction_counted,
        'plant': {} if fitted is None else {
            item.name: {'value': item.value, 'half_width': item.half_width}
            for item in fitted.estimates},
        'parameters': {name: {'value': item.value, 'low': item.low, 'high': item.high,
                              'spread': item.spread, 'noise': item.noise, 'drift': item.drift,
                              'common': item.common, 'repeats': item.values.tolist()}
                       for name, item in found.bounds.items()}}
    _new(out / 'identified.json', json.dumps(jsonable(numbers), ensure_ascii=False, indent=2))
    try:
        picture = draw(found, c, breakaway)
        with (out / f'{picture.name}.png').open('xb') as file:
            file.write(picture.png())
    except MissingDependencyError as error:
        print(f'no picture: {error}')


def proposal_lines(proposal: Proposal, findings: Sequence[Finding], notes: Sequence[str],
                   file: Path) -> Iterator[str]:
    """Yield what the proposed configuration gives, and the findings of the design rules."""
    yield f'ready to run: {file}'
    flat = proposal.after.to_flat()
    yield '  ' + ', '.join(f'{key.partition(".")[2]} = {flat[key]:.4g}' for key in (
        'controller.k_star', 'controller.epsilon', 'controller.lambda', 'controller.k_d')
        if key in flat)
    for name, row in proposal.rows.items():
        if name.startswith('after'):
            numbers = '   '.join(f'{title} {row[key]:.4g}' for key, title in NUMBERS
                                 if row[key] is not None)
            yield f'  simulated, {name.partition(", ")[2]}: {row["reason"] or numbers}'
    for note in notes:
        yield f'  note: {note}'
    for item in findings:
        if item.level != INFO:
            yield f'  {item.level} {item.rule}: {item.words}' + (
                f'; {item.change}' if item.change else '')


def _new(path: Path, text: str) -> None:
    with path.open('x', encoding='utf-8') as file:
        file.write(text)
