# SPDX-License-Identifier: Apache-2.0
"""What the loop inside the layer makes of a disturbance, bounded with outward rounding (ours).

The loop of `dz_ros.core.design.linear_loop`, whole state measured, is z_{k+1} = A z_k + b u_k,
y_k = c z_k, with u a disturbance at the plant's input, in actuator units. With h_j = c A^j b,
b_0 = b, b_{i+1} = A (I − A)⁻¹ b_i and g_i = c (I − A)⁻¹ b_i, summing by parts i times gives

    |y| ≤ |g_0| D_0 + |g_1| T D_1 + … + |g_{i−1}| T^(i−1) D_{i−1} + T^i D_i Σ_j |c A^j b_i|

for every u_k = u(t_k), |u^(i)| ≤ D_i; the least of these holds. One that is arbitrary within
±1, between the samples too, gives at most Σ_j ∫_0^T |c A^j b(τ)| dτ, a polynomial in τ bounded by
its Bernstein coefficients. All in ball arithmetic, A at one β.

The powers are rounded to P_j, P_{j+1} = P_j A + E_j, ‖E_j‖ ≤ e, so that balls do not grow. With
M = Σ_{j<N} ‖A^j‖ ≤ Σ ‖P_j‖/(1 − N e) that changes a sum by N e M ‖c‖ ‖b‖ at most, and what
follows after N terms is at most M q/(1 − q) ‖c‖ ‖b‖ with q = ‖A^N‖ < 1 (all norms ∞).
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.design.intervals import load_flint, PRECISION, upper
from dz_ros.core.design.linear_loop import LayerModel, spectral_radius

Array = NDArray[np.float64]

SMOOTH = 3
"""Sums by parts at most."""
CUT = 1e-14
"""A sum is cut off where the free response has fallen to about this share."""
MOST_SAMPLES = 200_000


@dataclass(frozen=True)
class LoopSums:
    """Bounds for each output, as floats that are not too small; T^i is in them.

    Attributes:
        held: Σ T^i |c A^j b_i|, for i = 0 … `SMOOTH` of a held input, shape (i, outputs).
        still: T^i |g_i| of a held input, shape (SMOOTH, outputs).
        ramp, ramp_still: The same for the input τ u_k over a sample.
        free: For an input arbitrary within ±1, shape (outputs,).
        fade: Samples in which the free response falls to a thousandth.
    """

    held: Array
    still: Array
    ramp: Array
    ramp_still: Array
    free: Array
    fade: float


def exact_matrix(model: LayerModel, period: float, beta: float, delay: int) -> Any:
    """Return `linear_loop.loop_matrix` of the measured state, with the plant's part in balls."""
    arb, matrix = (getattr(load_flint(), name) for name in ('arb', 'arb_mat'))
    n, p = model.b.shape[1], len(model.c)
    size = n + p + delay
    rows = [[arb(0)] * size for _ in range(size)]
    step, gain = arb(period), arb(beta)
    for i in range(n):
        for j in range(i, n):
            rows[i][j] = step ** (j - i) / math.factorial(j - i)
    command = [arb(float(item)) for item in (*model.d, *model.c)] + [arb(0)] * delay
    push = [gain * step ** (n - i) / math.factorial(n - i) for i in range(n)]
    for i in range(n):
        if delay:
            rows[i][-1] += push[i]
        else:
            rows[i] = [item + push[i] * share for item, share in zip(rows[i], command,
                                                                     strict=True)]
    for i in range(p):
        rows[n + i][:n + p] = [arb(float(item)) for item in (*model.b[i], *model.a[i])]
    for i in range(delay):
        rows[n + p + i] = command if i == 0 else [arb(int(j == n + p + i - 1))
                                                  for j in range(size)]
    return matrix(rows)


def loop_sums(model: LayerModel, period: float, beta: float, delay: int,
              outputs: Array) -> LoopSums | None:
    """Return the sums of every output; None where the loop is not shown to be stable.

    Args:
        model: The law in its layer.
        period: T [s].
        beta: β = b m [unit of x^(n) / actuator unit].
        delay: Loop delay d [samples].
        outputs: Weights of x̃ and the law's memory in each output, shape (outputs, n + p).
    """
    flint = load_flint()
    arb, matrix = flint.arb, flint.arb_mat
    radius = spectral_radius(model, period, beta, delay)
    if radius >= 1.0 or math.log(CUT) / math.log(radius) > MOST_SAMPLES:
        return None
    count = max(64, math.ceil(math.log(CUT) / math.log(radius)))
    n = model.b.shape[1]
    with flint.ctx.workprec(PRECISION):
        a = exact_matrix(model, period, beta, delay)
        size = a.nrows()
        still = matrix([[arb(int(i == j)) - a[i, j] for j in range(size)] for i in range(size)])
        inverse = still.inv()
        forward = a * inverse
        step, gain = arb(period), arb(beta)

        def column(values: list[Any]) -> Any:
            return matrix([[item] for item in values + [arb(0)] * (size - n)])

        held = column([gain * step ** (n - i) / math.factorial(n - i) for i in range(n)])
        ramp = column([gain * step ** (n - i + 1) / math.factorial(n - i + 1) for i in range(n)])
        inputs = []
        for first in (held, ramp):
            inputs.append(first)
            for _ in range(SMOOTH):
                inputs.append(forward * inputs[-1] * step)
        shape = [column([gain * step ** power / math.factorial(power)
                         * arb(math.comb(j, power)) / math.comb(n - 1, power) * step / n
                         for power in range(n - 1, -1, -1)]) for j in range(n)]
        joined = matrix([[item[i, 0] for item in (*inputs, *shape)] for i in range(size)])
        c = matrix([[arb(float(item)) for item in row] + [arb(0)] * (size - outputs.shape[1])
                    for row in outputs])
        rest = c * inverse * joined
        many, wide = len(outputs), joined.ncols()
        sums = [[arb(0)] * wide for _ in range(many)]
        whole, slip = arb(0), 0.0
        power = matrix([[arb(int(i == j)) for j in range(size)] for i in range(size)])
        for _ in range(count):
            response = c * power * joined
            for i in range(many):
                own = sums[i]
                for j in range(wide):
                    own[j] += abs(response[i, j])
            whole += _norm(power)
            product = power * a
            power = product.mid()
            slip = max(slip, size * max(float(item.rad()) for item in product.entries()))
        slips = count * arb(slip) * 2       # of all steps together, in ‖A^j‖_∞ sums
        if not slips < 0.5:
            return None
        whole = whole / (1 - slips)
        shrink = arb(upper(_norm(power) + slips * whole))
        if not shrink < 0.5:
            return None
        beyond = whole * (slips + shrink / (1 - shrink))
        for j in range(wide):
            largest = arb(max(upper(abs(joined[i, j])) for i in range(size)))
            for i in range(many):
                weight = sum((abs(c[i, k]) for k in range(size)), arb(0))
                sums[i][j] += beyond * weight * largest
        found = np.array([[upper(item) for item in line] for line in sums])
        quiet = np.array([[upper(abs(rest[i, j])) for j in range(wide)] for i in range(many)])
        parts = SMOOTH + 1
        free = np.array([upper(sum((sums[i][j] for j in range(2 * parts, wide)), arb(0)))
                         for i in range(many)])
    return LoopSums(found[:, :parts].T, quiet[:, :SMOOTH].T, found[:, parts:2 * parts].T,
                    quiet[:, parts:parts + SMOOTH].T, free, math.log(1e-3) / math.log(radius))


def _norm(a: Any) -> Any:
    """Return the largest row sum of absolute values."""
    arb = load_flint().arb
    table = a.tolist()
    return arb(max(upper(sum((abs(item) for item in row), arb(0))) for row in table))
