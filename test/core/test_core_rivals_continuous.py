# SPDX-License-Identifier: Apache-2.0
"""The rivals that estimate what a nominal model leaves, against their sources in continuous time.

Where `test_core_rivals_estimating` has programs of the sampled equations, here is what these must
approximate to the first order: plant and published equations as one differential equation.
"""

import math

import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.laws import LAWS
from dz_ros.core.signals import STATUS


def disturbance_observer_rate(g, s, sigma, z):
    """σ̂ = z, z' = g (σ − z)."""
    return z[0], g.observer_rate * (sigma - z)


def l1_rate(g, s, sigma, z):
    """With T → 0 the adaptation is σ itself; w' = ω (σ − w)."""
    return z[0], g.filter_rate * (sigma - z)


def super_twisting_rate(g, s, sigma, z):
    """z = α, w; w' = κ α sgn s, α' = ±α_1."""
    sign = min(max(s / g.epsilon, -1.0), 1.0)
    root = s / math.sqrt(g.epsilon) if abs(sign) < 1.0 else math.copysign(math.sqrt(abs(s)), s)
    grows = g.alpha_rate if abs(s) > g.mu else -g.alpha_rate if z[0] > g.alpha_0 else 0.0
    return z[0] * root + z[1], np.array([grows, g.kappa * z[0] * sign])


RATES = {'disturbance_observer': (disturbance_observer_rate, [0.0]),
         'super_twisting': (super_twisting_rate, [4.0, 0.0]), 'l1': (l1_rate, [0.0])}
"""Law → what v is less than ff − k_d s, and the rate of the law's state; that at the start."""
START, END, FINE = np.array([0.3, 0.8]), 1.5, 2e-4


def reference(t):
    return np.array([math.sin(t), math.cos(t), -math.sin(t)])


def acceleration(t, x, v):
    """A plant of order 2 that no nominal model has: s' = b̂ (v − ff + σ) with a σ of its own."""
    return v - 0.5 * x[1] + 2.0 * math.sin(3.0 * t)


def continuous(name, g):
    """Return x' as a function of (t, x and the law's state), and the state at the start."""
    if name == 'ladrc':
        size = 1 + g.extended_states
        gains = np.poly([-g.observer_rate] * size)[1:]      # e − ê, of ê', f̂', …

        def rate(t, z):
            x, seen, x_d = z[:2], z[2:], reference(t)
            error = x - x_d[:2]
            v = (x_d[2] - g.lambda_ ** 2 * error[0] - 2.0 * g.lambda_ * error[1]
                 - seen[1]) / g.input_gain
            moved = gains * (error[1] - seen[0]) + np.append(seen[1:], 0.0)
            moved[0] += g.input_gain * v - x_d[2]
            return np.array([x[1], acceleration(t, x, v), *moved])

        return rate, np.array([*START, START[1] - reference(0.0)[1], *(0.0,) * (size - 1)])
    own, start = RATES[name]

    def rate(t, z):
        x, x_d = z[:2], reference(t)
        error = x - x_d[:2]
        s = g.lambda_ * error[0] + error[1]
        ff = g.phi_0 * (x_d[2] - g.lambda_ * error[1])
        compensation = own(g, s, 0.0, z[2:])[0]
        v = ff - g.k_d * s - compensation
        pushed = acceleration(t, x, v)
        sigma = g.phi_0 * (pushed - x_d[2] + g.lambda_ * error[1]) - (v - ff)
        moved = own(g, s, sigma, z[2:])[1]
        return np.append([x[1], pushed], moved)

    return rate, np.append(START, start)


def stepped(rate, z, t, h):
    """Return z after one Runge–Kutta step."""
    k1 = rate(t, z)
    k2 = rate(t + 0.5 * h, z + 0.5 * h * k1)
    k3 = rate(t + 0.5 * h, z + 0.5 * h * k2)
    return z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(t + h, z + h * k3))


def sampled(name, values, period):
    """Return x at every sample of the loop with the law, shape (K + 1, 2)."""
    chosen = LAWS.load(name)
    law = chosen(schema.build(chosen.Gains, values, ''), 2, 0, period)
    memory, x, found = list(law.initial_memory()), START, [START]
    for k in range(round(END / period)):
        after, terms = list(memory), [0.0] * (STATUS + 1 + len(law.signal_names))
        v = law.kernel(law.constants, memory, list(reference(k * period)), list(x), [], period,
                       after, terms)
        x = stepped(lambda t, z, v=v: np.array([z[1], acceleration(t, z, v)]), x, k * period,
                    period)
        memory = after
        found.append(x)
    return np.array(found)


@pytest.mark.parametrize(('name', 'values'), [
    ('ladrc', {'design_delay': 0}), ('ladrc', {'design_delay': 0, 'extended_states': 2}),
    ('disturbance_observer', {}), ('super_twisting', {}), ('l1', {})])
def test_is_its_equations_in_continuous_time_to_the_first_order(name, values):
    """Half the period halves the distance from the solution of the published equations."""
    gains = {**values, 'v_clip': 0.0}
    chosen = LAWS.load(name)
    rate, z = continuous(name, schema.build(chosen.Gains, gains, ''))
    exact = [z]
    for k in range(round(END / FINE)):
        exact.append(stepped(rate, exact[-1], k * FINE, FINE))
    distances = []
    for stride in (10, 5):
        x = sampled(name, gains, stride * FINE)
        distances.append(np.abs(x - np.array(exact)[::stride, :2]).max(axis=0))
    assert (distances[0] < [0.002, 0.03]).all()
    assert distances[0] == pytest.approx(2.0 * distances[1], rel=0.1)
