# SPDX-License-Identifier: Apache-2.0
"""Simulated runs inside the assumptions of a certificate, at random, and the picture of them.

A run starts on the reference with the estimates somewhere in the interval assumed; b m, the break
points and their drift are drawn from the bounds. What its second half reaches may not exceed what
was certified (`dz_ros.core.design.certificate`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.certificate import bare, Certificate, SPAN
from dz_ros.core.loop.compiled import available, compiled_loop
from dz_ros.core.loop.offline import Run, simulate
from dz_ros.report.style import axis_label, BLUE, legend, line, new_figure, Picture, RED, styled
from dz_ros.studies.code_folder import keep_compiled

Array = NDArray[np.float64]

FLOOR = 1e-9
"""Errors below this are drawn as this."""


def random_runs(configuration: Configuration, certificate: Certificate, delay: int, count: int,
                seed: int = 0) -> Iterator[Run]:
    """Yield runs drawn from what the certificate assumes.

    Args:
        configuration: What was certified.
        certificate: Gives the ranges.
        delay: Loop delay [samples].
        count: Number of runs.
        seed: Of the draws.
    """
    c = bare(configuration)
    known, draw = c.controller_settings, np.random.default_rng(seed)
    start = list(c.trajectory(0.0)[:c.plant.order])
    keep_compiled()
    loop = compiled_loop(c) if available() else None
    for _ in range(count):
        *theta, phi = (float(draw.uniform(low, high)) for low, high in certificate.estimates)
        slope = float(draw.uniform(*certificate.beta)) / c.plant.b
        ends: dict[str, Any] = {}
        for name, bounds in (('b_r', (0.0, known.b_r_bounds[1])),
                             ('b_l', (known.b_l_bounds[0], 0.0))):
            value = float(draw.uniform(*bounds))
            room = min(value - bounds[0], bounds[1] - value)
            ends[f'plant.dead_zone.{name}'] = value
            ends[f'plant.dead_zone.{name}_drift'] = [room * float(draw.uniform()),
                                                     float(draw.uniform(0.1, 5.0))]
        yield simulate(c.replace(**{
            **ends, 'controller.theta_0': theta, 'controller.phi_0': phi, 'plant.x0': start,
            'plant.dead_zone.m_r': slope, 'plant.dead_zone.m_l': slope,
            'loop.delay': delay, 'loop.duration': c.loop.duration or SPAN}), loop)


def reached(run: Run) -> Array:
    """Return max |x̃_i| over the second half of a run, shape (n,)."""
    error = np.abs(run.x - run.x_d[:, :-1])
    return np.asarray(error[len(error) // 2:].max(axis=0))


def certificate_picture(certificate: Certificate, runs: Sequence[Sequence[Run]]) -> Picture:
    """Return the picture of bounds against simulation, one panel for each delay.

    Args:
        certificate: The bounds.
        runs: For each delay its runs.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    with styled():
        figure = new_figure(9.0, 2.8 * len(runs))
        panels = figure.subplots(len(runs), 1, squeeze=False)[:, 0]
        for panel, bounds, own in zip(panels, certificate.delays, runs, strict=True):
            for k, run in enumerate(own):
                error = np.maximum(np.abs(run.x[:, 0] - run.x_d[:, 0]), FLOOR)
                line(panel, run.t, error, f'run{k}', color=BLUE, lw=0.4,
                     label=f'{len(own)} simulated runs' if k == 0 else None)
            if bounds.error_bound:
                panel.axhline(bounds.error_bound[0], color=RED, gid='bound', label=(
                    'certified bound' if bounds.certified else 'bound, if it stayed in its layer'))
            panel.set_yscale('log')
            panel.set_ylabel(axis_label(f'$|\\tilde{{x}}|$, delay {bounds.delay}',
                                        own[0].configuration.plant.state_units[0]))
            legend(panel)
        panels[-1].set_xlabel(axis_label('t', 's'))
    shown = ', '.join(f'{item.error_bound[0]:.3g} with a delay of {item.delay}'
                      for item in certificate.delays if item.error_bound)
    caption = (f'Bound on |x̃|: {shown}. The runs are drawn from what the certificate assumes.'
               if shown else 'There is no bound.')
    return Picture('certificate', 'Certified bound and simulation', caption,
                   'Tracking error of simulated runs over time, with the certified bound as a '
                   'line above them', figure)
