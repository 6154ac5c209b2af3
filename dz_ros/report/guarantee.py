# SPDX-License-Identifier: Apache-2.0
"""What the theorem promises of a run, and what of this run lies outside it.

For the law (14)–(16) of [wang2004] in continuous time, with (A1)–(A8) and (18), x̃ converges to

    Ω_ε: |x̃_i| ≤ 2^(i−1) λ^(i−n) ε,      i = 1 … n

What k* covers, of the dead-zone and of a disturbance of x^(n), is `RobustGain`'s to state, for any
law with a robust term.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.assumptions import check_dead_zone, same_slope
from dz_ros.core.design.finding import INFO
from dz_ros.core.design.observation import observed_state
from dz_ros.core.design.robust_gain import RobustGain
from dz_ros.core.safety.health import CHATTER, variation_share
from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.core.units import Units
from dz_ros.errors import DzRosError
from dz_ros.report.view import View
from dz_ros.runs.metrics import choose_window

PROVEN = frozenset({'wang2004'})
"""Laws whose convergence to Ω_ε is the paper's theorem."""


@dataclass(frozen=True)
class Guarantee:
    """What the theorem promises of a run.

    Attributes:
        statement: One sentence: whether the theorem applies to this run.
        bounds: Ω_ε in the units of the states, shape (n,); None where there is none.
        broken: Assumptions of the theorem that this run does not meet.
        beyond: What this run has that the theorem leaves out.
        covered: What k* covers, and whether it covers the disturbance of this run; empty where
            that is unknown.
        exceeded: Whether the run had a larger disturbance than that, which the theorem excludes.
    """

    statement: str
    bounds: tuple[float, ...] | None
    broken: tuple[str, ...]
    beyond: tuple[str, ...]
    covered: str = ''
    exceeded: bool = False


def guarantee(view: View) -> Guarantee:
    """Return what the theorem promises of a run; chatter is judged for any law with a layer."""
    covered, exceeded = _covered(view)
    found = replace(_promised(view), covered=covered, exceeded=exceeded)
    return replace(found, beyond=(*found.beyond, *_chatter(view))) if view.has_layer else found


def _chatter(view: View) -> tuple[str, ...]:
    """Return a sentence where v varies far more than the reference needs, in windows of 1 s."""
    rows, worst, at = view.rows, 0.0, 0.0
    names = ('v_feed_forward', 'v_regressor')
    if not all(name in rows.terms for name in names) or len(rows.t) < 2:
        return ()
    smooth = rows.terms[names[0]] + rows.terms[names[1]]
    begin, _ = choose_window(rows.t)
    for start in np.arange(begin, rows.t[-1] - 0.5, 1.0):
        inside = (rows.t >= start) & (rows.t < start + 1.0)
        v, needed = rows.v[inside], smooth[inside]
        known = np.isfinite(v) & np.isfinite(needed)
        if known.sum() < 2:
            continue
        with np.errstate(over='ignore', invalid='ignore'):
            share = variation_share(float(np.abs(np.diff(v[known])).sum()),
                                    float(np.abs(np.diff(needed[known])).sum()),
                                    float(np.abs(v[known]).max()))
        if share > worst:
            worst, at = share, float(start)
    if worst <= CHATTER:
        return ()
    return (f'Chatter inside the layer, or noise passed on: in the second from {at:.4g} s on v '
            f'varies {worst:.1f} times as much as the reference needs; a smaller K is calmer.',)


def _promised(view: View) -> Guarantee:
    """Return what the theorem promises."""
    setting, c = view.setting, view.setting.configuration
    if not setting.law and setting.epsilon is None:
        return Guarantee('Nothing is known of the law of this run, so nothing is promised.',
                         None, (), ())
    if not view.has_layer or setting.lambda_ is None:
        return Guarantee(f'The law {setting.law} has no boundary layer; no bound of its error is '
                         'promised.', None, (), ())
    bounds = guaranteed_bounds(setting.lambda_, view.widest, setting.order)
    if setting.law not in PROVEN:
        return Guarantee(f"Ω_ε is the set of the paper's theorem, which is not about the law "
                         f'{setting.law or "of this run"}: for comparison only.', bounds, (), ())
    if c is None:
        return Guarantee('Ω_ε follows from λ and ε; without the configuration the assumptions '
                         'of the theorem cannot be checked.', bounds, (), ())
    broken = _broken(c, setting.simulated)
    statement = ('The theorem promises, in continuous time, that the errors end up within Ω_ε and '
                 'all signals stay bounded.') if not broken else (
        'An assumption of the theorem does not hold, so it promises nothing here; Ω_ε is for '
        'comparison only.')
    return Guarantee(statement, bounds, broken, _beyond(view, c))


def _broken(c: Configuration, simulated: bool) -> tuple[str, ...]:
    """Return what of (18) and, of a simulated dead-zone, of (A1)–(A4) does not hold."""
    gain = RobustGain.of(c)
    found = [f'(18): {gain.words}.'] if gain is not None and not gain.covers() else []
    if simulated:
        found += [f'{item.rule}: {item.words}.' for item in check_dead_zone(c)
                  if item.level != INFO]
        if not same_slope(c.dead_zone.m_r, c.dead_zone.m_l):
            found.append(f'(A2): the slopes differ, m_r = {c.dead_zone.m_r:g}, m_l = '
                         f'{c.dead_zone.m_l:g}.')
        if any(len(set(c.dead_zone.extent(name, c.loop.schedule))) > 1
               for name in ('m_r', 'm_l')) or c.dead_zone.edge_slope != 1.0:
            found.append('The slope of the dead-zone drifts, follows another variable or changes '
                         'with v; the theorem takes a constant one.')
    return tuple(found)


def _covered(view: View) -> tuple[str, bool]:
    """Return what k* covers, as `dz check` states it, and whether the run had more."""
    c = view.setting.configuration
    gain = None if c is None else RobustGain.of(c)
    if gain is None:
        return '', False
    disturbance = view.rows.truth.get('disturbance')
    if disturbance is None or gain.design.k <= 0.0 or not gain.covers():
        return f'{gain.words}.', False
    largest = float(np.abs(np.nan_to_num(disturbance)).max(initial=0.0))
    return (f'{gain.words}; this run had {largest:.4g}{gain.units.behind("x^(n)")} of it'
            f'{gain.beside(largest)}.',
            view.setting.law in PROVEN and not gain.covers(largest))


def _observed(view: View) -> str:
    """Return which state was observed; '' where none was, or the device's driver is not here."""
    with contextlib.suppress(DzRosError):   # the view's own configuration has no driver
        return observed_state(Configuration.from_untrusted(view.setting.flat, driven=True))
    return ''


def _beyond(view: View, c: Configuration) -> tuple[str, ...]:
    """Return what the theorem does not cover and this run has."""
    behind = Units.of(c.plant).behind
    found = [f'Sampling: the law runs every {1e3 * c.loop.period:g} ms, not continuously.']
    observed = _observed(view)
    if observed:
        found.append(f'{observed}; the theorem takes all states as measured.')
    if any(len(set(c.dead_zone.extent(name, c.loop.schedule))) > 1 for name in ('b_r', 'b_l')):
        found.append('b_r or b_l drifts: with a constant slope and within the bounds the theorem '
                     'covers that, ρ bounds d(v) all the same.')
    if c.loop.delay:
        found.append(f'Loop delay: {c.loop.delay} whole sample(s).')
    if view.setting.mode == 'realtime':
        found.append('Transport: commands arrive when they do; see the timing.')
    if any(c.noise):
        noise = ', '.join(f'{value:g}{behind(f"x^({i})")}' for i, value in enumerate(c.noise))
        found.append(f'Measurement noise of standard deviation {noise}; it is part of the '
                     'measured error.')
    if c.plant_settings.command_limit:
        found.append(f'The actuator clips |v| to {c.plant_settings.command_limit:g}{behind("v")}.')
    if np.nan_to_num(view.rows.truth.get('disturbance', np.zeros(1))).any():
        found.append('A disturbance that the controller does not model.')
    return tuple(found)
