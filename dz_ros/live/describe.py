# SPDX-License-Identifier: Apache-2.0
"""What a configuration offers to be changed while a loop runs, as the page needs it."""

from __future__ import annotations

import re
from typing import Any

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.units import Units
from dz_ros.errors import ConfigurationError

TITLES = {'controller': 'Gains and bounds', 'trajectory': 'Trajectory',
          'plant': 'Simulated plant and dead-zone'}
"""Section → heading."""
PULSE = 'plant.disturbance_pulse'
GREEK = {'alpha': 'α', 'beta': 'β', 'gamma': 'γ', 'epsilon': 'ε', 'eta': 'η', 'kappa': 'κ',
         'lambda': 'λ', 'mu': 'μ', 'phi': 'φ̂', 'rho': 'ρ', 'theta': 'θ̂'}


def symbol(name: str) -> str:
    """Return the symbol of a parameter, as the documents have it; '' where its name is a word."""
    head, *rest = name.split('_')
    if head not in GREEK and not re.fullmatch(r'[a-z]\d?', head):
        return ''
    if 'drift' in rest:     # its amplitude and frequency, which no document gives letters
        return ''
    rest = [part for part in rest if part not in ('bounds', 'guess')]
    if rest == ['star']:
        return f'{head}*'
    return '_'.join((GREEK.get(head, head), *rest))


def groups(c: Configuration, section: str) -> list[tuple[str, Any, str]]:
    """Return (prefix, parameter group, heading) of a section, those that matter most first."""
    return {'controller': [('controller', c.law.gains, f'Gains of {c.law.name}'),
                           ('controller', c.controller_settings, 'Known bounds')],
            'trajectory': [('trajectory', c.trajectory.parameters, c.trajectory.name)],
            'plant': [('plant.dead_zone', c.dead_zone, 'Dead-zone'),
                      ('plant', c.plant.parameters, c.plant.name)],
            }.get(section, [])


def parameters(c: Configuration) -> list[dict[str, Any]]:
    """Return each parameter that may change while the loop runs, with its schema and value."""
    found, units = [], Units.of(c.plant)
    for section in TITLES:
        if section == 'plant' and c.driver_settings.name != 'simulated':
            continue
        for prefix, group, heading in groups(c, section):
            values = schema.to_dict(group)
            found += [{'key': f'{prefix}.{item.name}', 'section': section,
                       'group': heading, 'symbol': symbol(item.name),
                       'kind': item.kind, 'value': values[item.name],
                       'unit': units.resolve_words(item.spec.unit),
                       'description': item.spec.description, 'range': item.spec.range_text(),
                       'choices': list(item.spec.choices)}
                      for item in schema.fields(type(group)) if not item.spec.structural]
    return found


def checked(c: Configuration, values: Any) -> tuple[str, dict[str, tuple[str, Any]]]:
    """Return (section, key → (kind, value)) of parameters to be changed.

    Raises:
        ConfigurationError: Unknown or fixed keys, several sections at once, wrong types.
    """
    if not isinstance(values, dict) or not values or len(values) > 100:
        raise ConfigurationError('values', values, 'must name parameters with their values')
    known = {f'{prefix}.{item.name}': (section, item) for section in TITLES
             for prefix, group, _ in groups(c, section) for item in schema.fields(type(group))}
    if PULSE in values:
        item = next(item for item in schema.fields(type(c.plant_settings))
                    if item.name == 'disturbance_pulse')
        known[PULSE] = ('plant', item)
    found, sections = {}, set()
    for key, value in values.items():
        if key not in known:
            raise schema.unknown_key(str(key)[:80], value, known)
        section, item = known[key]
        if item.spec.structural:
            raise ConfigurationError(key, value, 'fixed: stop the loop and start it with another '
                                     'value')
        sections.add(section)
        found[key] = (item.kind, schema.check_value(item, value, key))
    if len(sections) > 1:
        raise ConfigurationError('values', sorted(values), 'must be of one section: '
                                 f'{" or ".join(sorted(sections))}')
    return sections.pop(), found


def title(c: Configuration | None) -> str:
    """Return in a few words what runs."""
    if c is None:
        return 'a loop without configuration'
    return f'{c.law.name} on {c.plant.name}, {c.trajectory.name}'


def facts(c: Configuration | None) -> dict[str, Any]:
    """Return what the page draws besides rows: the bounds of estimates, the rate, the names."""
    if c is None:
        return {'title': title(None), 'parameters': [], 'bounds': {}, 'simulated': False}
    design = c.law.design
    bounds: dict[str, list[float]] = {}
    if design is not None:
        bounds = {f'theta{i + 1}': list(pair) for i, pair in enumerate(design.theta)}
        if design.phi:
            bounds['phi'] = list(design.phi)
    return {
        'title': title(c), 'law': c.law.name, 'plant': c.plant.name,
        'trajectory': c.trajectory.name, 'rate': c.loop.rate, 'timing': c.loop.timing,
        'duration': c.loop.duration, 'bounds': bounds,
        'known': {'b_r': list(c.controller_settings.b_r_bounds),
                  'b_l': list(c.controller_settings.b_l_bounds)},
        'simulated': c.driver_settings.name == 'simulated', 'parameters': parameters(c),
        'sections': TITLES, 'unit': c.plant.state_units[0],
        'pulse_unit': Units.of(c.plant).resolve('x^(n)'),
    }
