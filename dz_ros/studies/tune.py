# SPDX-License-Identifier: Apache-2.0
"""Gains proposed from bounds, rate, delay and effort, by the design rules (ours).

    d   = max(configured delay, 1): a loop over topics takes up to one sample
    k*  = (ρ + m_max q/2)/m_min + Δ/(b_min m_min) + ρ_I       dead-zone, command in steps of q,
                                                              disturbance, integral
    β   = b_max m_max,   K0 = f μ_d/(β T)                      the steepest layer with margin f
    f   = the configured one where the law has one, at most 0.8 of where its integral chatters
    K0  is lowered, and what follows it, until the rules of `dz check` on chatter, observer and
          guard give no warning (`dz_ros.studies.tune_layer`)
    k_d = the configured one, at most K0/3                    so that the rest of K is k*/ε
    ε   = k*/(K0 − k_d − (n−1) λ φ̂)                            not where the law makes its own;
          with an integral or an observed velocity K0 is half of where all together chatter
    γ, η = c k_d/(T max(|Y|² + u_d²)) along the reference,  c = 1/80
    φ̂   in [1/(b_max m_max), 1/(b_min m_min)], θ̂_i in a_i times that, each a fifth wider; they
          start in the middle
    ρ0  = k* − ρ/m_min;  k_2 = 2 k_d, 0 for λ ≥ 8 where regressors hang on velocities
    v_max = the limit of the actuator, or the configured one where the plant has none
    λ   = half the limit of stability at most, and what keeps peak |v| within the effort, both
          found by simulation; at most the configured λ times 4

The gains of `robust_eso` follow its own rules (`dz_ros.core.laws.robust_eso_gains`), those for an
encoder where the velocity is not measured; K0 and all that follows it are lowered, then ω_o, until
the same rules are kept, with a sample of delay to spare where the actuator is a device. A faster
observer than by rule is taken where it allows a steeper K0 within the same noise of v. The start
is slowed down until it keeps the effort. Where no K0 keeps them the proposal is the steepest one,
with what `dz check` warns of.
c gives the order of the paper's gains on the paper's example. a_i are those of the plant's model:
where they are guesses, widen θ's bounds. Nothing here is optimal; it is safe to start from.

Over 300 lines: two families of laws with their reasons.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.along_reference import disturbance_along_reference
from dz_ros.core.design.boundary_layer import chatter_limit
from dz_ros.core.design.command_steps import COMMAND_STEPS
from dz_ros.core.design.finding import Finding, INFO
from dz_ros.core.design.observation import (
    linear_observer,
    measured_steps,
    sensor_noise,
    state_noise,
)
from dz_ros.core.design.robust_gain import (
    dead_zone_bound,
    least_robust_gain,
    rounding_bound,
)
from dz_ros.core.design.rules import check, derives_epsilon
from dz_ros.core.design.stability import lambda_limit
from dz_ros.core.laws.base import Design
from dz_ros.core.laws.robust_eso_gains import (
    gains_by_rule,
    gains_for_encoder,
    OBSERVER_RATE,
    QUIET_SHARE,
)
from dz_ros.core.laws.robust_eso_gains import (
    SHARE as ESO_SHARE,
)
from dz_ros.core.schema import fields
from dz_ros.errors import ConfigurationError
from dz_ros.studies.code_folder import keep_compiled
from dz_ros.studies.outcome import Row, run_row
from dz_ros.studies.tune_layer import loop_delays, MARGIN, settled, suits, with_layer

ADAPTATION = 1.0 / 80.0
"""c of γ and η."""
WIDER = 0.2
"""Projection bounds are this much wider than what the bounds of plant and dead-zone give."""
STEEP = 8.0
"""λ from which on the outer gain k_2 raises the peak of plants with velocity regressors [1/s]."""
LOWERED = ('controller.margin', 'controller.k_d', 'controller.gamma', 'controller.eta',
           'controller.k_2')
"""What is lowered with K."""
FOLLOW_GAIN = ('layer_gain', 'lambda', 'start_rate', 'observer_rate', 'k_2')
"""Gains of `robust_eso` that are shares of K0."""
SLOWER_OBSERVERS = (1.0, 0.67, 0.42)
"""Shares of ω_o that are tried where no K0 keeps the rules."""
FASTER_VELOCITIES = (1.0, 1.2, 1.4, 2.0, 2.8)
"""Multiples of the rule's ω of an observed velocity that are tried."""
NO_SENSOR: Mapping[float, Mapping[str, float]] = {1.0: {}}
"""What `_calmest` has of a sensor where the velocity is measured."""
WORTH = 1.03
"""A faster one is taken where it allows this many times the K0."""
ROOM_OF_LAMBDA = 1.25
"""Multiple of λ up to which its limit is searched; `check` warns of one nearer."""
SLOT, NOISE = 0.3, 0.1
"""ρ0 over k*; σ of v over k* from which on a set is the quiet one."""
STEPS = (4.0, 2.83, 2.0, 1.41, 1.0, 0.71, 0.5, 0.35, 0.25, 0.18, 0.125)
"""Multiples of the configured λ that are tried, steepest first."""


@dataclass(frozen=True)
class Proposal:
    """What is proposed.

    Attributes:
        before: The configuration given.
        after: The one proposed.
        reasons: Key → why it has its value; only keys that changed or were looked at.
        rows: Name → numbers in simulation: before and after, at the configured delay and one
            sample more.
        findings: Warnings and errors of the design rules about what is proposed, and the limit
            cycle of its command's steps where the device has any.
    """

    before: Configuration
    after: Configuration
    reasons: dict[str, str]
    rows: dict[str, Row]
    findings: tuple[Finding, ...] = ()


def tune(c: Configuration, effort: float = 0.0, disturbance: float | None = None) -> Proposal:
    """Return gains for a configuration and what they give.

    Args:
        c: What is known: bounds, rate, delay, reference, plant; a law with a robust gain k*.
        effort: Largest |v| allowed [actuator unit], at most the actuator's limit; 0 = that one,
            where it has none what the configuration takes now, a tenth more.
        disturbance: Largest disturbance [unit of x^(n)]; None = the model's along the reference.

    Raises:
        ConfigurationError: A law without k* or of all axes, a disturbance that the effort cannot
            hold, or no λ keeps within the effort.
    """
    keep_compiled()
    if c.law.coupled:
        raise ConfigurationError('controller.law', c.law.name, 'is a law of all axes, its gains '
                                 'are not proposed; choose robust_eso, robust, wang2004 or '
                                 'extended')
    names = {item.name for item in fields(type(c.law.gains))}
    if 'k_star' not in names or c.law.design is None:
        raise ConfigurationError('controller.law', c.law.name, 'has no k* to tune; choose robust, '
                                 'wang2004 or extended')
    limits = [item for item in (effort, c.plant_settings.command_limit) if item]
    effort = min(limits) if limits else _present_peak(c)
    delta = disturbance_along_reference(c) if disturbance is None else disturbance
    least = c.controller_settings.b_bounds[0] * c.controller_settings.m_bounds[0]
    if limits and disturbance is not None and delta > least * effort > 0.0:
        raise ConfigurationError('--disturbance', delta, f'needs |v| = {delta / least:.4g} by the '
                                 f'least b m = {least:.4g}, --effort = {effort:.4g}')
    if {'layer_gain', 'observer_rate', 'start_rate'} <= names:
        return _proposal(c, *_with_observer(c, c.law.design, delta, effort))
    values = _from_rules(c, c.law.design, delta)
    reasons = {key: why for key, (_, why) in values.items() if key.partition('.')[2] in names}
    changes = {key: values[key][0] for key in reasons}
    tuned, why = _with_lambda(c, changes, effort)
    reasons['controller.lambda'] = why
    flat = tuned.to_flat()
    if flat.get('controller.k_2') == 0.0 and changes.get('controller.k_2'):
        reasons['controller.k_2'] = (f'0: lambda is not below {STEEP:g} and regressors hang on '
                                     'velocities')
    for key in LOWERED:
        if key in changes and 0.0 < flat[key] < changes[key]:
            reasons[key] += f'; lowered from {changes[key]:.4g} by the rules on the layer'
    return _proposal(c, tuned, reasons)


def _proposal(c: Configuration, tuned: Configuration, reasons: dict[str, str]) -> Proposal:
    """Return the proposal with what both give in simulation."""
    rows = {}
    for extra in (0, 1):
        delay = {'loop.delay': c.loop.delay + extra}
        for name, item in (('before', c), ('after', tuned)):
            rows[f'{name}, delay {c.loop.delay + extra}'] = run_row(item.replace(**delay))
    # Up to what `check` warns of: two runs where it does not.
    limit = lambda_limit(tuned, highest=ROOM_OF_LAMBDA * float(tuned.law.gains.lambda_))
    measured = tuned.make_driver().measured
    unjudged = measured < tuned.plant.order and linear_observer(tuned, measured) is None
    kept = (COMMAND_STEPS, 'observer') if unjudged else (COMMAND_STEPS,)
    findings = tuple(item for item in check(tuned, stability_limit=limit, complaints=True)
                     if item.level != INFO or item.rule in kept)
    return Proposal(c, tuned, reasons, rows, findings)


def _covered(c: Configuration, design: Design) -> tuple[float, str]:
    """Return ρ with what rounding of v adds [actuator unit], and its share of k* as text."""
    rounding = rounding_bound(c, getattr(c.make_driver(), 'command_resolution', 0.0))
    share = rounding / c.controller_settings.m_bounds[0]
    return (dead_zone_bound(c, design) + rounding,
            f', of which {share:.4g} for v in steps' if share else '')


def _from_rules(c: Configuration, design: Design, delta: float) -> dict[str, tuple[Any, str]]:
    """Return key → value and reason of everything but λ (ε is made for λ = the configured)."""
    known, gains = c.controller_settings, c.law.gains
    bound, steps = _covered(c, design)
    low, high = (b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True))
    dead = least_robust_gain(bound, known.m_bounds[0])
    share = 0.0 if hasattr(gains, 'rho_0') else design.reserve      # ρ_0 is made to fit k*
    k_star = least_robust_gain(bound, known.m_bounds[0], known.b_bounds[0], delta, share)
    delay = max(c.loop.delay, 1)
    derived = derives_epsilon(gains)
    margin = gains.margin if derived else MARGIN
    steepest = margin * chatter_limit(delay) / (high * c.loop.period)
    k_d = min(gains.k_d, steepest / 3.0)
    phi = (1.0 / high / (1.0 + WIDER), (1.0 + WIDER) / low)
    start = 0.5 * (1.0 / high + 1.0 / low)
    theta = _of_forces(c, [sorted((a * phi[0], a * phi[1])) for a in c.plant.a])
    rate = ADAPTATION * k_d / (c.loop.period * _power(c))
    return {f'controller.{key}': item for key, item in {
        'k_star': (k_star, f'rho/m_min = {dead:.4g}{steps} and {delta:.4g} of disturbance'
                   + (f', {share:.4g} of the integral' if share else '')),
        'k_d': (k_d, f'at most a third of K0 = {steepest:.4g}'),
        'beta': (high, 'b_max m_max'),
        'design_delay': (delay, 'the loop takes up to this many samples'),
        'margin': (margin, 'as configured'),
        'gamma': (rate, 'slow against the layer, from max(|Y|² + u_d²) along the reference'),
        'eta': (rate, 'as gamma'),
        'phi_0': (start, 'middle of 1/(b m)'),
        'theta_0': ([a * start for a in c.plant.a], 'a_i of the model times the middle'),
        'phi_min': (phi[0], 'least 1/(b m), a fifth less'),
        'phi_max': (phi[1], 'largest 1/(b m), a fifth more'),
        'theta_min': ([item[0] for item in theta], 'least a_i/(b m), a fifth less'),
        'theta_max': ([item[1] for item in theta], 'largest a_i/(b m), a fifth more'),
        'rho_0': (k_star - dead, 'what k* has beyond rho/m_min'),
        'k_2': (2.0 * k_d, '2 k_d'),
        'v_max': (c.plant_settings.command_limit or getattr(gains, 'v_max', 0.0),
                  "the actuator's limit, 0 = none"),
        'epsilon': (0.0, f'at most {MARGIN:g} of the slope at which the loop chatters at delay '
                         f'{delay}'),
    }.items() if key not in (('epsilon',) if derived else ('margin', 'beta', 'design_delay'))}


def _of_forces(c: Configuration, boxes: Sequence[Sequence[float]]) -> list[Sequence[float]]:
    """Return bounds of θ̂_i in which a constant force has either sign, up to the friction."""
    found = list(boxes)
    for place in c.plant.friction[1:]:
        most = max(map(abs, (*boxes[place], *boxes[c.plant.friction[0]])))
        found[place] = (-most, most)
    return found


def _with_observer(c: Configuration, design: Design, delta: float,
                   effort: float) -> tuple[Configuration, dict[str, str]]:
    """Return the configuration with the gains of `robust_eso` by its rules, and why.

    Raises:
        ConfigurationError: No start is slow enough for the effort.
    """
    known, driver = c.controller_settings, c.make_driver()
    (bound, steps), m_min, b_min = _covered(c, design), known.m_bounds[0], known.b_bounds[0]
    k_star = least_robust_gain(bound, m_min, b_min, delta) / (1.0 - SLOT)
    low, high = (b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True))
    middle, period = 0.5 * (1.0 / low + 1.0 / high), c.loop.period
    delay = min(max(c.loop.delay, 1), 2)
    theta = [a * middle for a in c.plant.a]
    common = (period, known.b_bounds, known.m_bounds, k_star, c.law.gains.k_d, theta, middle,
              delay)
    gains = gains_by_rule(*common)
    observed = driver.measured < c.plant.order
    noise = gains['layer_gain'] * state_noise(c, measured_steps(driver))[-1]
    quiet = noise > NOISE * k_star and not observed     # nothing measures x^(n−1) then
    if quiet:
        gains = gains_by_rule(*common, quiet=True)
    boxes = _of_forces(c, list(zip(gains['theta_min'], gains['theta_max'], strict=True)))
    gains |= {'k_star': k_star, 'theta_0': theta, 'phi_0': middle,
              'theta_min': [low for low, _ in boxes], 'theta_max': [high for _, high in boxes]}
    limit = c.plant_settings.command_limit
    if limit > 0.0:
        gains |= {'v_max': limit}
    by_rule = 'by rule from K0, k* and the bounds'
    reasons = dict.fromkeys(gains, by_rule) | {
        'k_star': f'rho/m_min{steps}, {delta:.4g} of disturbance and rho_0 = {SLOT:g} k*',
        'layer_gain': f'{QUIET_SHARE if quiet else ESO_SHARE:.3g} of the chatter limit at delay '
                      f'{delay}' + (
                          f', quiet: noise would put {noise:.3g} into v' if quiet else ''),
        'design_delay': 'the loop takes up to this many samples',
        'lambda': 'K0 b_hat/7' if quiet else 'K0 b_hat/6', 'start_rate': 'lambda/5',
        'observer_rate': '0.83 K0 b_hat', 'k_2': '2 K0/3',
        'phi_0': 'middle of 1/(b m)', 'theta_0': 'a_i of the model times the middle',
        'v_max': "the actuator's limit"}
    sets = NO_SENSOR
    if observed:
        sigma = sensor_noise(c, measured_steps(driver))
        judged = sigma > 0.0 and linear_observer(c, driver.measured) is not None
        sets = {faster: gains_for_encoder(period, sigma, high, gains['input_gain'], k_star, delay,
                                          faster)
                for faster in (FASTER_VELOCITIES if judged else FASTER_VELOCITIES[:1])}
        gains |= sets[1.0]
        for key in FOLLOW_GAIN:
            reasons[key] = f'the velocity is observed, from noise of {sigma:.3g}'
    changes = {f'controller.{key}': item for key, item in gains.items()}
    if observed:
        changes['driver.observer'] = 0.0
    start, found = _calmest(c, changes, sets)
    changes |= found
    changes['controller.k_d'] = min(changes['controller.k_d'],
                                    changes['controller.layer_gain'] / 6.0)
    gains |= {key: changes[f'controller.{key}'] for key in gains}
    for key in FOLLOW_GAIN:
        first = start[f'controller.{key}']
        if gains[key] < first:
            reasons[key] += f'; lowered from {first:.4g} by the rules on the layer'
            if key == 'layer_gain' and not driver.lockstep:
                reasons[key] += f', calm at delay {loop_delays(c)[-1]} too'
    if observed:
        rate = OBSERVER_RATE * gains['layer_gain'] * gains['input_gain']
        faster = changes['driver.observer'] / rate
        reasons['driver.observer'] = (f'{faster:.2g} times the rule, for a steeper K0' if faster
                                      else f'0 = by rule, {rate:.4g} rad/s')
    changed = {key if '.' in key else f'controller.{key}': why for key, why in reasons.items()
               if f'controller.{key}' in changes or key in changes}
    smallest = float('inf')
    for slower in (1.0, 0.7, 0.5, 0.35, 0.25, 0.15):
        tried = c.replace(**{**changes, 'controller.start_rate': slower * gains['start_rate']})
        row = run_row(tried)
        if row['lost'] or row['v_peak_run'] is None:
            continue
        smallest = min(smallest, row['v_peak_run'])
        if not effort or row['v_peak_run'] <= effort:
            changed['controller.start_rate'] += f', peak |v| {row["v_peak_run"]:.4g}'
            return tried, changed
    raise ConfigurationError('--effort', effort, 'no start keeps within it; the least peak |v| '
                             f'found is {smallest:.4g}: start nearer to the reference or allow '
                             'more')


def _calmest(c: Configuration, changes: dict[str, Any], sets: Mapping[float, Mapping[str, float]]
             ) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what was begun with, and the gains that follow K0, lowered until they suit, by key.

    sets: ω over that of the rule → the gains that the sensor's noise allows with it, slowest
    first. Taken is the observer that allows the largest K0, of those with nearly as large a K0 the
    slowest. Without any that suits: the changes, and nothing.
    """
    start: dict[str, Any] = changes
    best: dict[str, Any] = {}
    for faster, gains in sets.items():
        tried = changes | {f'controller.{key}': item for key, item in gains.items()}
        least = WORTH * best.get('controller.layer_gain', 0.0)
        if tried['controller.layer_gain'] <= least:     # it is only lowered from there
            continue
        found = _calmest_with(c, tried, faster)
        if found and found['controller.layer_gain'] > least:
            start, best = tried, found
    return start, best


def _calmest_with(c: Configuration, changes: dict[str, Any], faster: float) -> dict[str, Any]:
    """Return these gains with a multiple of the rule's ω; none if they suit at no K0."""
    keys = tuple(f'controller.{key}' for key in FOLLOW_GAIN)
    rate = faster * OBSERVER_RATE * changes['controller.input_gain'] if faster != 1.0 else 0.0
    for slower in SLOWER_OBSERVERS:
        def made(share: float, slower: float = slower) -> Configuration:
            scaled = {key: share * changes[key] for key in keys}
            scaled['controller.observer_rate'] *= slower
            scaled['controller.k_d'] = min(changes['controller.k_d'],
                                           scaled['controller.layer_gain'] / 6.0)
            if rate:
                scaled['driver.observer'] = rate * scaled['controller.layer_gain']
            return c.replace(**{**changes, **scaled})

        found = settled(made)
        if suits(found):
            flat = found.to_flat()
            return {key: flat[key] for key in (*keys, 'controller.k_d',
                                               *(('driver.observer',) if rate else ()))}
    return {}


def feels_velocity(c: Configuration) -> bool:
    """Return whether some regressor depends on more of the state than x itself."""
    n, span = c.plant.order, c.loop.duration or 60.0
    still, moving = ([0.0] * c.plant.regressor_count for _ in range(2))
    for k in range(9):
        x = [0.1 + item for item in c.trajectory(span * k / 8.0)[:n]]
        c.plant.regressors(x, c.plant.constants, moving)
        c.plant.regressors([x[0], *(item + 0.7 for item in x[1:])], c.plant.constants, still)
        if moving != still:
            return True
    return False


def _present_peak(c: Configuration) -> float:
    """Return the effort of the configuration as it is, a tenth more; 0 = it is lost."""
    row = run_row(c)
    return 0.0 if row['lost'] else 1.1 * float(row['v_peak_run'])


def _power(c: Configuration) -> float:
    """Return max(|Y|² + u_d²) along the reference."""
    largest, y = 0.0, [0.0] * c.plant.regressor_count
    for k in range(2001):
        x_d = c.trajectory((c.loop.duration or 60.0) * k / 2000.0)
        c.plant.regressors(x_d[:c.plant.order], c.plant.constants, y)
        largest = max(largest, sum(item * item for item in y) + x_d[-1] ** 2)
    return max(largest, 1e-12)


def _with_lambda(c: Configuration, changes: dict[str, Any],
                 effort: float) -> tuple[Configuration, str]:
    """Return the configuration with the steepest λ that is calm and within the effort.

    One that suits the rules on the layer comes first, one that does not where none does.
    """
    given = float(c.law.gains.lambda_)
    smallest, second = float('inf'), None
    limit = 0.5 * lambda_limit(_first(c, changes, given))
    for step in STEPS:
        slope = step * given
        if slope > limit:
            continue
        try:
            tried = proposal_at(c, changes, slope)
        except ConfigurationError:
            continue        # no layer is wide enough for such a slope
        row = run_row(tried)
        if row['lost'] or row['v_peak_run'] is None:
            continue
        smallest = min(smallest, row['v_peak_run'])
        if not effort or row['v_peak_run'] <= effort:
            peak = f', peak |v| {row["v_peak_run"]:.4g}'
            peak += f' within {effort:.4g}' if effort else ''
            lost = ('no λ tried loses the loop' if math.isinf(limit) else
                    f'at most half of where the loop is lost, {2.0 * limit:.4g}')
            words = f'{lost}{peak}'
            if suits(tried):
                return tried, words
            second = second or (tried, words)
    if second is not None:
        return second
    raise ConfigurationError('--effort', effort, 'no slope keeps within it; the least peak |v| '
                             f'found is {smallest:.4g}: start nearer to the reference or allow '
                             'more')


def _first(c: Configuration, changes: dict[str, Any], given: float) -> Configuration:
    """Return the configuration with the configured λ, or the next lower one it is possible with.

    Raises:
        ConfigurationError: It is possible with none.
    """
    for step in STEPS[STEPS.index(1.0):-1]:
        try:
            return proposal_at(c, changes, step * given)
        except ConfigurationError:
            continue
    return proposal_at(c, changes, STEPS[-1] * given)


def proposal_at(c: Configuration, changes: dict[str, Any], slope: float) -> Configuration:
    """Return the configuration with this λ and, where the law has them, the layer and k_2.

    Raises:
        ConfigurationError: No ε is wide enough.
    """
    values = {**changes, 'controller.lambda': slope}
    if slope >= STEEP and 'controller.k_2' in values and feels_velocity(c):
        values['controller.k_2'] = 0.0
    return with_layer(c, values)
