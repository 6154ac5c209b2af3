"""What ``dz driver identify`` prints and writes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import json
from pathlib import Path

from dz_ros.analysis.metrics import jsonable
from dz_ros.cli.tune import NUMBERS
from dz_ros.core.configuration import Configuration
from dz_ros.core.finding import Finding, INFO
from dz_ros.errors import MissingDependencyError
from dz_ros.identification.bounds import Identified
from dz_ros.identification.evaluate import Evaluation
from dz_ros.identification.picture import draw
from dz_ros.identification.proposal import known_bounds
from dz_ros.studies.tune import Proposal


def result_lines(found: Identified, c: Configuration) -> Iterator[str]:
    """Yield what was found, a line each."""
    count = len(found.times)
    yield (f'{count} repeats, {found.stretches} stretches of motion, commands act '
           f'{found.delay} samples late')
    yield f'  {"":6} {"mean":>10} {"bounds":>23} {"spread":>10} {"noise":>10} {"drift":>10}'
    for item in found.bounds.values():
        yield (f'  {item.name:6} {item.value:>10.4g} [{item.low:>10.4g},{item.high:>10.4g}] '
               f'{item.spread:>10.2g} {item.noise:>10.2g} {item.drift:>10.2g}')
    yield (f'  b_r, b_l in {c.plant.actuator_unit}; b and m show only as their product: '
           f'b = {c.plant.b:.6g} is kept')
    names = [f'a{i + 1}' for i in range(c.plant.regressor_count)]
    names += ['share of the modelled disturbance'][:len(found.a) - len(names)]
    yield '  ' + ', '.join(f'{name} = {value:.4g}' for name, value in zip(
        names, found.a.tolist(), strict=True)) + f'; residual {found.residual:.3g}'


def write_bounds(found: Evaluation, c: Configuration, breakaway: Sequence[float],
                 out: Path) -> None:
    """Write bounds, numbers and, where matplotlib is installed, the picture."""
    keys = known_bounds(c, found.result)
    section = [f'    {key.partition(".")[2]}: [{value[0]!r}, {value[1]!r}]'
               for key, value in keys.items()]
    _new(out / 'bounds.yaml', '\n'.join(
        ['/**:', '  ros__parameters:', '    controller:',
         *(f'  {line}' for line in section)]) + '\n')
    result = found.result
    numbers = {
        'bounds': keys, 'breakaway': list(breakaway), 'delay': result.delay,
        'stretches': result.stretches, 'residual': result.residual,
        'a': result.a[:c.plant.regressor_count].tolist(), 'b': c.plant.b,
        'times': result.times.tolist(),
        'parameters': {name: {'value': item.value, 'low': item.low, 'high': item.high,
                              'spread': item.spread, 'noise': item.noise, 'drift': item.drift,
                              'common': item.common, 'repeats': item.values.tolist()}
                       for name, item in result.bounds.items()}}
    _new(out / 'identified.json', json.dumps(jsonable(numbers), ensure_ascii=False, indent=2))
    try:
        picture = draw(found.found, result, c, found.times, breakaway)
        with (out / f'{picture.name}.png').open('xb') as file:
            file.write(picture.png())
    except MissingDependencyError as error:
        print(f'no picture: {error}')


def proposal_lines(proposal: Proposal, findings: Sequence[Finding], notes: Sequence[str],
                   file: Path) -> Iterator[str]:
    """Yield what the ready configuration gives, and what the design rules say of it."""
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
