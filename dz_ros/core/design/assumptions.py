# SPDX-License-Identifier: Apache-2.0
"""Assumptions of the theorem of [wang2004] that a configuration meets.

(A1)–(A4) concern the dead-zone; those on plant and reference are given by name. Of a real plant
they are "stated" by the user, elsewhere they "hold" or are "violated"; with the driver of a real
device the plant's section is a model, and where it contradicts the bounds one of the two is wrong,
which is a warning.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.along_reference import largest_derivatives
from dz_ros.core.design.finding import Finding, INFO, WARNING
from dz_ros.core.design.observation import observed_state
from dz_ros.core.laws.base import Design

SAME_SLOPE = 1e-4
"""Slopes that differ by less than this share count as the same; a slope as within its bounds."""


def check_assumptions(c: Configuration) -> Iterator[Finding]:
    """Return a finding for each assumption."""
    yield from check_dead_zone(c)
    yield from _plant(c)
    yield from _reference(c)


def same_slope(*slopes: float) -> bool:
    """Return whether slopes count as the same: no identification separates them."""
    return math.isclose(min(slopes), max(slopes), rel_tol=SAME_SLOPE)


def check_dead_zone(c: Configuration) -> Iterator[Finding]:
    """Check (A1)–(A4); no dead-zone at all lies inside any bounds."""
    zone, known = c.dead_zone, c.controller_settings
    model = '' if c.simulated else "the plant's section has "
    yield Finding(INFO, '(A1)', 'holds: the law never sees what the dead-zone lets through')
    schedule = c.loop.schedule
    slopes = zone.slopes(schedule, c.law.known_slopes,
                         getattr(c.law.gains, 'table_points', ()))
    moving_with = ', or following loop.schedule_values' if zone.follows else ''
    if not same_slope(*slopes):
        yield Finding(INFO, '(A2)', f'not assumed: {model}slopes {zone.m_r:g} on the right, '
                      f'{zone.m_l:g} on the left, or drifting{moving_with}; the bounds of m hold '
                      'both sides in its place: k* divides by the smaller slope, beta takes the '
                      'larger; what adaptation cannot follow from side to side is disturbance',
                      {'m_r': zone.m_r, 'm_l': zone.m_l})
    elif c.simulated:
        yield Finding(INFO, '(A2)', f'holds: the same slope {zone.m_r:g} on both sides',
                      {'m': zone.m_r})
    else:
        yield Finding(INFO, '(A2)', 'stated: the device has the same slope on both sides')
    yield Finding(INFO, '(A3)', f'{_kept(c)}: b_r >= 0, b_l <= 0, m > 0')
    outside = []
    for name, (low, high), bounds in (
            ('b_r', zone.extent('b_r', schedule), known.b_r_bounds),
            ('b_l', zone.extent('b_l', schedule), known.b_l_bounds),
            ('m', slopes, known.m_bounds)):
        absent = name != 'm' and zone.absent
        margin = SAME_SLOPE if name == 'm' else 0.0
        if not absent and (low < bounds[0] * (1.0 - margin) or high > bounds[1] * (1.0 + margin)):
            outside.append(f'{name} in [{low:g}, {high:g}] but stated in '
                           f'[{bounds[0]:g}, {bounds[1]:g}]')
    if outside:
        yield Finding(WARNING, '(A4)', f'{_broken(c)}: {model}' + '; '.join(outside),
                      change='widen controller.b_r_bounds, b_l_bounds or m_bounds' + _or_model(c))
    elif c.simulated:
        moving = any(low != high for low, high in (zone.extent('b_r', schedule),
                                                   zone.extent('b_l', schedule)))
        yield Finding(INFO, '(A4)', 'holds: the dead-zone lies within the stated bounds' + (
            '' if not moving else '; that b_r or b_l drifts there the theorem covers' if
            same_slope(*slopes) else
            '; the theorem covers that b_r or b_l drifts there where m is one constant, not here'))
    else:
        yield Finding(INFO, '(A4)', 'stated: the dead-zone of the device has b_r in '
                      f'{_span(known.b_r_bounds)}, b_l in {_span(known.b_l_bounds)}, m in '
                      f'{_span(known.m_bounds)}')


def _kept(c: Configuration) -> str:
    """Return the word for what the plant's section meets."""
    return 'holds' if c.simulated else 'stated'


def _broken(c: Configuration) -> str:
    """Return the word for what the plant's section does not meet."""
    return 'violated' if c.simulated else 'contradicted'


def _or_model(c: Configuration) -> str:
    """Return what else may be changed where the plant's section is only a model."""
    return '' if c.simulated else ", or correct the plant's section, a model of the device"


def _span(bounds: Sequence[float]) -> str:
    """Return an interval as text."""
    return f'[{bounds[0]:g}, {bounds[1]:g}]'


def _plant(c: Configuration) -> Iterator[Finding]:
    """State, structure and input gain."""
    observed = observed_state(c)
    yield Finding(INFO, 'state', f'not assumed: {observed}; the theorem takes all states as '
                  'measured' if observed else f'stated: all {c.plant.order} states are measured')
    yield Finding(INFO, 'structure', f'stated: {c.plant.regressor_count} known regressors Y_i '
                  'with constant weights a_i; what else acts on the plant is disturbance')
    low, high = c.controller_settings.b_bounds
    numbers = {'b': c.plant.b, 'b_min': low, 'b_max': high}
    if not low <= c.plant.b <= high:
        yield Finding(WARNING, 'input gain', f'{_broken(c)}: b = {c.plant.b:g}, stated within '
                      f'[{low:g}, {high:g}]', numbers, 'widen controller.b_bounds' + _or_model(c))
    elif c.simulated:
        yield Finding(INFO, 'input gain',
                      f'holds: b > 0, {c.plant.b:g} within [{low:g}, {high:g}]', numbers)
    else:
        yield Finding(INFO, 'input gain', f'stated: b > 0, within [{low:g}, {high:g}]',
                      {'b_min': low, 'b_max': high})


def _reference(c: Configuration) -> Iterator[Finding]:
    """x_d … x_d^(n) exist and are bounded."""
    largest = largest_derivatives(c)
    yield Finding(INFO, 'reference', f'holds: {c.trajectory.name} gives x_d and its '
                  f'{c.plant.order} derivatives in closed form; the largest: '
                  + ', '.join(f'{item:.4g}' for item in largest),
                  {f'xd{i}': item for i, item in enumerate(largest)})


def check_projection(c: Configuration, design: Design) -> Iterator[Finding]:
    """Check that the projection box contains the true parameters of all plants in bounds."""
    if not design.phi:
        return
    known = c.controller_settings
    low = known.b_bounds[0] * known.m_bounds[0]
    high = known.b_bounds[1] * known.m_bounds[1]
    boxes = [('φ̂', 1.0, design.phi), *(
        (f'θ̂{i}', a, box) for i, (a, box) in enumerate(
            zip(c.plant.a, design.theta, strict=True), 1))]
    outside = []
    for name, numerator, box in boxes:
        ends = sorted((numerator / high, numerator / low))
        if ends[0] < box[0] or ends[1] > box[1]:
            outside.append(f'{name} may have to be in [{ends[0]:.3g}, {ends[1]:.3g}], its bounds '
                           f'are [{box[0]:g}, {box[1]:g}]')
    if outside:
        yield Finding(WARNING, 'projection', f'{_broken(c)}: ' + '; '.join(outside),
                      change='widen controller.theta_min, theta_max, phi_min or phi_max'
                      + _or_model(c))
    else:
        yield Finding(INFO, 'projection', f'{_kept(c)}: the true parameters lie within the '
                      'projection bounds')
