# SPDX-License-Identifier: Apache-2.0
"""The loop inside the boundary layer as one matrix, and the margins that follow from it (ours).

Where |s| ≤ ε the estimates rest and every law of this family is a linear step in the error:

    z_{k+1} = A z_k + B x̃_k        v_k = C z_k + D x̃_k          z: the law's memory in the layer

With the plant as a chain of n integrators driven by β = b m times the held command (exact over a
sample), d samples of delay and, where the velocity is not measured, its observer
(`dz_ros.core.observers`) the sampled loop is one matrix. The loop is calm if its spectral radius
is below 1. Regressors, disturbance and dead-zone are inputs to it. The rule of
`dz_ros.core.design.boundary_layer` is its approximation (mathematics.md §12).

Arguments named alike are the same everywhere: order n; lambda_ λ [1/s]; gain K, lead φ̂ Λ_v,n
[actuator unit per unit of s]; period T [s]; beta β = b m [unit of x^(n) per actuator unit];
delay d [samples]; observer: that of the velocity, None = all states are measured.

Over 300 lines: margins and noise are two questions to the same matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.tracking import error_weights, feed_forward_weights

Array = NDArray[np.float64]

POINTS, STEPS = 64, 34
"""Values tried to bracket a margin, and bisections of that bracket, to 1e-11 of the margin."""
GRID = np.geomspace(1e-3, 2.0, POINTS)
"""These values, as multiples of the slope's unit."""
TOGETHER = 8
"""Values of the grid tried in one call; divides `POINTS`."""
ROUNDS = 5
"""Guesses at a margin before bisection itself has to find it."""
NEGLIGIBLE = 1e-9
"""Entry of a power of the loop's matrix that adds nothing to a covariance."""


@dataclass(frozen=True)
class LayerModel:
    """A law inside its boundary layer: a linear step from the error to the command.

    Attributes:
        places: Places in the law's memory of the entries that move in the layer, shape (p,).
        a: Their step from sample to sample, shape (p, p).
        b: What the error adds to them, shape (p, n).
        c: Their share in v, shape (p,).
        d: Share of the error in v [actuator unit per unit of x^(i)], shape (n,).
    """

    places: tuple[int, ...]
    a: Array
    b: Array
    c: Array
    d: Array


@dataclass(frozen=True)
class LinearObserver:
    """An observer of the tracking error, o_k = F o_(k−1) + g e_k, the velocity in o[1].

    Attributes:
        step: F, shape (p, p).
        gain: g, shape (p,).
    """

    step: Array
    gain: Array


def surface_model(order: int, lambda_: float, gain: float, lead: float) -> LayerModel:
    """Return the model of a law without memory in the layer, v = −(K Λ + φ̂ Λ_v)ᵀ x̃."""
    weights = np.asarray(error_weights(lambda_, order))
    further = np.asarray(feed_forward_weights(lambda_, order))
    if further[-1] > 0.0:
        further = further * (lead / further[-1])
    return LayerModel((), np.zeros((0, 0)), np.zeros((0, order)), np.zeros(0),
                      -gain * weights - further)


def integral_model(order: int, lambda_: float, gain: float, lead: float, place: int,
                   step: float) -> LayerModel:
    """Return the model with v −= v_I, v_I ← v_I + step s after v, v_I at `place` in the memory."""
    bare = surface_model(order, lambda_, gain, lead)
    weights = np.asarray(error_weights(lambda_, order))
    return LayerModel((place,), np.eye(1), step * weights[None, :], -np.ones(1), bare.d)


def _parts(model: LayerModel, period: float, delay: int,
           observer: LinearObserver | None) -> tuple[Array, Array, Array, Array]:
    """Return the loop's matrix at β = 0, T^i and i! by which β acts on each state, and v's row."""
    n, p = model.b.shape[1], len(model.c)
    seen = 0 if observer is None else len(observer.gain)
    law, held = n + seen, n + seen + p
    size = held + delay
    matrix = np.zeros((size, size))
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = period ** (j - i) / math.factorial(j - i)
    measured = np.eye(n, size)
    if observer is not None:
        matrix[n:law, n:law] = observer.step
        matrix[n:law, n - 2] = observer.gain
        measured[n - 1] = matrix[n + 1]
    command = model.d @ measured
    command[law:held] += model.c
    matrix[law:held] = model.b @ measured
    matrix[law:held, law:held] += model.a
    if delay:
        matrix[held] = command
        for i in range(1, delay):
            matrix[held + i, held + i - 1] = 1.0
    return (matrix, np.array([period ** (n - i) for i in range(n)]),
            np.array([float(math.factorial(n - i)) for i in range(n)]), command)


def _matrices(parts: tuple[Array, Array, Array, Array], betas: Array, delay: int) -> Array:
    """Return the loop's matrices at some β, shape (m,) → (m, size, size)."""
    matrix, powers, factorials, command = parts
    n, size = len(powers), len(matrix)
    push = betas[:, None] * powers / factorials
    matrices = np.empty((len(betas), size, size))
    matrices[:] = matrix
    if delay:
        matrices[:, :n, -1] += push
    else:
        matrices[:, :n] += push[:, :, None] * command
    return matrices


def loop_matrix(model: LayerModel, period: float, beta: float, delay: int,
                observer: LinearObserver | None = None) -> Array:
    """Return the matrix of the closed loop inside the layer, from sample to sample."""
    parts = _parts(model, period, delay, observer)
    return np.asarray(_matrices(parts, np.array([beta]), delay)[0])


@dataclass(frozen=True)
class _Noise:
    """The loop driven by white noise ν on what is measured, ζ_{k+1} = A ζ_k + N ν_k.

    Attributes:
        matrix, spread: A and N.
        covariance: Of the stationary ζ, P = A P Aᵀ + N Σ Nᵀ.
        command, through: v_k = command ζ_k + through ν_k.
        measured, direct: The error as the law has it, measured ζ_k + direct ν_k.
    """

    matrix: Array
    spread: Array
    covariance: Array
    command: Array
    through: Array
    measured: Array
    direct: Array


def _noise(model: LayerModel, period: float, beta: float, delay: int, sigma: Array,
           observer: LinearObserver | None) -> _Noise | None:
    """Return the loop under noise of standard deviation sigma; None = it is not calm."""
    with np.errstate(over='ignore', invalid='ignore'):
        parts = _parts(model, period, delay, observer)
        matrix = _matrices(parts, np.array([beta]), delay)[0]
    if not np.isfinite(matrix).all() or not np.abs(np.linalg.eigvals(matrix)).max() < 1.0:
        return None
    _, powers, factorials, command = parts
    n, p = model.b.shape[1], len(model.c)
    seen = 0 if observer is None else len(observer.gain)
    measured, direct = np.eye(n, len(matrix)), np.eye(n)
    spread = np.zeros((len(matrix), n))
    if observer is not None:
        spread[n:n + seen, n - 2] = observer.gain
        measured[n - 1], direct[n - 1] = parts[0][n + 1], spread[n + 1]
    through = model.d @ direct
    spread[n + seen:n + seen + p] = model.b @ direct
    if delay:
        spread[n + seen + p] = through
    else:
        spread[:n] = np.outer(beta * powers / factorials, through)
    power, root = matrix, spread * sigma
    covariance = root @ root.T
    with np.errstate(over='ignore', invalid='ignore'):
        while np.abs(power).max() > NEGLIGIBLE:     # P of 2^i terms from P of half as many
            covariance = covariance + power @ covariance @ power.T
            power = power @ power
    if not np.isfinite(covariance).all():       # at radius 1 but for rounding
        return None
    return _Noise(matrix, spread, covariance, command, through, measured, direct)


def noise_variation(model: LayerModel, period: float, beta: float, delay: int,
                    sigma: Sequence[float]) -> float:
    """Return the total variation per second that white noise on the states gives v in the loop.

    Of the stationary state ζ_{k+1} = A ζ_k + N ν_k, v_k = C ζ_k + D ν_k with covariance
    P = A P Aᵀ + N Σ Nᵀ: E|v_{k+1} − v_k| = √(2/π) σ_Δ of a normal ν, with
    σ_Δ² = ‖C (A − I)‖²_P + ‖C N − D‖²_Σ + ‖D‖²_Σ.

    All states are measured, each with noise of its own of standard deviation sigma [state units],
    shape (n,). inf where the loop is not calm, for no noise bounds it then [actuator unit / s].
    """
    scale = np.asarray(sigma, dtype=float)
    found = _noise(model, period, beta, delay, scale, None)
    if found is None:
        return math.inf
    row = found.command @ found.matrix - found.command
    square = (row @ found.covariance @ row
              + np.square((found.command @ found.spread - found.through) * scale).sum()
              + np.square(found.through * scale).sum())
    return math.sqrt(2.0 / math.pi * float(square)) / period


def noise_of_surface(model: LayerModel, lambda_: float, period: float, beta: float, delay: int,
                     sigma: Sequence[float], observer: LinearObserver | None = None) -> float:
    """Return the standard deviation that white noise on the states gives s in the loop.

    Of the s that the law computes, s_k = Λ (M ζ_k + E ν_k): σ² = ‖Λ M‖²_P + ‖Λ E‖²_Σ. Near its
    limit the loop amplifies the noise to a multiple of what the sensors alone give s.

    sigma is that of each state as it is measured [state units], shape (n,); with an observer that
    of the last one is not used. inf where the loop is not calm [unit of x^(n−1)].
    """
    scale = np.array(sigma, dtype=float)
    if observer is not None:
        scale[-1] = 0.0
    found = _noise(model, period, beta, delay, scale, observer)
    if found is None:
        return math.inf
    weights = np.array(error_weights(lambda_, len(scale)))
    row = weights @ found.measured
    return math.sqrt(float(row @ found.covariance @ row
                           + np.square(weights @ found.direct * scale).sum()))


def _radii(parts: tuple[Array, Array, Array, Array], delay: int) -> Callable[[Array], Array]:
    """Return the function that gives the spectral radii at some β, shape (m,) → (m,)."""
    def radii(betas: Array) -> Array:
        with np.errstate(over='ignore', invalid='ignore'):
            matrices = _matrices(parts, betas, delay)
        try:
            return np.asarray(np.abs(np.linalg.eigvals(matrices)).max(axis=1))
        except np.linalg.LinAlgError:       # not finite: gains near the largest number
            whole = np.isfinite(matrices).all(axis=(1, 2))
            if whole.all():
                raise
        found = np.full(len(betas), math.inf)
        if whole.any():
            found[whole] = np.abs(np.linalg.eigvals(matrices[whole])).max(axis=1)
        return found

    return radii


def spectral_radius(model: LayerModel, period: float, beta: float, delay: int,
                    observer: LinearObserver | None = None) -> float:
    """Return the spectral radius of `loop_matrix`; below 1 the loop is calm, inf = no number."""
    with np.errstate(over='ignore', invalid='ignore'):
        parts = _parts(model, period, delay, observer)
    return float(_radii(parts, delay)(np.array([beta]))[0])


def _largest(radii: Callable[[Array], Array], unit: float, limit: float = math.inf) -> float:
    """Return the largest value within `GRID` up to which the loop is calm; 0 = for none.

    A loop that is not calm at low values is judged by its upper limit: a grid is tried from its
    upper end on, then the bracket found is halved `STEPS` times. What those bisections end at is
    guessed by interpolation and then tried, for a call takes as long as many values in it.

    Args:
        radii: Spectral radii at some values, shape (m,) → (m,).
        unit: Half the upper end of the grid.
        limit: No larger value is calm; most often the margin, so it is tried first.
    """
    grid = GRID * unit
    place = int(grid.searchsorted(limit))
    if 0 < place < POINTS:
        below, above = float(grid[place - 1]), float(grid[place])
        ends = _around(*_halved(below, above, limit.__gt__))
        lowest, *calm = radii(np.array([below, *ends])).tolist()
        end = _last_calm(ends, calm)
        if lowest < 1.0 and end is not None:
            return _halved(below, above, end.__ge__)[0]
    found: list[float] = []
    for begin in range(POINTS - TOGETHER, -1, -TOGETHER):
        found = [*radii(grid[begin:begin + TOGETHER]).tolist(), *found]
        last = next((i for i in range(TOGETHER - 1, -1, -1) if found[i] < 1.0), None)
        if last is not None:
            break
    else:
        return 0.0
    if begin + last == POINTS - 1:
        return 2.0 * unit
    values = grid[begin:].tolist()
    below, above = values[last], values[last + 1]
    # From above: below the margin a root that has nothing to do with it may be the largest.
    guess, reach = _crossing(values[last + 1:last + 5], found[last + 1:last + 5]), 1e-3
    for _ in range(ROUNDS):
        if guess is None or not below < guess < above:
            break
        end, step = _halved(below, above, guess.__gt__)
        first = reach > 1e-4        # too early to be where bisections end
        ends = [guess] if first else _around(end, step)
        tried = ends + ([guess * (1.0 - reach), guess * (1.0 + reach)] if reach > 1e-12 else [])
        calm = radii(np.array(tried)).tolist()
        last_calm = _last_calm(ends, calm)
        if last_calm is not None:
            return _halved(below, above, last_calm.__ge__)[0]
        pairs = sorted(zip(tried, calm, strict=True))
        if len({value for value, _ in pairs[1:-1]}) == 4 and reach > 1e-12:
            pairs = [pairs[0], pairs[2], pairs[-1]]
        guess = _crossing([value for value, _ in pairs], [radius for _, radius in pairs])
        reach = reach * 1e-5
    return _halved(below, above, lambda value: bool(radii(np.array([value]))[0] < 1.0))[0]


def _halved(below: float, above: float, calm: Callable[[float], bool]) -> tuple[float, float]:
    """Return the lower end of a bracket after `STEPS` bisections, and its width."""
    for _ in range(STEPS):
        middle = 0.5 * (below + above)
        if calm(middle):
            below = middle
        else:
            above = middle
    return below, above - below


def _around(end: float, step: float) -> list[float]:
    """Return ends of bisections, a step apart, about one of them."""
    return [end - step, end, end + step, end + 2.0 * step]


def _last_calm(ends: Sequence[float], radii: Sequence[float]) -> float | None:
    """Return the end after which the next one is not calm; None = none of these."""
    return next((end for end, radius, after in zip(ends[:-1], radii, radii[1:], strict=False)
                 if radius < 1.0 <= after), None)


def _crossing(values: Sequence[float], radii: Sequence[float]) -> float | None:
    """Return where the radius passes 1, by Neville's inverse interpolation; None = not smooth."""
    excess, found = [radius - 1.0 for radius in radii], list(values)
    if len(found) < 2 or any(second <= first for first, second in pairwise(excess)):
        return None
    for width in range(1, len(found)):
        found = [(excess[i + width] * found[i] - excess[i] * found[i + 1])
                 / (excess[i + width] - excess[i]) for i in range(len(found) - 1)]
    return found[0]


def largest_beta(model: LayerModel, period: float, delay: int,
                 observer: LinearObserver | None = None) -> float:
    """Return the largest β without chatter [unit of x^(n) per actuator unit]; 0 = none."""
    # Without delay, memory and observer the loop ends at slope β T = 2.
    unit = 2.0 / (abs(float(model.d[-1])) * period)
    with np.errstate(over='ignore', invalid='ignore'):
        parts = _parts(model, period, delay, observer)
    return _largest(_radii(parts, delay), unit, _negative_from(parts, unit, delay))


def _negative_from(parts: tuple[Array, Array, Array, Array], unit: float, delay: int) -> float:
    """Return the β above which det(I + A) is negative, so that the loop is not calm; inf = none.

    The determinant is that of a change of rank one, linear in β. It is the product of all 1 + z, z
    the eigenvalues, and positive where each |z| < 1 (the first of Jury's conditions).
    """
    with np.errstate(over='ignore', invalid='ignore'):
        matrices = _matrices(parts, np.array([0.0, unit]), delay)
        at_zero, at_unit = np.linalg.det(matrices + np.eye(len(parts[0]))).tolist()
    fall = at_zero - at_unit
    return unit * at_zero / fall if at_zero > 0.0 and 0.0 < fall < math.inf else math.inf


def largest_gain(model: Callable[[float], LayerModel | None], period: float, beta: float,
                 delay: int,
                 observer: Callable[[float], LinearObserver | None] = lambda _: None) -> float:
    """Return the largest K without chatter [actuator unit per unit of s]; 0 = none.

    `model` is the law in its layer as a function of K; None = not known, so never calm. `observer`
    is a function of K too, since its rate may follow it.
    """
    def radius(gain: float) -> float:
        found = model(gain)
        return (math.inf if found is None
                else spectral_radius(found, period, beta, delay, observer(gain)))

    unit = 2.0 / (beta * period)
    return _largest(lambda gains: np.array([radius(gain) for gain in gains.tolist()]), unit)
