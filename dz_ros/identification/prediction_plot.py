# SPDX-License-Identifier: Apache-2.0
"""Plot of a prediction: measured and predicted states, and their difference."""

from __future__ import annotations

from dz_ros.core.configuration import Configuration
from dz_ros.identification.plant_prediction import Prediction
from dz_ros.report.style import (
    axis_label,
    BLUE,
    derivative,
    fit_y,
    GREY,
    legend,
    line,
    new_figure,
    Picture,
    styled,
)


def draw(found: Prediction, c: Configuration) -> Picture:
    """Return the picture.

    Args:
        found: The prediction.
        c: Units of the states.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    count = found.measured.shape[1]
    with styled():
        figure = new_figure(9.2, 1.2 + 2.2 * (count + 1))
        panels = figure.subplots(count + 1, 1, sharex=True)
        for i, ax in enumerate(panels[:-1]):
            line(ax, found.t, found.measured[:, i], 'measured', color=GREY, lw=2.5,
                 label='measured')
            line(ax, found.t, found.predicted[:, i], 'predicted', color=BLUE,
                 label='predicted from the commands alone')
            ax.set_ylabel(axis_label(derivative('x', i), c.plant.state_units[i]))
            fit_y(ax, found.measured[:, i])
            legend(ax, 2)
        rest = found.predicted[:, 0] - found.measured[:, 0]
        line(panels[-1], found.t, rest, 'difference', color=BLUE, label='predicted − measured')
        panels[-1].set_ylabel(axis_label('difference of x', c.plant.state_units[0]))
        panels[-1].set_xlabel('time  [s]')
        legend(panels[-1], 2)
    return Picture('prediction', 'Plant, predicted',
                   f'{100.0 * found.explained[0]:.4g} % of the variance of x explained.',
                   'measured and predicted states over time, and their difference', figure)
