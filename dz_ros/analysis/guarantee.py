"""What the theorem promises of a run, and what of this run lies outside it.

For the law (14)–(16) of [wang2004] in continuous time, with (A1)–(A8) and (18), x̃ converges to

    Ω_ε: |x̃_i| ≤ 2^(i−1) λ^(i−n) ε,      i = 1 … n

A disturbance δ of x^(n) is covered as far as k* leaves room beside the dead-zone *(ours)*:

    k* ≥ (ρ + δ_max/b_min)/m_min
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dz_ros.analysis.view import View
from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import rho
from dz_ros.core.tracking import guaranteed_bounds

PROVEN = frozenset({'wang2004'})
"""Laws whose convergence to Ω_ε is the paper's theorem."""


@dataclass(frozen=True)
class Guarantee:
    """What is promised and what is not.

    Attributes:
        statement: One sentence: whether the theorem speaks of this run.
        bounds: Ω_ε in the units of the states, shape (n,); None where there is none.
        broken: Assumptions of the theorem that this run does not meet.
        beyond: What this run has that the theorem leaves out.
    """

    statement: str
    bounds: tuple[float, ...] | None
    broken: tuple[str, ...]
    beyond: tuple[str, ...]


def guarantee(view: View) -> Guarantee:
    """Return what the theorem promises of a run."""
    setting, c = view.setting, view.setting.configuration
    if not setting.law and setting.epsilon is None:
        return Guarantee('Nothing is known of the law of this run, so nothing is promised.',
                         None, (), ())
    if not view.has_layer or setting.lambda_ is None:
        return Guarantee(f'The law {setting.law} has no boundary layer; no bound of its error is '
                         'promised.', None, (), ())
    bounds = guaranteed_bounds(setting.lambda_, float(np.nanmax(view.epsilon)), setting.order)
    if setting.law not in PROVEN:
        return Guarantee(f"Ω_ε is the set of the paper's theorem, which is not about the law "
                         f'{setting.law or "of this run"}: for comparison only.', bounds, (), ())
    if c is None:
        return Guarantee('Ω_ε follows from λ and ε; without the configuration the assumptions '
                         'of the theorem cannot be checked.', bounds, (), ())
    broken = (*_broken(c), *(_outside_knowledge(c) if setting.simulated else ()))
    statement = ('The theorem promises, in continuous time, that the errors end up within Ω_ε and '
                 'all signals stay bounded.') if not broken else (
        'An assumption of the theorem does not hold, so it promises nothing here; Ω_ε is for '
        'comparison only.')
    return Guarantee(statement, bounds, broken, _beyond(view, c))


def _needed(c: Configuration) -> tuple[float, float]:
    """Return (k*, ρ/m_min) of (18)."""
    s = c.controller_settings
    return (float(getattr(c.law.gains, 'k_star', 0.0)),
            rho(s.b_r_bounds[1], s.b_l_bounds[0], s.m_bounds[1]) / s.m_bounds[0])


def _broken(c: Configuration) -> tuple[str, ...]:
    """Return what of (18) does not hold."""
    k_star, needed = _needed(c)
    if k_star >= needed:
        return ()
    return (f'(18): k* = {k_star:g} is smaller than ρ/m_min = {needed:.4g}.',)


def _outside_knowledge(c: Configuration) -> tuple[str, ...]:
    """Return which true parameters of the dead-zone break (A2)–(A4)."""
    zone, s = c.dead_zone, c.controller_settings
    found = []
    for name, (low, high) in (('b_r', s.b_r_bounds), ('b_l', s.b_l_bounds),
                              ('m_r', s.m_bounds), ('m_l', s.m_bounds)):
        value, drift = getattr(zone, name), abs(getattr(zone, f'{name}_drift')[0])
        # Both break points at 0 is no dead-zone at all, which is inside any ρ.
        if value == 0.0 and drift == 0.0 and name.startswith('b'):
            continue
        if value - drift < low or value + drift > high:
            reach = f'{value:g}' + (f' ± {drift:g}' if drift else '')
            found.append(f'(A4): {name} = {reach} is not within its known bounds '
                         f'[{low:g}, {high:g}].')
    if zone.m_r != zone.m_l:
        found.append(f'(A2): the slopes differ, m_r = {zone.m_r:g}, m_l = {zone.m_l:g}.')
    if zone.constants[0]:
        found.append('The parameters of the dead-zone drift; the theorem takes constant ones.')
    return tuple(found)


def _beyond(view: View, c: Configuration) -> tuple[str, ...]:
    """Return what the theorem does not cover and this run has."""
    found = [f'Sampling: the law runs every {1e3 * c.loop.period:g} ms, not continuously.']
    if c.loop.delay:
        found.append(f'Loop delay: {c.loop.delay} whole sample(s).')
    if view.setting.mode == 'realtime':
        found.append('Transport: commands arrive when they do; see the timing.')
    if any(c.noise):
        found.append('Measurement noise of standard deviation '
                     f'{", ".join(f"{value:g}" for value in c.noise)}; it is part of the measured '
                     'error.')
    if c.plant_settings.command_limit:
        found.append(f'The actuator clips |v| to {c.plant_settings.command_limit:g}.')
    disturbance = view.rows.truth.get('disturbance')
    if disturbance is not None and np.nan_to_num(disturbance).any():
        k_star, needed = _needed(c)
        s = c.controller_settings
        room = (k_star - needed) * s.m_bounds[0] * s.b_bounds[0]
        largest = float(np.nanmax(np.abs(disturbance)))
        word = 'covers' if largest <= room * (1.0 + 1e-9) else 'does not cover'
        found.append(f'A disturbance of up to {largest:.4g}, which the controller does not '
                     f'model; k* leaves room for {room:.4g}, which {word} it.')
    return tuple(found)
