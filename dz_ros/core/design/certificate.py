# SPDX-License-Identifier: Apache-2.0
"""A certificate for the sampled, delayed loop inside its boundary layer (ours).

Where |s| ≤ ε at every sample the estimates rest and the loop is linear. With β = b m, the law's
linear part v_lin (`linear_loop`), ff = φ̂ x_d^(n) + θ̂ᵀY and g = x_d^(n) + aᵀY + disturbance, both
on the reference, the error obeys for t in [t_k, t_k + T), t_j = t_k − d T,

    x̃^(n) = β (v_lin(t_j) + d(v)/m) + β ff(t_j) − g(t) + tube

which is the loop of one β_c driven, in units of the command, by

    δ(t_k) + c    δ = ff − g/β, smooth in t, and c the middle of the band of d/m      D_0 … D_3
    −(ff(t_k) − ff(t_j))    the delay of the feed-forward                       d T sup |ff^(j+1)|
    −τ g'(t_k)/β            the ramp of g over the sample                         sup |g^(j+1)|/β
    ½ T² sup |g''|/β        the rest of it, arbitrary
    (b_r,max − b_l,min)/2   d/m, arbitrary in its band, held over a sample
    (θ̂_i − a_i/β) ΔY_i      what Y changes where x is not x_d but within the tube, held; how far it
                            moves within d + 1 samples, and what the disturbance changes: arbitrary
    |β/β_c − 1| |v_lin|     β is not β_c; all others times 1 + |β/β_c − 1|

Each enters the bounds of `loop_sums`. The range of β is cut into cells of 1 %, the reference
into steps of time; the tube |x̃_i(t)| ≤ E_i is enlarged until what it leads to stays inside. The
loop is certified if then |s| ≤ ε, the slot of the law stays within its authority and v within the
actuator's limit: a loop that is in its layer never leaves it.

Over 300 lines: one theorem, from the reference's derivatives to the verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import copy
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.certified_gain import which_gain, WIDER, wider_layer
from dz_ros.core.design.intervals import (
    Jet,
    join,
    load_flint,
    lower,
    NotEnclosedError,
    PRECISION,
    upper,
    Ways,
    with_jets,
)
from dz_ros.core.design.linear_loop import largest_beta
from dz_ros.core.design.loop_sums import loop_sums, LoopSums, SMOOTH
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants.coupled import CoupledPlant
from dz_ros.core.tracking import error_weights, feed_forward_weights
from dz_ros.core.units import Units
from dz_ros.errors import ConfigurationError

Array = NDArray[np.float64]

STEP, MOST_STEPS = 0.01, 3000
"""The reference is enclosed over intervals of this length [s], most of them."""
SPAN = 20.0
"""What is looked at of a reference without end [s]."""
CELL = 1.02
"""Ratio of the ends of a cell of β."""
ROUNDS = 12
"""Largest number of enlargements of the tube."""
PART, FEW_CELLS = 20, 4
"""Where a gain is searched: every 20th interval of the reference, 4 cells of β."""
ROUGH = 0.25
"""A regressor that changes by more than this share in a sample is taken as arbitrary."""


@dataclass(frozen=True)
class DelayBounds:
    """What was shown for one loop delay.

    Attributes:
        delay: d [samples].
        certified: Whether all inequalities hold.
        error_bound: Bounds on |x̃|, |x̃'|, …, at all times, shape (n,); empty = none found.
        sample_bound: The same at the samples.
        s_bound, epsilon: Bound on |s| at the samples, and ε.
        slot_bound, v_bound: Bounds on the law's slot and on |v| [actuator unit].
        fade: Time in which what the loop began with falls to a thousandth [s].
        failed: Inequalities that do not hold, as text.
        change: Gains that would do, as text; empty = nothing to change, or none known. Where there
            is no bound they are found by `certified_gain` and have a certificate.
    """

    delay: int
    certified: bool
    error_bound: tuple[float, ...]
    sample_bound: tuple[float, ...]
    s_bound: float
    epsilon: float
    slot_bound: float
    v_bound: float
    fade: float
    failed: tuple[str, ...] = ()
    change: str = ''


@dataclass(frozen=True)
class Certificate:
    """Bounds for every delay asked for, and what they rest on.

    Attributes:
        delays: One for each delay.
        estimates: Interval of θ̂_1 …, φ̂ that was assumed, shape (r + 1, 2).
        beta: Interval of β that was covered.
        assumed, proven, not_proven: Sentences.
    """

    delays: tuple[DelayBounds, ...]
    estimates: tuple[tuple[float, float], ...]
    beta: tuple[float, float]
    assumed: tuple[str, ...]
    proven: tuple[str, ...]
    not_proven: tuple[str, ...]

    @property
    def certified(self) -> bool:
        """Whether the loop is certified for every delay."""
        return all(item.certified for item in self.delays)

    @property
    def error_bound(self) -> tuple[float, ...]:
        """Bounds on |x̃|, |x̃'|, … over all delays; empty where one has none."""
        bounds = [item.error_bound for item in self.delays]
        return tuple(max(column) for column in zip(*bounds, strict=True)) if all(bounds) else ()


def bare(configuration: Configuration) -> Configuration:
    """Return the loop that is certified: identifier and learning off, no noise, no pulse.

    Raises:
        ConfigurationError: The rules know nothing of its law, or not enough.
    """
    c, design = configuration, configuration.law.design
    if (design is None or design.epsilon <= 0.0 or design.target <= 0.0 or design.inverse
            or design.guess or c.law.schedule_place >= 0 or c.law.layer_model() is None):
        raise ConfigurationError('controller.law', c.law.name, 'has no certificate: it takes a '
                                 'boundary layer in which the law is linear and the estimates '
                                 'rest, and no inverse of the dead-zone')
    if c.make_driver().measured < c.plant.order:
        raise ConfigurationError('driver.name', c.driver_settings.name, 'has no certificate: the '
                                 'velocity is observed, a certificate takes a measured one')
    for key, value, none in (
            ('plant.static_friction', getattr(c.plant.parameters, 'static_friction', 0.0), 0.0),
            ('plant.backlash', c.plant_settings.backlash, 0.0),
            ('controller.error_band', c.controller_settings.error_band, 0.0),
            ('controller.regressors_at', c.controller_settings.regressors_at, 'measured')):
        if value != none:
            raise ConfigurationError(key, value, f'has no certificate: it takes {none}')
    changed: dict[str, Any] = {'plant.noise': [0.0], 'plant.disturbance_pulse': [0.0, 0.0, 0.0]}
    if getattr(c.law.gains, 'identifier', False):
        changed['controller.identifier'] = False
    if getattr(c.law.gains, 'learning_harmonics', 0):
        changed['controller.learning_harmonics'] = 0
    return c.replace(**changed)


def resting_estimates(c: Configuration, duration: float) -> tuple[tuple[float, float], ...]:
    """Return the interval between the initial θ̂, φ̂ and those a simulated run ends with."""
    r = c.plant.regressor_count
    run = simulate(replace(c, loop=replace(c.loop, duration=duration)))
    first = c.law.initial_memory()[:r + 1]
    names = [*(f'theta{i}' for i in range(1, r + 1)), 'phi']
    last = [float(run.column(name)[-1]) for name in names]
    return tuple((min(pair), max(pair)) for pair in zip(first, last, strict=True))


class _Reference:
    """Enclosures along the reference: x_d^(n), Y_1 …, disturbance, and their derivatives."""

    def __init__(self, c: Configuration, span: float) -> None:
        self.c = c
        self.arb = load_flint().arb
        self.ways = Ways()
        count = min(MOST_STEPS, math.ceil(span / STEP))
        self.edges = np.linspace(0.0, span, count + 1)
        self.looked_at = range(count)
        self.evaluate, self.regressors, self.disturbance = (
            with_jets(item) for item in (c.trajectory.evaluate, c.plant.regressors,
                                         c.plant.disturbance))
        self.terms = np.array([self._over(k, None) for k in range(count)])
        # A derivative that jumps has one less that is bounded.
        self.smooth = 1 if self.ways.branched else SMOOTH

    def part(self) -> _Reference:
        """Return it with `change` and `rate` of some of its intervals only: no bounds, a guess."""
        found = copy.copy(self)
        found.looked_at = self.looked_at[::PART]
        return found

    def _instant(self, k: int) -> Any:
        middle = 0.5 * (self.edges[k] + self.edges[k + 1])
        return self.arb(middle, math.nextafter(self.edges[k + 1] - middle, math.inf) * 1.000001)

    def _over(self, k: int, tube: Array | None, moving: str = 'e') -> Array:
        """Return the ends of all terms over interval k; with a tube, of their change in it.

        Moving e: in the direction of the tube; e': in that of its rate; x_d': along x_d.
        """
        c, n, r = self.c, self.c.plant.order, self.c.plant.regressor_count
        t = Jet([self._instant(k), self.arb(1)], self.ways)
        constants = c.plant.constants

        def follow() -> list[Jet]:
            x_d: list[Any] = [0.0] * (n + 1)
            self.evaluate(t, c.trajectory.constants, x_d)
            x_d = [item if isinstance(item, Jet) else Jet([self.arb(item)], self.ways)
                   for item in x_d]
            x, moment = x_d[:n], t
            if tube is not None:
                moment = Jet([t.parts[0]], self.ways)
                ways = {'e': [self.arb(0, size) for size in tube[:n]],
                        "e'": [self.arb(0, size) for size in tube[1:]],
                        "x_d'": [item.parts[0] for item in x_d[1:]]}[moving]
                x = [Jet([item.parts[0] + self.arb(0, size), way], self.ways)
                     for item, size, way in zip(x, tube[:n], ways, strict=True)]
            y: list[Any] = [0.0] * r
            self.regressors(x, constants, y)
            found = [x_d[n], *y, self.disturbance(moment, x, constants)]
            return [item if isinstance(item, Jet) else Jet([self.arb(item)], self.ways)
                    for item in found]

        return join(list(self.ways.results(follow)))

    def largest(self) -> Array:
        """Return sup |f^(j)| of each term, shape (r + 2, ORDER + 1)."""
        return np.asarray(np.abs(self.terms).max(axis=(0, 3)))

    def change(self, tube: Array) -> Array:
        """Return how much Y_1 …, disturbance differ at most from those on x_d, shape (r + 1,)."""
        found = np.array([self._over(k, tube)[1:] for k in self.looked_at])
        steep = np.abs(found[:, :, 1]).max(axis=(0, 2))
        wide = (found[:, :, 0, 1] - found[:, :, 0, 0]).max(axis=0)
        return np.asarray(np.minimum(steep, wide) * (1.0 + 1e-15))

    def rate(self, tube: Array) -> Array:
        """Return how fast these differences change at most, shape (r + 1,)."""
        own = np.array([self._over(k, tube, "e'")[1:, 1] for k in self.looked_at])
        along = np.array([self._over(k, tube, "x_d'")[1:, 1] for k in self.looked_at])
        return np.asarray((np.abs(own).max(axis=2) + along[:, :, 1] - along[:, :, 0]).max(axis=0)
                          * (1.0 + 1e-12))


def _sup(weights: Sequence[Any], ends: Array, offset: Any = None) -> Array:
    """Return sup |Σ_q w_q f_q^(j) + offset| over the reference, shape (ORDER + 1,).

    Args:
        weights: A ball for each term, shape (q,).
        ends: Ends of the terms, shape (intervals, q, ORDER + 1, 2).
        offset: Ball added to the value alone.
    """
    low, high = np.zeros((2, len(ends), ends.shape[2]))
    for q, weight in enumerate(weights):
        products = np.stack([end * ends[:, q, :, side] for end in (lower(weight), upper(weight))
                             for side in (0, 1)])
        low = np.nextafter(low + np.nextafter(products.min(axis=0), -np.inf), -np.inf)
        high = np.nextafter(high + np.nextafter(products.max(axis=0), np.inf), np.inf)
    if offset is not None:
        low[:, 0] = np.nextafter(low[:, 0] + lower(offset), -np.inf)
        high[:, 0] = np.nextafter(high[:, 0] + upper(offset), np.inf)
    return np.asarray(np.maximum(np.abs(low), np.abs(high)).max(axis=0))


@dataclass(frozen=True)
class _Cell:
    """One cell of β with what does not depend on the tube, per output."""

    spread: float
    beta: Any
    sums: LoopSums
    fixed: Array
    push: float


def _least(sums: Array, still: Array, sizes: Array, smooth: int) -> Array:
    """Return the least bound of summing by parts 0 … smooth times, per output.

    Args:
        sums: Σ of `LoopSums`.
        still: Its limits.
        sizes: D_0, D_1, ….
        smooth: Highest derivative that may be used.
    """
    best, steady = sums[0] * sizes[0], np.zeros(sums.shape[1])
    for i in range(1, min(smooth, len(sizes) - 1, SMOOTH) + 1):
        steady = steady + still[i - 1] * sizes[i - 1]
        best = np.minimum(best, steady + sums[i] * sizes[i])
    return np.asarray(best * (1.0 + 1e-14))


class _Delay:
    """The computation for one delay."""

    def __init__(self, c: Configuration, reference: _Reference, estimates: Array,
                 delay: int) -> None:
        self.c, self.reference, self.delay = c, reference, delay
        self.n, self.r = c.plant.order, c.plant.regressor_count
        self.arb = arb = load_flint().arb
        design = c.law.design
        model = c.law.layer_model()
        assert design is not None
        assert model is not None
        self.design, self.model = design, model
        self.balls = [arb(0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-15))
                      for low, high in estimates]
        n = self.n
        weights = np.asarray(error_weights(design.lambda_, n))
        self.outputs = np.zeros((n + 3, n + len(model.c)))
        self.outputs[:n, :n] = np.eye(n)
        self.outputs[n, :n] = weights
        self.outputs[n + 1] = [*model.d, *model.c]
        self.outputs[n + 2] = -self.outputs[n + 1]      # the slot: all that is not K and φ̂
        self.outputs[n + 2, :n] -= design.gain * weights
        further = np.asarray(feed_forward_weights(design.lambda_, n))
        if further[-1] > 0.0:
            self.outputs[n + 2, :n] -= further * (design.lead / further[-1])
        terms = reference.largest()
        self.rough = [i for i in range(1, self.r + 2)
                      if c.loop.period * terms[i, 1] > ROUGH * terms[i, 0]]
        self.terms = terms
        self.sent = [self.balls[-1], *self.balls[:-1], arb(0)]      # ff
        self.forward = float(_sup(self.sent, reference.terms)[0])

    def cells(self, full: bool = True) -> list[_Cell] | None:
        """Return the cells of β, if not `full` a few; None where one has no stable loop."""
        known = self.c.controller_settings
        low = known.b_bounds[0] * known.m_bounds[0]
        high = known.b_bounds[1] * known.m_bounds[1]
        count = max(1, math.ceil(math.log(high / low) / math.log(CELL)))
        edges = np.geomspace(low, high, count + 1)
        edges[0], edges[-1] = low, high
        found = []
        chosen = range(count) if full else np.unique(
            np.linspace(0, count - 1, FEW_CELLS).astype(int))
        for k in chosen:
            cell = self._cell(float(edges[k]), float(edges[k + 1]))
            if cell is None:
                return None
            found.append(cell)
        return found

    def _cell(self, low: float, high: float) -> _Cell | None:
        arb, c, smooth = self.arb, self.c, self.reference.smooth
        middle = 0.5 * (low + high)
        sums = loop_sums(self.model, c.loop.period, middle, self.delay, self.outputs)
        if sums is None:
            return None
        beta = arb(middle, 0.5 * (high - low) * (1.0 + 1e-12))
        spread = upper(abs(beta / middle - 1))
        known, rough = c.controller_settings, self.rough
        own = [arb(1), *(arb(float(a)) for a in c.plant.a), arb(1)]     # g
        sent = self.sent
        fine = [i for i in range(self.r + 2) if i not in rough]
        ends = self.reference.terms[:, fine]
        centre = -(arb(known.b_r_bounds[1]) + arb(known.b_l_bounds[0])) / 2
        half = (arb(known.b_r_bounds[1]) - arb(known.b_l_bounds[0])) / 2
        delta = _sup([sent[i] - own[i] / beta for i in fine], ends, centre)
        late = _sup([sent[i] for i in fine], ends)
        moving = _sup([own[i] / beta for i in fine], ends)
        period = c.loop.period
        fixed: Any = _least(sums.held, sums.still, delta, smooth)
        push = delta[0] + upper(half)
        if self.delay:
            sizes = self.delay * period * late[1:]
            fixed = fixed + _least(sums.held, sums.still, sizes, smooth - 1)
            push += sizes[0]
        fixed = fixed + _least(sums.ramp, sums.ramp_still, moving[1:], smooth - 1)
        push += period * moving[1]
        rest = 0.5 * period * period * moving[2] if smooth > 1 else 2.0 * period * moving[1]
        arbitrary = sum(upper(abs(sent[i])) * self.terms[i, 0] for i in rough)
        unknown = sum(upper(abs(own[i] / beta)) * self.terms[i, 0] for i in rough)
        fixed = fixed + sums.held[0] * (upper(half) + arbitrary) + sums.free * (rest + unknown)
        return _Cell(spread, beta, sums, fixed * (1.0 + 1e-13), push + rest + arbitrary + unknown)

    def within(self, cells: Sequence[_Cell], tube: Array) -> tuple[Array, Array, float]:
        """Return bounds of the outputs, of x̃, …, x̃^(n) at all times, and of |v|, in the tube."""
        c, n, period = self.c, self.n, self.c.loop.period
        change = self.reference.change(tube)
        lag = np.minimum(2.0 * change, (self.delay + 1) * period * self.reference.rate(tube))
        both = sum((upper(abs(ball)) * change[i] for i, ball in enumerate(self.balls[:-1])), 0.0)
        centre_phi = self.c.law.initial_memory()[self.r]
        lead = upper(abs(self.balls[-1] - centre_phi))
        further = feed_forward_weights(self.design.lambda_, n)
        extra = lead * sum(w * e for w, e in zip(further, tube[:n], strict=True))
        outputs, all_times, command = np.zeros(n + 3), np.zeros(n + 1), 0.0
        for cell in cells:
            sent, unknown = extra, change[-1] * upper(1 / cell.beta)
            for i, a in enumerate(c.plant.a):
                ball, slope = self.balls[i], self.arb(float(a)) / cell.beta
                apart = (upper(abs(ball)) * change[i], upper(abs(slope)) * change[i])
                close = (upper(abs(ball - slope)) * change[i], upper(abs(slope)) * lag[i])
                chosen = min(apart, close, key=sum)
                sent, unknown = sent + chosen[0], unknown + chosen[1]
            driven = (cell.fixed + cell.sums.held[0] * sent
                      + cell.sums.free * unknown) * (1.0 + cell.spread) * (1.0 + 1e-12)
            loop = cell.spread * cell.sums.held[0]
            if loop[n + 1] >= 1.0:
                return np.full(n + 3, math.inf), np.full(n + 1, math.inf), math.inf
            linear = driven[n + 1] / (1.0 - loop[n + 1])
            driven = (driven + loop * linear) * (1.0 + 1e-12)
            outputs = np.maximum(outputs, driven)
            fastest = upper(cell.beta) * (linear + cell.push + sent + unknown)
            sizes = np.zeros(n + 1)
            sizes[n] = fastest
            for i in range(n - 1, -1, -1):
                sizes[i] = driven[i] + (period ** 2 / 8.0 * sizes[i + 2] if i + 2 <= n
                                        else 0.5 * period * sizes[n])
            all_times = np.maximum(all_times, sizes * (1.0 + 1e-12))
            command = max(command, float(linear + self.forward + both + extra))
        return outputs, all_times, command


def certify(configuration: Configuration, delays: Sequence[int] = (0, 1),
            estimates: Sequence[tuple[float, float]] | None = None,
            progress: Callable[[int, int, str], None] = lambda *_: None
            ) -> Certificate:
    """Return the certificate of a configuration's loop, as `bare` makes it.

    Args:
        configuration: What is to run; plant, bounds and reference are its own.
        delays: Loop delays d [samples].
        estimates: Interval of θ̂_1 …, φ̂; None = `resting_estimates`.
        progress: Called with the number of delays done, of all, and the next one.

    Raises:
        MissingDependencyError: python-flint is not installed.
        ConfigurationError: The law has no certificate.
        NotEnclosedError: Plant or reference do something that is not enclosed here.
    """
    load_flint()
    c = bare(configuration)
    span = c.loop.duration or SPAN

    def resting(item: Configuration) -> tuple[tuple[float, float], ...]:
        return tuple(resting_estimates(item, span) if estimates is None else estimates)

    found = resting(c)
    known = c.controller_settings
    beta = (known.b_bounds[0] * known.m_bounds[0], known.b_bounds[1] * known.m_bounds[1])
    with load_flint().ctx.workprec(PRECISION):
        reference = _Reference(c, span)
        bounds: list[DelayBounds] = []
        for delay in delays:
            progress(len(bounds), len(delays), f'delay {delay}')
            item = _one_delay(c, reference, np.asarray(found), delay)
            if not item.error_bound:
                progress(len(bounds), len(delays), f'delay {delay}: which gain would do')
                item = replace(item, change=_which_gain(c, reference, resting, delay))
            bounds.append(item)
        progress(len(bounds), len(delays), '')
    return Certificate(tuple(bounds), found, beta,
                       *_words(configuration, c, found, beta, span, delays))


def _which_gain(c: Configuration, reference: _Reference,
                resting: Callable[[Configuration], Sequence[tuple[float, float]]],
                delay: int) -> str:
    """Return which gain would do at this delay, as text."""
    part, near = reference.part(), np.asarray(resting(c))

    def bounds_of(tried: Configuration, full: bool) -> DelayBounds:
        if full:
            return _one_delay(tried, reference, np.asarray(resting(tried)), delay)
        return _one_delay(tried, part, near, delay, full=False)

    return which_gain(c, delay, bounds_of)


def _one_delay(c: Configuration, reference: _Reference, estimates: Array,
               delay: int, full: bool = True) -> DelayBounds:
    """Return what was shown for one delay; not `full`: of a few cells of β, to be verified."""
    loop = _Delay(c, reference, estimates, delay)
    n, design = c.plant.order, loop.design
    cells = loop.cells(full)
    if cells is None:
        known = c.controller_settings
        high = known.b_bounds[1] * known.m_bounds[1]
        calm = largest_beta(loop.model, c.loop.period, delay)
        return DelayBounds(
            delay, False, (), (), math.inf, design.epsilon, math.inf, math.inf, math.inf,
            (f'spectral radius < 1 up to b m = {high:.4g}: it is below 1 up to {calm:.4g} only',))
    tube = np.zeros(n + 1)
    verified = False
    for _ in range(ROUNDS):
        try:
            outputs, reached, command = loop.within(cells, tube)
        except NotEnclosedError:        # so large a tube that nothing bounds what is in it
            break
        if not np.isfinite(reached).all():
            break
        if (reached <= tube).all():
            verified = True
            break
        tube = 1.02 * np.maximum(reached, tube)
    fade = max(cell.sums.fade for cell in cells) * c.loop.period
    if not verified:
        return DelayBounds(delay, False, (), (), math.inf, design.epsilon, math.inf, math.inf,
                           fade, ('a tube |x̃_i| <= E_i that the loop does not leave: every one '
                                  'leads to a larger one',))
    s_bound, slot = float(outputs[n]), float(outputs[n + 2])
    failed, change = _inequalities(c, loop, s_bound, slot, command)
    return DelayBounds(delay, not failed, tuple(map(float, reached[:n])),
                       tuple(map(float, outputs[:n])), s_bound, design.epsilon, slot, command,
                       fade, tuple(failed), change)


def _inequalities(c: Configuration, loop: _Delay, s_bound: float, slot: float,
                  command: float) -> tuple[list[str], str]:
    """Return the inequalities that fail, and what would do."""
    design, failed, change = loop.design, [], []
    behind = Units.of(c.plant).behind
    unit, v = behind('x^(n-1)'), behind('v')
    if s_bound > design.epsilon:
        failed.append(f'|s| <= {s_bound:.4g}{unit} is not within ε = {design.epsilon:.4g}{unit}')
        wider = wider_layer(c, s_bound)
        if wider:
            change.append(' with '.join(f'{key} = {value:.4g}' for key, value in wider.items())
                          + ': the same K in a layer wide enough')
    if len(loop.model.c) and slot > design.inner_reserve > 0.0:
        failed.append(f'the slot <= {slot:.4g}{v} is not within its authority rho_1 = '
                      f'{design.inner_reserve:.4g}{v}')
        change.append(f'controller.rho_1 = {WIDER * slot:.4g}')
    limits = [item for item in (c.plant_settings.command_limit,
                                getattr(c.law.gains, 'v_max', 0.0)) if item > 0.0]
    if limits and command > min(limits):
        failed.append(f'|v| <= {command:.4g}{v} is not within the limit '
                      f'{min(limits):.4g}{v}')
        change.append('a slower reference, or a stronger actuator')
    return failed, '; '.join(change)


def _words(given: Configuration, c: Configuration, estimates: Sequence[tuple[float, float]],
           beta: tuple[float, float], span: float,
           delays: Sequence[int]) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Return what is assumed, proven and not proven."""
    known, zone = c.controller_settings, c.dead_zone
    names = [*(f'θ̂{i}' for i in range(1, c.plant.regressor_count + 1)), 'φ̂']
    resting = ', '.join(f'{name} in [{low:.6g}, {high:.6g}]' for name, (low, high)
                        in zip(names, estimates, strict=True))
    assumed = [
        'the loop is in its boundary layer, and the effect of its initial state has '
        'faded',
        f'the estimates rest, {resting}',
        f'the plant is {c.plant.name} with the parameters of the configuration, b m constant '
        f'anywhere in [{beta[0]:.6g}, {beta[1]:.6g}], the same slope on both sides (A2)',
        f'b_r <= {known.b_r_bounds[1]:g}, b_l >= {known.b_l_bounds[0]:g}, else arbitrary, also '
        'from sample to sample',
        f'x_d … x_d^(n) are continuous (A8), and after {span:g} s the reference does nothing '
        'that it has not done before',
        'samples are exactly T apart, the delay is constant, every state is measured without '
        'noise, the law computes without rounding',
    ]
    switched = [name for name in ('identifier', 'learning_harmonics')
                if getattr(given.law.gains, name, False)]
    if switched:
        assumed.append(f'{" and ".join(switched)} switched off, which the configuration has on')
    least, largest = zone.slopes(c.loop.schedule)
    if least != largest:
        assumed.append("that slopes do not differ or drift, which the plant's section contradicts")
    if isinstance(c.plant, CoupledPlant):
        assumed.append('the other axes of the plant rest: what they do to this one is not covered')
    proven = ['with outward rounding: at every sample |s| stays within the bound, so the loop '
              'never leaves its layer if that is within ε; |x̃_i| stays within its bound, between '
              f'the samples too, for a delay of {", ".join(map(str, delays))} samples']
    not_proven = ['how the loop gets into its layer, and how long that takes',
                  'anything with noise, quantisation, jitter or lost samples',
                  'anything while the guard, the identifier or the learning acts']
    return tuple(assumed), tuple(proven), tuple(not_proven)
