# SPDX-License-Identifier: Apache-2.0
"""Which gain in the layer would be certified, where the configured one is not: a search (ours).

K is varied around the configured one, nearest first; around 0.6 of where the loop chatters if the
configured one is beyond that. Each is tried on a few cells of β and a part
of the reference, with k* raised where |s| leaves ε, and what holds there is certified in full: a
value that is named has its certificate, at one delay: others may need another value.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any, TYPE_CHECKING

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.linear_loop import largest_beta, largest_gain
from dz_ros.core.design.rules import derives_epsilon, own_margin
from dz_ros.core.units import Units
from dz_ros.errors import ConfigurationError

if TYPE_CHECKING:
    from dz_ros.core.design.certificate import DelayBounds

CALM = 0.6
"""Share of the chatter limit that is tried first where K is beyond it."""
SHARES = (1.0, 0.8, 1.25, 0.6, 1.6, 0.45, 2.0, 0.33, 0.25)
"""Multiples of that K which are tried, in this order."""
WIDER = 1.02
"""ε over the bound on |s| where k* is raised."""


def which_gain(c: Configuration, delay: int,
               bounds_of: Callable[[Configuration, bool], DelayBounds]) -> str:
    """Return the gains with which the loop is certified at this delay, as text.

    Args:
        c: A configuration that is not certified.
        delay: d [samples].
        bounds_of: What is shown for a configuration: in part, quickly, or in full (True).
    """
    design, known = c.law.design, c.controller_settings
    assert design is not None
    limit = CALM * largest_gain(c.law.layer_model, c.loop.period,
                                known.b_bounds[1] * known.m_bounds[1], delay)
    gains = [share * min(design.gain, limit) for share in SHARES if limit > 0.0]
    for gain in gains:
        changes = _rounded(gain_keys(c, gain))
        for _ in range(2):      # with its own k*, then with a larger one
            tried = _possible(c, changes, gain, delay)
            found = None if tried is None else bounds_of(tried, False)
            if tried is None or found is None or found.certified:
                break
            if not found.epsilon < found.s_bound < math.inf:
                break
            changes = {**changes, **_rounded(wider_layer(tried, found.s_bound))}
        if tried is None or found is None or not found.certified:
            continue
        shown = bounds_of(tried, True)
        if shown.certified:
            unit = Units.of(c.plant).behind('v/x^(n-1)')
            return (' with '.join(f'{key} = {value:.4g}' for key, value in changes.items())
                    + f': K = {gain:.4g}{unit} instead of {design.gain:.4g}{unit}, certified so '
                    f'at delay {delay}' + _bound(c, shown))
    if not gains:
        return 'no K is calm: raise loop.rate'
    return (f'none of {len(gains)} values of K from {min(gains):.3g} to {max(gains):.3g} was '
            'certified, with a larger k* neither: narrow the bounds, or raise loop.rate')


def _bound(c: Configuration, shown: DelayBounds) -> str:
    """Return the bound on the error as text."""
    if not shown.error_bound:
        return ''
    return f', |x̃1| <= {shown.error_bound[0]:.3g}' + Units.of(c.plant).behind('x')


def gain_keys(c: Configuration, gain: float) -> dict[str, Any]:
    """Return the keys that give the law this K in its layer, and their values."""
    gains, design = c.law.gains, c.law.design
    assert design is not None
    if hasattr(gains, 'layer_gain'):
        return {'controller.layer_gain': gain}
    if derives_epsilon(gains):
        keys = {'controller.margin': own_margin(c.law, gain)}
        if gain > getattr(gains, 'gain_cap', math.inf):
            keys['controller.gain_cap'] = gain
        return keys
    if not hasattr(gains, 'epsilon') or gain <= design.k_d:
        return {}
    return {'controller.epsilon': design.k / (gain - design.k_d)}


def wider_layer(c: Configuration, s_bound: float) -> dict[str, Any]:
    """Return the keys of a layer of the same K in which a bound on |s| has room, and their values.

    They are none of a law without a k* of its own.
    """
    design, gains = c.law.design, c.law.gains
    key = next((name for name in ('k_star', 'k') if hasattr(gains, name)), None)
    if design is None or key is None:
        return {}
    keys = {f'controller.{key}': design.k / design.epsilon * WIDER * s_bound}
    if hasattr(gains, 'epsilon') and not derives_epsilon(gains):
        keys['controller.epsilon'] = WIDER * s_bound
    return keys


def _rounded(changes: dict[str, Any]) -> dict[str, Any]:
    """Return the values with the digits that are shown."""
    return {key: float(f'{value:.4g}') for key, value in changes.items()}


def _possible(c: Configuration, changes: dict[str, Any], gain: float,
              delay: int) -> Configuration | None:
    """Return the configuration with these gains; None where it has not this K or chatters."""
    if not changes:
        return None
    try:
        tried = c.replace(**changes)
    except ConfigurationError:
        return None
    design, model, known = tried.law.design, tried.law.layer_model(), c.controller_settings
    if design is None or model is None or not math.isclose(design.gain, gain, rel_tol=0.01):
        return None
    high = known.b_bounds[1] * known.m_bounds[1]
    return tried if largest_beta(model, c.loop.period, delay) > high else None
