# SPDX-License-Identifier: Apache-2.0
"""Design rules of a configuration, checked and explained (ours).

    k* ≥ ρ/m_min + Δ/(b_min m_min) + ρ_I      (18), dz_ros.core.design.robust_gain
    ω against K, and its noise against ε       (core/design/observation), where a driver observes
    limit cycle of commands in steps           (core/design/command_steps)
    spectral radius of the loop < 1            no chatter (dz_ros.core.design.linear_loop)
    |x̃_i| ≤ 2^(i−1) λ^(i−n) ε                 Ω_ε (dz_ros.core.tracking)

An error means that the theorem, or a calm command, is lost for certain; a warning that it may be,
or is for some plant within the bounds. Theory: mathematics.md §5, §12.

Over 300 lines: a report of rules, each a few lines of text about numbers found elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.along_reference import disturbance_along_reference
from dz_ros.core.design.assumptions import check_assumptions, check_projection
from dz_ros.core.design.boundary_layer import chatter_limit
from dz_ros.core.design.command_steps import check_command_steps
from dz_ros.core.design.finding import ERROR, Finding, INFO, WARNING
from dz_ros.core.design.guard_noise import check_guard, noise_in_s
from dz_ros.core.design.linear_loop import (
    largest_beta,
    largest_gain,
    LinearObserver,
    spectral_radius,
)
from dz_ros.core.design.observation import (
    check_observer,
    linear_observer,
    measured_steps,
)
from dz_ros.core.design.robust_gain import RobustGain
from dz_ros.core.laws.base import Design, Law
from dz_ros.core.tracking import guaranteed_bounds
from dz_ros.core.units import Units

DELAYS = (0, 1, 2)
"""Loop delays for which the margin is stated [samples]; topics take one of the first two."""


def check(configuration: Configuration, disturbance: float | None = None,
          stability_limit: float | None = None,
          lost: bool | None = None, complaints: bool = False) -> tuple[Finding, ...]:
    """Return the findings of all rules, assumptions first.

    Args:
        configuration: The configuration to check.
        disturbance: Bound on the disturbance to withstand [unit of x^(n)]; None = what the
            plant's model gives along the reference.
        stability_limit: `dz_ros.core.design.stability.lambda_limit` of it [1/s]; None = not
            computed.
        lost: `dz_ros.core.design.stability.lost_from_start` of it; None = not computed.
        complaints: True where only warnings and errors are wanted, quickly: margins of a calm loop
            are not computed.

    Raises:
        ConfigurationError: It is of several axes.
    """
    configuration.require_one()
    c, design = configuration, configuration.law.design
    findings = list(check_assumptions(c))
    if design is None:
        findings.append(Finding(WARNING, 'law', f'nothing is known of {c.law.name}: the rules on '
                                'k*, Ω_ε, chatter and λ were not applied'))
        return tuple(findings)
    if disturbance is None:
        disturbance = disturbance_along_reference(c)
    driver = c.make_driver()
    findings += [*check_projection(c, design), *_robust_gain(c, design, disturbance),
                 *_target(c, design), *_layer(c, design, driver, complaints),
                 *check_command_steps(c, getattr(driver, 'command_resolution', 0.0),
                                      driver.measured),
                 *_stability(c, design, stability_limit, lost),
                 *_uncovered(c, design, noise_in_s(c, driver.measured, measured_steps(driver)))]
    return tuple(findings)


def _layer(c: Configuration, design: Design, driver: Any, complaints: bool) -> Iterator[Finding]:
    """Chatter, observer and guard."""
    observer = linear_observer(c, driver.measured)
    unknown = driver.measured < c.plant.order and observer is None
    for item in _chatter(c, design, complaints, observer):
        yield replace(item, words=f'{item.words}; were the velocity measured: with the observer, '
                      'which is not linear, it begins earlier') if unknown else item
    yield from check_observer(c, driver.measured, measured_steps(driver))
    yield from check_guard(c, driver.measured, measured_steps(driver))


def layer_complaints(c: Configuration) -> tuple[Finding, ...]:
    """Return the warnings and errors of `check` on the layer alone: chatter, observer, guard."""
    design = c.law.design
    if design is None:
        return ()
    return tuple(item for item in _layer(c, design, c.make_driver(), complaints=True)
                 if item.level != INFO)


def _robust_gain(c: Configuration, design: Design, disturbance: float) -> Iterator[Finding]:
    """(18), with the disturbance and an integral on top."""
    gain = RobustGain.of(c)
    assert gain is not None
    full = gain.with_disturbance(disturbance)
    numbers = {'k': design.k, 'rho': gain.bound, 'least': gain.least, 'reserve': design.reserve,
               'disturbance': disturbance, 'least_with_disturbance': full, 'covered': gain.room}
    along = (f'{gain.words}; along the reference the model has {disturbance:.4g}'
             f'{gain.units.behind("x^(n)")} of it'
             f'{gain.beside(disturbance)}')
    if design.k <= 0.0 and not design.inverse:
        yield Finding(WARNING, '(18)', gain.words, numbers, 'choose another law')
    elif not gain.covers():
        yield Finding(ERROR, '(18)', gain.words, numbers,
                      f'raise k* to {gain.least:.4g}, or narrow the bounds'
                      + (', or give the integral less authority' if design.reserve else '')
                      + (', or guess the break points better' if design.guess else ''))
    elif gain.covers(disturbance) or gain.leaves_to_integral(disturbance):
        yield Finding(INFO, '(18)', along, numbers)
    else:
        yield Finding(WARNING, '(18)', along, numbers, f'raise k* to {full:.4g}, or rely on what '
                      'adaptation and layer absorb')


def _target(c: Configuration, design: Design) -> Iterator[Finding]:
    """Ω_ε."""
    if design.target <= 0.0:
        yield Finding(INFO, 'Ω', f'{c.law.name} promises no set that the error converges to')
        return
    bounds = guaranteed_bounds(design.lambda_, design.target, c.plant.order)
    behind = Units.of(c.plant).behind
    parts = (f'|x̃{i + 1}| <= {bound:.4g}{behind(f"x^({i})")}' for i, bound in enumerate(bounds))
    yield Finding(INFO, 'Ω', 'where the theorem holds the error converges to '
                  f'|s| <= {design.target:.4g}{behind("x^(n-1)")}: ' + ', '.join(parts),
                  {f'x{i}': bound for i, bound in enumerate(bounds)})


def _chatter(c: Configuration, design: Design, complaints: bool,
             observer: LinearObserver | None) -> Iterator[Finding]:
    """B m against its limit, for the delays a loop may have and the one configured.

    `observer`: that of the velocity, where it is observed by a linear one.
    """
    known, period = c.controller_settings, c.loop.period
    betas = tuple(b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True))
    law, model, behind = c.law, c.law.layer_model(), Units.of(c.plant).behind
    if model is None:
        return
    for delay in sorted({*DELAYS, c.loop.delay}):
        unlikely = delay > 1 and delay != c.loop.delay      # never more than a note
        if complaints and (unlikely or all(
                spectral_radius(model, period, beta, delay, observer) < 1.0 for beta in betas)):
            continue
        largest = largest_beta(model, period, delay, observer)
        low, high = (beta / largest if largest > 0.0 else math.inf for beta in betas)
        numbers = {'delay': float(delay), 'share_low': low, 'share_high': high,
                   'largest_beta': largest}
        words = (f'delay {delay}: b m is {low:.2f} to {high:.2f} of where chatter begins'
                 if largest > 0.0 else f'delay {delay}: K is too high at any input gain')
        # A rate by the rule falls with K: with an observer it, not K, is what can be raised.
        steepest = 0.0
        if observer is None:
            steepest = numbers['largest_gain'] = largest_gain(law.layer_model, period, betas[1],
                                                              delay)
        if observer is None and design.epsilon > 0.0 and design.k > 0.0:
            k_d = design.gain - design.k / design.epsilon
            smallest = (design.k / (steepest - k_d)
                        if steepest > max(k_d, design.least_gain) else math.inf)
            numbers['smallest_epsilon'] = smallest
            margin = own_margin(law, steepest) if derives_epsilon(law.gains) else None
            if math.isfinite(smallest):
                words += (f'; smallest usable ε {smallest:.3g}{behind("x^(n-1)")} with '
                          f'K = {steepest:.4g}{behind("v/x^(n-1)")}')
                if margin is not None:
                    numbers['largest_margin'] = margin
                    words += f', controller.margin = {margin:.3g}' if margin <= 1.0 else ''
        change = _calmer(c, delay, numbers) if observer is None else (
            'raise driver.observer, as far as its own rule leaves the layer room, or measure the '
            'velocity')
        own = delay == c.loop.delay
        level = INFO
        if high >= 1.0:
            certain = own and low >= 1.0 and observer is None
            level = ERROR if certain else WARNING if own or delay <= 1 else INFO
            words += ': chatters' + (' where b m is large' if low < 1.0 else ' for certain')
        yield Finding(level, 'chatter', words, numbers, '' if level == INFO else change)


def derives_epsilon(gains: Any) -> bool:
    """Return whether ε is made from margin, beta and design_delay instead of being a gain."""
    return (bool(getattr(gains, 'automatic_epsilon', not hasattr(gains, 'epsilon')))
            and all(hasattr(gains, key) for key in ('margin', 'beta', 'design_delay')))


def own_margin(law: Law, gain: float) -> float:
    """Return the f with which a law that makes its own ε arrives at this K: its inverse.

    f = (K + lead) β T/μ_d, by `derives_epsilon` of its gains. Its bounds on K stay: a K beyond
    `gain_cap` or below its least is reached by no f.
    """
    return (gain + _own_lead(law)) / _own_limit(law)


def own_gain(law: Law) -> float:
    """Return the K at which a law that makes its own ε arrives, `gain_cap` kept, not its least."""
    gain = law.gains.margin * _own_limit(law) - _own_lead(law)
    return float(min(gain, getattr(law.gains, 'gain_cap', math.inf)))


def _own_lead(law: Law) -> float:
    """Return φ̂ Λ_v,n where it is a part of K0, in `extended` [actuator unit per unit of s]."""
    return law.design.lead if law.design is not None and hasattr(law.gains, 'epsilon') else 0.0


def _own_limit(law: Law) -> float:
    """Return μ_d/(β T) of a law's own gains [actuator unit per unit of s]."""
    return float(chatter_limit(law.gains.design_delay) / (law.gains.beta * law.period))


def _calmer(c: Configuration, delay: int, numbers: Mapping[str, float]) -> str:
    """Return what makes K small enough, in keys the law has."""
    smallest, steepest = numbers.get('smallest_epsilon'), numbers['largest_gain']
    gains, known = c.law.gains, c.controller_settings
    if smallest is None:
        return ('lower k_d' + (f' below {steepest:.4g}' if steepest > 0.0 else '')
                + ', or raise loop.rate')
    if math.isinf(smallest):
        return 'lower k_d or raise loop.rate: no ε is large enough'
    if 'largest_margin' not in numbers:
        if hasattr(gains, 'layer_gain'):
            return (f'make controller.layer_gain smaller than {steepest:.4g}, or raise loop.rate'
                    + (f'; controller.design_delay is {gains.design_delay} here, not {delay}'
                       if gains.design_delay < delay else ''))
        layer = 'controller.epsilon' if hasattr(gains, 'epsilon') else 'ε'
        return f'make {layer} larger than {smallest:.3g}, lower k_d, or raise loop.rate'
    words = f'make controller.margin smaller than {numbers["largest_margin"]:.3g}'
    if hasattr(gains, 'gain_cap'):
        words += f' or controller.gain_cap smaller than {steepest:.4g}'
    words += ', or raise loop.rate'
    beta = known.b_bounds[1] * known.m_bounds[1]
    if gains.design_delay < delay:
        words += f'; controller.design_delay is {gains.design_delay} here, not {delay}'
    if gains.beta < beta:
        words += f'; controller.beta is {gains.beta:g}, b_max m_max {beta:g}'
    return words


def _stability(c: Configuration, design: Design, limit: float | None,
               lost: bool | None) -> Iterator[Finding]:
    """λ against the limit found by simulation, or whether it is beyond it."""
    if limit is None:
        if lost is not None:
            yield Finding(
                ERROR if lost else INFO, 'λ', f'λ = {design.lambda_:g}; from this initial state '
                + ('the sampled loop is lost' if lost else 'the sampled loop finds its reference'),
                {'lambda': design.lambda_},
                'lower λ (`dz check` finds its limit), start nearer to the reference, or project'
                if lost else '')
        return
    numbers = {'lambda': design.lambda_, 'limit': limit}
    if math.isinf(limit):
        yield Finding(INFO, 'λ', 'no λ was found at which the sampled loop is lost', numbers)
        return
    level, change = INFO, ''
    if design.lambda_ > limit:
        level = ERROR
        change = f'lower λ below {limit:.3g}, start nearer to the reference, or project'
    elif design.lambda_ > 0.8 * limit:
        level, change = WARNING, f'keep λ below {0.8 * limit:.3g}'
    refused = ' or has no layer' if getattr(c.law.gains, 'automatic_epsilon', False) else ''
    yield Finding(level, 'λ', f'λ = {design.lambda_:g}; from this initial state the sampled loop '
                  f'is lost{refused} above λ = {limit:.3g}', numbers, change)


def _uncovered(c: Configuration, design: Design, sigma: float | None) -> Iterator[Finding]:
    """Return what the theorem does not cover; sigma: σ_s, None = not known."""
    limit = c.plant_settings.command_limit
    v = Units.of(c.plant).behind('v')
    gaps = ['sampling and loop delay']
    if sigma:
        gaps.append('measurement noise (v shows '
                    f'{(design.gain + design.lead) * sigma:.3g}{v} of it)')
    elif sigma is None or any(c.noise):
        gaps.append('measurement noise')
    if limit > 0.0:
        gaps.append(f'saturation at {limit:g}{v}')
    if c.plant_settings.backlash > 0.0:
        gaps.append(f'a play of {c.plant_settings.backlash:g}{v} in the actuator')
    if getattr(c.plant.parameters, 'static_friction', 0.0) > 0.0:
        gaps.append('friction that sticks: it depends on the command, as no regressor does')
    yield Finding(INFO, 'not covered', 'the theorem is of continuous time and does not cover ' +
                  ', '.join(gaps))
    known, used = getattr(c.law.gains, 'v_max', None), getattr(c.law.gains, 'anti_windup', True)
    if limit > 0.0 and known is not None and not (used and 0.0 < known <= limit):
        yield Finding(WARNING, 'saturation', f'the actuator clips at {limit:g}{v}, the law '
                      + (f'believes {known:g}{v}' if known and used else 'knows no limit')
                      + ': estimates and integral may wind up', {'limit': limit, 'v_max': known},
                      f'set controller.v_max to {limit:g}'
                      + ('' if used else ' and controller.anti_windup to true'))
