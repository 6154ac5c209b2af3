# SPDX-License-Identifier: Apache-2.0
"""Plant and dead-zone by prediction error over stretches of samples (ours).

From an initial state of its own each stretch is predicted by the plant's model, driven by the
commands that were held; parameters and initial states are chosen by least squares (scipy, trust
region) so that the predicted states are near the measured ones,

    min Σ_g Σ_k |W (x_g,k − x̂_g,k(p, x̂_g,0))|²,      p = (a_1 … a_r, b_r, b_l, b m_r, b m_l)

W weights each measured state by the size of its residual. **b and m show only as their product**:
b is kept as configured and m = (b m)/b. The model's other constants are kept as configured.

Confidence: the residuals of one stretch may depend on each other (a disturbance that is not
modelled), those of different stretches are taken as independent. With J̃_g the sensitivities after
the initial states are projected out and e_g the residuals, G stretches, P parameters,

    cov p = G/(G − P) H⁻¹ (Σ_g J̃_gᵀ e_g e_gᵀ J̃_g) H⁻¹,   H = Σ_g J̃_gᵀ J̃_g

and an interval is ± t_{0.975, G−P} standard errors. It holds if the model is right and does
not show whether it is.

Over 300 lines: model, search and confidence share the sensitivities.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.integration import make_advance
from dz_ros.errors import LoopError, RecordingError
from dz_ros.identification.estimation.least_squares import COUNT, ZONE
from dz_ros.identification.estimation.stretches import Stretch
from dz_ros.identification.samples import Piece, Samples

Array = NDArray[np.float64]

STEPS = 2
"""RK4 steps in a sample interval."""
MAX_STRETCHES = 150
"""Of more, this number is chosen evenly."""
BLIND = 1e-7
"""A parameter that moves the prediction by less than this share of the strongest is not seen."""
PASSED = 5
"""Commands that must lie beyond a break point for it to be seen."""
SLOPE = 10
"""Samples from which the initial derivative of a state is taken."""


@dataclass(frozen=True)
class Parameters:
    """Where a search begins.

    Attributes:
        a: a_i, shape (r,).
        zone: `ZONE`, shape (4,).
        disturbance: Factor of the modelled disturbance.
    """

    a: Array
    zone: Array
    disturbance: float


@dataclass(frozen=True)
class Estimate:
    """One parameter.

    Attributes:
        name: ``a1`` … or one of `ZONE`.
        value: Estimate, or the value kept.
        half_width: Half-width of the 95 % confidence interval; infinite where the data do not
            show the parameter and its value was kept.
    """

    name: str
    value: float
    half_width: float

    @property
    def seen(self) -> bool:
        """Whether the data show it."""
        return math.isfinite(self.half_width)


@dataclass(frozen=True)
class Fit:
    """A plant estimated from samples.

    Attributes:
        model: Name of the plant's model.
        estimates: a_1 … a_r, then `ZONE`.
        b: The input gain that was kept.
        residual: RMS of x − x̂ of each measured state, units of x, x', ….
        samples: States used.
        stretches: Stretches they were cut into.
    """

    model: str
    estimates: tuple[Estimate, ...]
    b: float
    residual: tuple[float, ...]
    samples: int
    stretches: int

    def __getitem__(self, name: str) -> Estimate:
        """Return an estimate by name.

        Raises:
            KeyError: No such parameter.
        """
        return {item.name: item for item in self.estimates}[name]

    @property
    def a(self) -> tuple[float, ...]:
        """Estimated a_i, shape (r,)."""
        return tuple(item.value for item in self.estimates[:-COUNT])


class Prediction:
    """Stretches predicted for given parameters and initial states.

    Args:
        samples: Experiment or run.
        stretches: Which of them.
        c: Model and known constants.
        delay: Samples after which a command acts.
        disturbance: Factor of the modelled disturbance.
        drift: What `ZONE` differs in each stretch from its constants, shape (G, 4).

    Attributes:
        measured: Measured states of each stretch, shape (L + 1, measured).
        starts: Initial states to begin with, shape (G, n).
    """

    def __init__(self, samples: Samples, stretches: Sequence[Stretch], c: Configuration,
                 delay: int, disturbance: float, drift: Array) -> None:
        count, period = samples.measured, samples.period
        rows = [range(item.rows[0], item.rows[1] + 1) for item in stretches]
        self.measured = [samples.x[item.start:item.stop, :count] for item in rows]
        self.pieces = [[[(begin + delay * period, span, held) for begin, span, held in
                         samples.held(row - delay)] for row in item[:-1]] for item in rows]
        self.starts = np.zeros((len(rows), c.plant.order))
        for start, x in zip(self.starts, self.measured, strict=True):
            start[:count] = x[0]
            if count < c.plant.order:
                head = x[:SLOPE, -1]
                start[-1] = np.polyfit(np.arange(len(head)) * period, head, 1)[0]
        own = c.plant.disturbance
        self._advance = make_advance(
            c.plant.regressors, own if disturbance == 1.0 else
            lambda t, x, p: disturbance * own(t, x, p), sticking=c.plant.sticking)
        self._drift = drift.tolist()
        self._order, self._b, self._period = c.plant.order, c.plant.b, period
        self._count, self._rest = c.plant.regressor_count, c.plant.extra

    def __call__(self, p: Sequence[float], starts: Array) -> list[Array]:
        """Return the predicted states of each stretch, shape (L + 1, measured).

        Args:
            p: a_1 … a_r, then `ZONE`.
            starts: Initial states, shape (G, n).
        """
        r = self._count
        plant = (self._b, *p[:r], *self._rest)
        zones = ((0.0, (p[r + 2] + right) / self._b, (p[r + 3] + left) / self._b, p[r] + b_r,
                  p[r + 1] + b_l, *(0.0,) * 8) for b_r, b_l, right, left in self._drift)
        work = ([0.0] * r, *([0.0] * self._order for _ in range(4)))
        return [self._predict(pieces, start, plant, zone, work)[:, :x.shape[1]] for
                pieces, start, x, zone in zip(self.pieces, starts.tolist(), self.measured, zones,
                                              strict=True)]

    def _predict(self, samples: Sequence[Sequence[Piece]], x: list[float], plant: Sequence[float],
                 zone: Sequence[float], work: tuple[list[float], ...]) -> Array:
        path = [tuple(x)]
        try:
            for pieces in samples:
                for begin, span, held in pieces:
                    steps = max(1, round(STEPS * span / self._period))
                    self._advance(x, held, begin, span / steps, steps, plant, zone, *work)
                path.append(tuple(x))
        except (OverflowError, ValueError):
            path += [(1e9,) * self._order] * (len(samples) + 1 - len(path))
        found: Array = np.clip(np.nan_to_num(np.array(path), nan=1e9), -1e9, 1e9)
        return found

    def residual(self, p: Sequence[float], starts: Array, weight: Array) -> list[Array]:
        """Return weighted measured minus predicted states of each stretch, flat."""
        return [((x - found) * weight).ravel()
                for x, found in zip(self.measured, self(p, starts), strict=True)]

    def sensitivity(self, p: Array, starts: Array,
                    weight: Array) -> tuple[list[Array], list[Array]]:
        """Return d residual / d p and d residual / d start of each stretch, by differences."""
        def columns(points: Array, change: Callable[[Array], tuple[Array, Array]],
                    ) -> list[Array]:
            found = []
            for j, size in enumerate(np.abs(points).reshape(-1, points.shape[-1]).max(axis=0)):
                step = np.zeros(points.shape[-1])
                step[j] = 1e-5 * max(size, 0.1)
                ends = [self.residual(q.tolist(), begun, weight)
                        for q, begun in (change(step), change(-step))]
                found.append([(up - down) / (2.0 * step[j]) for up, down in zip(*ends,
                                                                                strict=True)])
            return [np.column_stack(item) for item in zip(*found, strict=True)]

        return (columns(p, lambda step: (p + step, starts)),
                columns(starts, lambda step: (p, starts + step)))


def fit(samples: Samples, stretches: Sequence[Stretch], c: Configuration,
        starts: Sequence[Parameters], delay: int = 0, without_zone: bool = False,
        drift: Array | None = None) -> Fit:
    """Return plant and dead-zone estimated from stretches.

    Args:
        samples: Experiment or run.
        stretches: Which of them.
        c: Model, known constants, b.
        starts: Where the search may begin; the one that predicts best is taken.
        delay: Samples after which a command acts.
        without_zone: Keep the break points of the one start.
        drift: What `ZONE` differs in each stretch from its constants, kept, shape (G, 4); None =
            it does not.

    Raises:
        RecordingError: Too little data.
        LoopError: The search found nothing.
    """
    drift = np.zeros((len(stretches), COUNT)) if drift is None else drift
    if len(stretches) > MAX_STRETCHES:
        chosen = np.linspace(0, len(stretches) - 1, MAX_STRETCHES).round().astype(int)
        stretches, drift = [stretches[i] for i in chosen], drift[chosen]
    p = np.concatenate([starts[-1].a, starts[-1].zone])
    free = np.ones(len(p), dtype=bool)
    free[-COUNT:-COUNT + 2] = not without_zone
    if len(stretches) < len(p) + 2:
        raise RecordingError(f'a plant cannot be identified: {len(p)} parameters need at least '
                             f'{len(p) + 2} stretches without a hole, there are {len(stretches)}')
    predict = Prediction(samples, stretches, c, delay, starts[-1].disturbance, drift)
    everything = np.concatenate(predict.measured)
    scale = np.maximum(everything.std(axis=0), 1e-9)
    weight, begun = 1.0 / scale, predict.starts
    if len(starts) > 1:
        p = min((np.concatenate([item.a, item.zone]) for item in starts), key=lambda q: sum(
            float(np.minimum(item * item, 1.0).sum())
            for item in predict.residual(q.tolist(), begun, weight)))
    for _ in range(2):
        p, begun = _search(predict, p, free, begun, weight)
        rest = np.concatenate([item.reshape(-1, len(scale)) for item in predict.residual(
            p.tolist(), begun, np.ones(len(scale)))])
        rms = np.sqrt(np.mean(rest * rest, axis=0))
        weight = 1.0 / np.maximum(rms, 1e-9 * scale)
    half = _half_widths(predict, p, free, begun, weight)
    beyond = _passed(predict, p)
    half[-COUNT:] = np.where(beyond + beyond, half[-COUNT:], np.inf)
    p = _kept(p, half, free, c)
    names = (*(f'a{i + 1}' for i in range(len(p) - COUNT)), *ZONE)
    return Fit(c.plant.name, tuple(Estimate(name, float(value), float(width)) for
                                   name, value, width in zip(names, p, half, strict=True)),
               c.plant.b, tuple(rms.tolist()), len(everything), len(stretches))


def _passed(predict: Prediction, p: Array) -> list[bool]:
    """Return whether commands went beyond b_r, and beyond b_l: else the side is not seen.

    The search leaves a break point that no command reaches at the outermost command.
    """
    held = np.array([piece[2] for item in predict.pieces for pieces in item for piece in pieces])
    b_r, b_l = p[-COUNT], p[-COUNT + 1]
    margin = 1e-3 * max(b_r - b_l, 1e-3)
    return [bool(np.count_nonzero(held > b_r + margin) >= PASSED),
            bool(np.count_nonzero(held < b_l - margin) >= PASSED)]


def _kept(p: Array, half: Array, free: NDArray[np.bool_], c: Configuration) -> Array:
    """Return the estimates, with what is not seen as configured, but never against the data."""
    zone = c.dead_zone
    configured = np.array([*c.plant.a, zone.b_r, zone.b_l, c.plant.b * zone.m_r,
                           c.plant.b * zone.m_l])
    found = np.where(np.isfinite(half) | ~free, p, configured)
    for place, outer in ((-COUNT, max), (-COUNT + 1, min)):
        if free[place] and not np.isfinite(half[place]):
            found[place] = outer(found[place], p[place])
    return found


def _search(predict: Prediction, p: Array, free: NDArray[np.bool_], starts: Array,
            weight: Array) -> tuple[Array, Array]:
    """Return the parameters and initial states of least squares.

    Raises:
        LoopError: The prediction never came near the measurement.
    """
    from scipy.optimize import least_squares
    from scipy.sparse import block_diag, csr_matrix, hstack

    count, shape = int(free.sum()), starts.shape

    def parts(q: Array) -> tuple[Array, Array]:
        whole = p.copy()
        whole[free] = q[:count]
        return whole, q[count:].reshape(shape)

    def residual(q: Array) -> Array:
        whole, begun = parts(q)
        return np.concatenate(predict.residual(whole.tolist(), begun, weight))

    def jacobian(q: Array) -> object:
        by_p, by_start = predict.sensitivity(*parts(q), weight)
        starts_only = block_diag([csr_matrix(item) for item in by_start])
        return hstack([csr_matrix(np.concatenate(by_p)[:, free]), starts_only]).tocsr()

    low, high = np.full(len(p), -np.inf), np.full(len(p), np.inf)
    low[-COUNT:] = 0.0, -np.inf, 1e-6, 1e-6
    high[-COUNT + 1] = 0.0
    begin = np.clip(p, low, high)[free]
    endless = np.full(starts.size, np.inf)
    found = least_squares(residual, np.concatenate([begin, starts.ravel()]), jacobian,
                          bounds=(np.concatenate([low[free], -endless]),
                                  np.concatenate([high[free], endless])),
                          x_scale='jac', method='trf', max_nfev=40, tr_solver='lsmr',
                          tr_options={'maxiter': 400, 'atol': 1e-13, 'btol': 1e-13})
    if not np.isfinite(found.x).all() or found.cost > 1e12:
        raise LoopError('a plant cannot be identified: no parameters of this model come near '
                        'what was measured')
    return parts(found.x)


def _half_widths(predict: Prediction, p: Array, free: NDArray[np.bool_], starts: Array,
                 weight: Array) -> Array:
    """Return half-widths of the 95 % confidence intervals; infinite = not seen, shape (P,)."""
    from scipy.stats import t

    by_p, by_start = predict.sensitivity(p, starts, weight)
    rest = predict.residual(p.tolist(), starts, weight)
    own = []
    for columns, begun in zip(by_p, by_start, strict=True):
        basis, _ = np.linalg.qr(begun)
        own.append(columns - basis @ (basis.T @ columns))
    norm = np.maximum(np.abs(p), 0.1) * np.sqrt(sum(np.sum(item * item, axis=0) for item in own))
    half = np.full(len(p), np.inf)
    seen = np.flatnonzero((norm > BLIND * norm.max()) & free)
    stacked = sum(item[:, seen].T @ item[:, seen] for item in own)
    pushes = np.array([item[:, seen].T @ e for item, e in zip(own, rest, strict=True)])
    inverse = np.linalg.pinv(stacked, hermitian=True)
    degrees = len(own) - len(seen)
    covariance = inverse @ (pushes.T @ pushes) @ inverse * len(own) / degrees
    half[seen] = t.ppf(0.975, degrees) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return half
