# SPDX-License-Identifier: Apache-2.0
"""How steep the layer of proposed gains may be, by the rules of `dz check` (ours).

    K ≤ f K_max          K_max by the spectral radius of the loop's matrix, with the observer of
                         an observed velocity, for a delay of 0, 1 and the configured one
    radius < 1           for these delays up to 1.05 times the largest b m; for a device also a
                         sample later, since how late a bus or a middleware is changes
    ε ≥ 4 σ_s and so on  what `dz_ros.core.design.rules.layer_complaints` asks: chatter, observer,
                         guard
    k_d + k_2            the slope outside of the layer, calm by the same matrix

Where a complaint is left at f K_max, K is lowered, and what follows it, until there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.linear_loop import largest_gain, spectral_radius, surface_model
from dz_ros.core.design.observation import linear_observer
from dz_ros.core.design.rules import layer_complaints, own_gain, own_margin
from dz_ros.core.tracking import feed_forward_weights
from dz_ros.errors import ConfigurationError

MARGIN = 0.5
"""f, share of the chatter limit that K uses where the law has no margin of its own."""
OWN_MARGIN = 0.8
"""A margin of the law's own may use this share of where its integral makes the loop chatter."""
RATIO, LEAST = 0.85, 0.1
"""K is lowered by this factor at a time, down to this share."""
ROOM = 1.05
"""The matrix must be calm up to this many times the largest b m: just below the limit oscillations
fade slowly."""
HALVINGS = 5
"""Of the interval in which the last complaint ends."""


def loop_delays(c: Configuration) -> tuple[int, ...]:
    """Return the delays for which a proposal must be calm [samples]; a device has one to spare."""
    spare = () if c.make_driver().lockstep else (max(c.loop.delay, 1) + 1,)
    return tuple(sorted({*_own_delays(c), *spare}))


def _own_delays(c: Configuration) -> set[int]:
    """Return the delays of which K keeps its margin [samples]."""
    return {0, 1, c.loop.delay}


def steepest_gain(c: Configuration) -> float:
    """Return the largest K without chatter, the observer in the loop where there is one.

    For a delay of 0, 1 and the configured one; a sample to spare is to be calm, no more.
    """
    known, measured = c.controller_settings, c.make_driver().measured
    beta = known.b_bounds[1] * known.m_bounds[1]
    return min(largest_gain(c.law.layer_model, c.loop.period, beta, delay,
                            lambda gain: linear_observer(c, measured, gain))
               for delay in _own_delays(c))


def is_calm(c: Configuration) -> bool:
    """Return whether the matrix is calm at both ends of b m, in the layer and outside of it.

    The upper end is `ROOM` times the bound.
    """
    design, model = c.law.design, c.law.layer_model()
    if design is None or model is None:
        return False
    known, observer = c.controller_settings, linear_observer(c, c.make_driver().measured)
    betas = [b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True)]
    models = [model]
    if hasattr(c.law.gains, 'k_2'):
        models.append(surface_model(c.plant.order, design.lambda_,
                                    design.k_d + c.law.gains.k_2, design.lead))
    return all(spectral_radius(item, c.loop.period, beta, delay, observer) < 1.0
               for item in models for delay in loop_delays(c)
               for beta in (betas[0], ROOM * betas[1]))


def suits(c: Configuration) -> bool:
    """Return whether no rule on the layer warns and the loop is calm."""
    return is_calm(c) and not layer_complaints(c)


def settled(make: Callable[[float], Configuration]) -> Configuration:
    """Return the configuration with the largest share of K that suits; with all of it if none.

    Args:
        make: The configuration as a function of the share, 1 at most.

    Raises:
        ConfigurationError: It is not possible with all of K.
    """
    whole = make(1.0)
    if suits(whole):
        return whole

    def tried(share: float) -> Configuration | None:
        try:
            found = make(share)
        except ConfigurationError:
            return None
        return found if suits(found) else None

    above, share = 1.0, RATIO
    while share >= LEAST:
        best = tried(share)
        if best is not None:
            for _ in range(HALVINGS):
                middle = 0.5 * (share + above)
                found = tried(middle)
                best, share, above = ((best, share, middle) if found is None
                                      else (found, middle, above))
            return best
        above, share = share, RATIO * share
    return whole


def with_layer(c: Configuration, values: dict[str, Any]) -> Configuration:
    """Return the configuration with these values and the layer that suits them.

    Lowered are ε or the margin that ε follows from, and k_d, γ, η, k_2, as far as they are among
    the values.

    Raises:
        ConfigurationError: No ε is wide enough.
    """
    own = [key for key in ('controller.epsilon', 'controller.margin') if key in values]
    if not own:
        return c.replace(**values)
    given = c.replace(**{key: item for key, item in values.items()
                         if key != 'controller.epsilon'})
    if own == ['controller.margin']:
        law = given.law
        whole = own_gain(law)
        steepest = min(whole, OWN_MARGIN * steepest_gain(given))
        if steepest <= 0.0:
            raise _no_layer(given)

        def steep(share: float) -> Configuration:
            gain = share * steepest
            margin = law.gains.margin if gain >= whole else own_margin(law, gain)
            return c.replace(**_slower(values, gain), **{'controller.margin': margin})

        return settled(steep)
    lead = feed_forward_weights(given.law.gains.lambda_, c.plant.order)[-1] * values[
        'controller.phi_0']
    steepest = MARGIN * (lead + steepest_gain(given))

    def wide(share: float) -> Configuration:
        lower = _slower(values, share * steepest)
        room = share * steepest - lower['controller.k_d'] - lead
        if room <= 0.0:
            raise _no_layer(given)
        return c.replace(**{**lower, 'controller.epsilon': values['controller.k_star'] / room})

    return settled(wide)


def _no_layer(c: Configuration) -> ConfigurationError:
    """Return the error of a slope at which no layer is wide enough."""
    return ConfigurationError('controller.lambda', c.law.gains.lambda_,
                              f'no layer is wide enough at {c.loop.rate:g} Hz')


def _slower(values: dict[str, Any], gain: float) -> dict[str, Any]:
    """Return the values with k_d at most a third of K, and what follows k_d."""
    found, k_d = {key: item for key, item in values.items() if key != 'controller.margin'}, (
        values.get('controller.k_d', 0.0))
    if 3.0 * k_d > gain:
        for key in ('k_d', 'gamma', 'eta', 'k_2'):
            if f'controller.{key}' in found:
                found[f'controller.{key}'] *= gain / (3.0 * k_d)
    return found
