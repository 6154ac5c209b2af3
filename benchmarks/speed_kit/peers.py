# SPDX-License-Identifier: Apache-2.0
"""The paper's closed loop as users of other tools would compute it: C, scipy, python-control.

The loop is a sampled one: v is held over a sample while the plant moves in continuous time.

    c_loop          loop.c, compiled by the system's compiler, called on numpy arrays
    by_solve_ivp    scipy's solve_ivp from sample to sample, rtol 1e-8
    continuous      solve_ivp once over the whole time, the law in continuous time: another loop,
                    which differs from the sampled one by what sampling does
    by_control      python-control: plant (RK4, the same steps) and law interconnected as systems
                    in discrete time, input_output_response
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
import math
from pathlib import Path
import shutil
import subprocess
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration

Array = NDArray[np.float64]
SOURCE = Path(__file__).with_name('loop.c')
RTOL, ATOL = 1e-8, 1e-10
FLAGS = ('-O2', '-ffp-contract=off', '-shared', '-fPIC')


class Example:
    """Numbers and functions of the example, in the plainest Python.

    Args:
        c: A configuration of the paper's plant, law and trajectory.
    """

    def __init__(self, c: Configuration) -> None:
        g, p, z, m = c.law.gains, c.plant.parameters, c.dead_zone, c.trajectory.parameters
        self.names = {
            'period': c.loop.period, 'kd': g.k_d, 'k': g.k_star, 'epsilon': g.epsilon,
            'gamma': g.gamma, 'eta': g.eta, 'lambda': g.lambda_, 'theta1': g.theta_0[0],
            'theta2': g.theta_0[-1], 'phi': g.phi_0, 'a1': p.a1, 'a2': p.a2, 'a3': p.a3,
            'b': p.b, 'mr': z.m_r, 'ml': z.m_l, 'br': z.b_r, 'bl': z.b_l,
            'amplitude': m.amplitude, 'frequency': m.frequency, 'x0': c.x0[0], 'x1': c.x0[1]}
        self.last, self.substeps = c.loop.samples, c.plant_settings.substeps
        self.period: float = c.loop.period
        self.start = [*c.x0, g.theta_0[0], g.theta_0[-1], g.phi_0]

    def zone(self, v: float) -> float:
        """Return w."""
        n = self.names
        if v >= n['br']:
            return float(n['mr'] * (v - n['br']))
        return float(n['ml'] * (v - n['bl'])) if v <= n['bl'] else 0.0

    def field(self, t: float, x: Any, w: float) -> tuple[float, float]:
        """Return x', x'' behind the dead-zone."""
        n = self.names
        y1, y2 = -math.tanh(0.5 * x[0]), (x[0] * x[0] + 2.0 * x[0]) * math.sin(x[0])
        return x[1], (n['b'] * w - 0.5 * n['a3'] * x[0] * math.sin(3.0 * t) - n['a1'] * y1
                      - n['a2'] * y2)

    def law(self, t: float, x: Any, estimates: Any) -> tuple[float, tuple[float, float, float]]:
        """Return v and the derivatives of θ̂, φ̂."""
        n = self.names
        xd = n['amplitude'] * math.sin(n['frequency'] * t)
        dxd = n['amplitude'] * n['frequency'] * math.cos(n['frequency'] * t)
        ddxd = -n['frequency'] ** 2 * xd
        y1, y2 = -math.tanh(0.5 * x[0]), (x[0] * x[0] + 2.0 * x[0]) * math.sin(x[0])
        s = n['lambda'] * (x[0] - xd) + (x[1] - dxd)
        u_fd = ddxd - n['lambda'] * (x[1] - dxd)
        sat = min(max(s / n['epsilon'], -1.0), 1.0)
        s_eps = s - n['epsilon'] * sat
        v = (-n['kd'] * s + estimates[2] * u_fd + y1 * estimates[0] + y2 * estimates[1]
             - n['k'] * sat)
        return v, (-n['gamma'] * y1 * s_eps, -n['gamma'] * y2 * s_eps, -n['eta'] * u_fd * s_eps)


def c_loop(example: Example, folder: Path) -> Callable[[], Array]:
    """Return a function that runs loop.c and returns x, shape (K + 1, 2).

    Raises:
        FileNotFoundError: No C compiler.
    """
    compiler = shutil.which('cc')
    if compiler is None:
        raise FileNotFoundError('no C compiler (cc)')
    library = folder / 'loop.so'
    subprocess.run([compiler, *FLAGS, str(SOURCE), '-o', str(library), '-lm'], check=True)
    count = example.last + 1

    class Numbers(ctypes.Structure):
        _fields_ = [*((name, ctypes.c_double) for name in example.names),
                    ('last', ctypes.c_long), ('substeps', ctypes.c_long)]

    numbers = Numbers(**example.names, last=example.last, substeps=example.substeps)
    run = ctypes.CDLL(str(library)).run
    run.argtypes = [ctypes.POINTER(Numbers), *[ctypes.c_void_p] * 5]

    def call() -> Array:
        arrays = [np.zeros((count, wide)) for wide in (2, 3, 1, 3, 12)]
        run(ctypes.byref(numbers), *(item.ctypes.data for item in arrays))
        return arrays[0]

    return call


def by_solve_ivp(example: Example) -> Array:
    """Return x of the sampled loop, each sample integrated by solve_ivp."""
    from scipy.integrate import solve_ivp

    x, estimates = list(example.start[:2]), list(example.start[2:])
    found = []
    for k in range(example.last + 1):
        t = k * example.period
        found.append(x)
        v, rates = example.law(t, x, estimates)
        w = example.zone(v)
        estimates = [value + example.period * rate
                     for value, rate in zip(estimates, rates, strict=True)]
        done = solve_ivp(example.field, (t, t + example.period), x, args=(w,), rtol=RTOL,
                         atol=ATOL)
        x = done.y[:, -1].tolist()
    return np.array(found)


def continuous(example: Example) -> Array:
    """Return x of the loop with the law in continuous time, one call of solve_ivp."""
    from scipy.integrate import solve_ivp

    def whole(t: float, z: Any) -> tuple[float, ...]:
        v, rates = example.law(t, z, z[2:])
        return *example.field(t, z, example.zone(v)), *rates

    at = np.arange(example.last + 1) * example.period
    done = solve_ivp(whole, (0.0, at[-1]), example.start, t_eval=at, rtol=RTOL, atol=ATOL)
    return np.ascontiguousarray(done.y[:2].T)


def by_control(example: Example) -> Array:
    """Return x of the sampled loop as python-control computes it."""
    import control

    steps, h = example.substeps, example.period / example.substeps

    def move(t: float, x: Any, u: Any, _parameters: Any) -> Any:
        w = example.zone(u[0])
        for step in range(steps):
            now = t + step * h
            k1 = example.field(now, x, w)
            k2 = example.field(now + h / 2, [a + h / 2 * b for a, b in zip(x, k1, strict=True)], w)
            k3 = example.field(now + h / 2, [a + h / 2 * b for a, b in zip(x, k2, strict=True)], w)
            k4 = example.field(now + h, [a + h * b for a, b in zip(x, k3, strict=True)], w)
            x = [a + h / 6 * (p + 2 * q + 2 * r + s)
                 for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)]
        return x

    plant = control.nlsys(move, None, name='plant', states=2, inputs=['v'],
                          outputs=['x', 'dx'], dt=example.period)
    law = control.nlsys(
        lambda t, z, u, _: [value + example.period * rate for value, rate in
                            zip(z, example.law(t, u, z)[1], strict=True)],
        lambda t, z, u, _: [example.law(t, u, z)[0]],
        name='law', states=3, inputs=['x', 'dx'], outputs=['v'], dt=example.period)
    loop = control.interconnect([plant, law], inputs=None, outputs=['x', 'dx'])
    at = np.arange(example.last + 1) * example.period
    done = control.input_output_response(loop, at, 0.0, example.start)
    return np.ascontiguousarray(np.asarray(done.outputs).T)
