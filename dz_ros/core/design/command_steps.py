# SPDX-License-Identifier: Apache-2.0
"""What commands in whole steps do to the loop in its layer: a bound on the limit cycle (ours).

A device that rounds v to steps of q gives v + δ_k, |δ_k| ≤ q/2. Inside the layer the loop is
linear (`dz_ros.core.design.linear_loop`), so whatever the sequence δ,

    |x̃_i| ≤ q/2 Σ_j |e_iᵀ A^j p|,   |s| ≤ q/2 Σ_j |Λᵀ A^j p|       at the samples

with A the loop's matrix and p what one step of the held command adds to the state. A loop that
rests on a command between two steps cannot find it and moves in a limit cycle, whose size has
this bound; it stays in the layer where the second is below ε. β = b m is taken at both ends of its
bounds and between.
"""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import Finding, INFO, WARNING
from dz_ros.core.design.linear_loop import LayerModel, LinearObserver, loop_matrix
from dz_ros.core.design.observation import observer_of
from dz_ros.core.tracking import error_weights
from dz_ros.core.units import Units

COMMAND_STEPS = 'command steps'
"""Name of the rule."""
BETAS = 5
"""Values of β tried."""
CUT, MAX_SAMPLES = 1e-6, 200_000
"""The sums end where their terms have fallen to this share of the largest, or here [samples]."""


def step_response_sums(model: LayerModel, lambda_: float, period: float, beta: float, delay: int,
                       observer: LinearObserver | None = None) -> tuple[float, ...]:
    """Return Σ_j |e_iᵀ A^j p| for each state, then Σ_j |Λᵀ A^j p|, shape (n + 1,).

    Arguments as of `linear_loop`; inf where the loop is not calm.
    """
    n = int(model.b.shape[1])
    matrix = loop_matrix(model, period, beta, delay, observer)
    if not np.isfinite(matrix).all() or np.abs(np.linalg.eigvals(matrix)).max() >= 1.0:
        return (math.inf,) * (n + 1)
    outputs = np.zeros((n + 1, len(matrix)))
    outputs[:n, :n] = np.eye(n)
    outputs[n, :n] = error_weights(lambda_, n)
    state = np.zeros(len(matrix))
    state[:n] = [beta * period ** (n - i) / math.factorial(n - i) for i in range(n)]
    total = largest = np.zeros(n + 1)
    for _ in range(MAX_SAMPLES):
        terms = np.abs(outputs @ state)
        total = total + terms
        largest = np.maximum(largest, terms)
        state = matrix @ state
        if (terms < CUT * largest).all():
            break
    return tuple(float(item) for item in total)


def limit_cycle_bound(c: Configuration, step: float,
                      measured: int) -> tuple[float, ...] | None:
    """Return bounds of |x̃_1| … |x̃_n| and |s| that commands in these steps cause, shape (n + 1,).

    None where nothing is known of the law in its layer; inf where the loop is not calm.

    Args:
        c: The configuration.
        step: One step q of the command [actuator unit].
        measured: Number of measured states.
    """
    design, model = c.law.design, c.law.layer_model()
    if design is None or model is None:
        return None
    observer = None
    if measured < c.plant.order:
        found = observer_of(c)
        observer = type(found).linear(found.omega, c.loop.period)
        if observer is None:
            return None
    known = c.controller_settings
    low, high = (b * m for b, m in zip(known.b_bounds, known.m_bounds, strict=True))
    sums = [step_response_sums(model, design.lambda_, c.loop.period, float(beta), c.loop.delay,
                               observer) for beta in np.geomspace(low, high, BETAS)]
    return tuple(0.5 * step * max(item) for item in zip(*sums, strict=True))


def check_command_steps(c: Configuration, step: float, measured: int) -> Iterator[Finding]:
    """Check the command's step against the layer; nothing where there is none."""
    bounds = limit_cycle_bound(c, step, measured) if step > 0.0 else None
    behind = Units.of(c.plant).behind
    rounded = f'v is rounded to steps of {step:g}{behind("v")}'
    if bounds is None:
        if step > 0.0 and c.law.layer_model() is not None:
            yield Finding(INFO, COMMAND_STEPS, f'{rounded}; with an observer that is not linear '
                          'nothing is known of its limit cycle',
                          {'step': step})
        return
    *states, s = bounds
    epsilon = 0.0 if c.law.design is None else c.law.design.epsilon
    numbers = {'step': step, 's': s, **{f'x{i}': item for i, item in enumerate(states)}}
    if not math.isfinite(s):
        yield Finding(INFO, COMMAND_STEPS, f'{rounded}; the loop is not calm for all b m within '
                      'the bounds, so nothing is known of its limit cycle', numbers)
        return
    unit = behind('x^(n-1)')
    words = (f'{rounded}: a limit cycle between two of them adds at most '
             f'|x̃1| <= {states[0]:.3g}{behind("x")}, |s| <= {s:.3g}{unit}')
    if epsilon > 0.0 and s > epsilon:
        yield Finding(WARNING, COMMAND_STEPS, f'{words}, beyond ε = {epsilon:.3g}{unit}', numbers,
                      f'a command in steps of {step * epsilon / s:.2g}{behind("v")}, or a wider '
                      'layer')
    else:
        share = f', {s / epsilon:.2g} of ε' if epsilon > 0.0 else ''
        yield Finding(INFO, COMMAND_STEPS, words + share, numbers)
