"""Estimating a plant and its dead-zone from a log (ours): prediction error over segments.

A run is cut into segments of about a second. From an initial state of its own each is predicted by
the plant's model, driven by the commands that were held; parameters and initial states are chosen
by least squares (scipy, trust region) so that the predicted states are near the measured ones,

    min Σ_g Σ_k |W (x_g,k − x̂_g,k(p, x̂_g,0))|²,      p = (a_1 … a_r, b m, b_r, b_l)

W weights each state by the size of its residual. The dead-zone has one slope m. **b and m show
only as their product**: b is kept as configured and m = (b m)/b. The model's other constants, its
disturbance among them, are kept as configured.

Confidence: the residuals of one segment may depend on each other (a disturbance nobody modelled),
those of different segments are taken as independent. With J̃_g the sensitivities after the initial
states are projected out and e_g the residuals, G segments, P parameters,

    cov p = G/(G − P) H⁻¹ (Σ_g J̃_gᵀ e_g e_gᵀ J̃_g) H⁻¹,   H = Σ_g J̃_gᵀ J̃_g

and an interval is ± t_{0.975, G−P} standard errors. It says how well the model's parameters are
known if the model is right, not whether it is right.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.fit_prediction import Prediction
from dz_ros.analysis.fit_start import configured_parameters, first_guess
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.errors import LoopError, RecordingError

Array = NDArray[np.float64]

BLIND = 1e-7
"""A parameter that moves the prediction by less than this share of the strongest is not seen."""

PASSED = 5
"""Commands that must lie beyond a break point for it to be seen."""


@dataclass(frozen=True)
class Estimate:
    """One parameter.

    Attributes:
        name: ``a1`` …, ``b·m``, ``b_r``, ``b_l``.
        value: Estimate, or the value kept.
        half_width: Half-width of the 95 % confidence interval; infinite where the log does not
            show the parameter and its value was kept.
    """

    name: str
    value: float
    half_width: float

    @property
    def seen(self) -> bool:
        """Whether the log shows it."""
        return math.isfinite(self.half_width)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval."""
        return self.value - self.half_width, self.value + self.half_width


@dataclass(frozen=True)
class Fit:
    """A plant estimated from a log.

    Attributes:
        model: Name of the plant's model.
        estimates: a_1 … a_r, b·m, b_r, b_l.
        b: The input gain that was kept.
        residual: RMS of x − x̂ of each state, units of x, x', …, shape (n,).
        samples: States used.
        segments: Segments they were cut into.
    """

    model: str
    estimates: tuple[Estimate, ...]
    b: float
    residual: tuple[float, ...]
    samples: int
    segments: int

    def __getitem__(self, name: str) -> Estimate:
        """Return an estimate by name.

        Raises:
            KeyError: No such parameter.
        """
        for item in self.estimates:
            if item.name == name:
                return item
        raise KeyError(name)

    @property
    def a(self) -> tuple[float, ...]:
        """Estimated a_i, shape (r,)."""
        return tuple(item.value for item in self.estimates[:-3])

    @property
    def m(self) -> float:
        """Slope of the dead-zone that goes with `b`."""
        return self['b·m'].value / self.b


def fit_plant(run: RunData, configuration: Configuration) -> Fit:
    """Return plant and dead-zone estimated from a run.

    Args:
        run: The run; its states and commands are used.
        configuration: Model, known constants, b, delay, command limit, rate.

    Raises:
        RecordingError: Too little data.
        LoopError: The search found nothing.
    """
    c = configuration
    predict = Prediction(run, c)
    p = first_guess(predict.segments, c)
    if len(predict.segments) < len(p) + 2:
        raise RecordingError(f'a plant cannot be fitted: {len(p)} parameters need at least '
                             f'{len(p) + 2} segments of {c.loop.period * 8:g} s, the run has '
                             f'{len(predict.segments)}')
    starts = np.array([item[0] for item in predict.measured])
    everything = np.concatenate(predict.measured)
    scale = np.maximum(everything.std(axis=0), 1e-9)
    weight = 1.0 / scale
    for _ in range(2):
        p, starts = _search(predict, p, starts, weight)
        rest = np.concatenate([item.reshape(-1, predict.order) for item in predict.residual(
            p.tolist(), starts, np.ones(predict.order))])
        rms = np.sqrt(np.mean(rest * rest, axis=0))
        weight = 1.0 / np.maximum(rms, 1e-9 * scale)
    half = _half_widths(predict, p, starts, weight)
    half[[len(p) - 2, len(p) - 1]] = np.where(_passed(predict, p), half[-2:], np.inf)
    p = _kept(p, half, configured_parameters(c))
    names = (*(f'a{i + 1}' for i in range(len(p) - 3)), 'b·m', 'b_r', 'b_l')
    return Fit(c.plant.name, tuple(Estimate(name, float(value), float(width)) for
                                   name, value, width in zip(names, p, half, strict=True)),
               c.plant.b, tuple(rms.tolist()), len(everything), len(predict.segments))


def _passed(predict: Prediction, p: Array) -> list[bool]:
    """Return whether commands went beyond b_r, and beyond b_l: else nothing shows where they lie.

    The search leaves a break point that no command reaches at the outermost command.
    """
    held = np.array([piece[2] for item in predict.segments for pieces in item.pieces
                     for piece in pieces])
    margin = 1e-3 * max(p[-2] - p[-1], 1e-3)
    return [bool(np.count_nonzero(held > p[-2] + margin) >= PASSED),
            bool(np.count_nonzero(held < p[-1] - margin) >= PASSED)]


def _kept(p: Array, half: Array, configured: Array) -> Array:
    """Return the estimates, with what is not seen as configured, but never against the log."""
    found = np.where(np.isfinite(half), p, configured)
    if not np.isfinite(half[-2]):
        found[-2] = max(found[-2], p[-2])
    if not np.isfinite(half[-1]):
        found[-1] = min(found[-1], p[-1])
    return found


def _search(predict: Prediction, p: Array, starts: Array,
            weight: Array) -> tuple[Array, Array]:
    """Return the parameters and initial states of least squares.

    Raises:
        LoopError: The prediction never came near the measurement.
    """
    from scipy.optimize import least_squares
    from scipy.sparse import block_diag, csr_matrix, hstack

    count, shape = len(p), starts.shape

    def residual(q: Array) -> Array:
        return np.concatenate(predict.residual(q[:count].tolist(), q[count:].reshape(shape),
                                               weight))

    def jacobian(q: Array) -> object:
        by_p, by_start = predict.sensitivity(q[:count], q[count:].reshape(shape), weight)
        starts_only = block_diag([csr_matrix(item) for item in by_start])
        return hstack([csr_matrix(np.concatenate(by_p)), starts_only]).tocsr()

    low, high = np.full(len(p) + starts.size, -np.inf), np.full(len(p) + starts.size, np.inf)
    low[count - 3], low[count - 2], high[count - 1] = 1e-6, 0.0, 0.0
    found = least_squares(residual, np.concatenate([p, starts.ravel()]), jacobian,
                          bounds=(low, high), x_scale='jac', method='trf', max_nfev=40,
                          tr_solver='lsmr', tr_options={'maxiter': 400, 'atol': 1e-13,
                                                        'btol': 1e-13})
    if not np.isfinite(found.x).all() or found.cost > 1e12:
        raise LoopError('a plant cannot be fitted: no parameters of this model come near what '
                        'was measured')
    return found.x[:count], found.x[count:].reshape(shape)


def _half_widths(predict: Prediction, p: Array, starts: Array, weight: Array) -> Array:
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
    seen = np.flatnonzero(norm > BLIND * norm.max())
    stacked = sum(item[:, seen].T @ item[:, seen] for item in own)
    pushes = np.array([item[:, seen].T @ e for item, e in zip(own, rest, strict=True)])
    inverse = np.linalg.pinv(stacked, hermitian=True)
    free = len(own) - len(seen)
    covariance = inverse @ (pushes.T @ pushes) @ inverse * len(own) / free
    half[seen] = t.ppf(0.975, free) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return half
