# SPDX-License-Identifier: Apache-2.0
"""Plants of python-control systems, and the reverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import dead_zone
from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError, MissingDependencyError
from dz_ros.files.configurations import load_configuration

Array = NDArray[np.float64]


def from_control(system: Any, *, b: float | None = None, state_units: Sequence[str] = (),
                 actuator_unit: str = '', seed: int = 0) -> type[Plant]:
    """Make a plant class of a python-control system ẋ = f(t, x, u) in chain form.

    The system has one input and states x, x', …, x^(n−1): ẋ_i = x_(i+1), and the last one is
    affine in the input with a constant gain b > 0. The law gets one regressor, Y = −f_n(x, 0),
    with a = 1: all of the plant but b is known to it.

    Args:
        system: ``control.NonlinearIOSystem``, or any ``control`` state-space system.
        b: Input gain [unit of x^(n) per actuator unit]; None = found by evaluating the system.
        state_units: Units of the states, shape (n,).
        actuator_unit: Unit of the input.
        seed: Of the random states at which the form is checked.

    Raises:
        ConfigurationError: No such system, not one input, not in chain form, or its gain is not a
            constant > 0.
    """
    if not all(hasattr(system, name) for name in ('dynamics', 'nstates', 'ninputs', 'name')):
        raise ConfigurationError('system', system, 'must be a state-space system of '
                                 'python-control')
    order, inputs = int(system.nstates), int(system.ninputs)
    name = str(system.name)
    if inputs != 1 or order < 1:
        raise ConfigurationError('system', name, 'must have one input and at least one state')

    def derivative(t: float, x: Any, u: float) -> Array:
        return np.asarray(system.dynamics(t, np.asarray(x, dtype=float), np.array([u])),
                          dtype=float).reshape(order)

    generator = np.random.default_rng(seed)
    gains = []
    for _ in range(20):
        x = generator.normal(size=order)
        still, pushed = derivative(0.0, x, 0.0), derivative(0.0, x, 1.0)
        if not (np.allclose(still[:-1], x[1:], rtol=1e-9, atol=1e-12)
                and np.allclose(still[:-1], pushed[:-1], rtol=1e-9, atol=1e-12)):
            raise ConfigurationError('system', name, "must be in chain form: states x, x', …, "
                                     'with the input in the last equation only')
        gains.append(float(pushed[-1] - still[-1]))
        twice = derivative(0.0, x, 2.0)
        if not np.allclose(twice[-1] - still[-1], 2.0 * gains[-1], rtol=1e-6):
            raise ConfigurationError('system', name, 'must be affine in the input')
    gain = float(np.median(gains)) if b is None else float(b)
    if not gain > 0.0 or not np.allclose(gains, gain, rtol=1e-6):
        raise ConfigurationError('system', name, 'must have a constant input gain b > 0, found '
                                 f'{min(gains):g} to {max(gains):g}')

    @dataclass(frozen=True)
    class Parameters:
        """Input gain; the rest is the system's."""

        b: float = parameter(gain, '1', 'input gain b', minimum=0.0, open_minimum=True)

    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:     # noqa: ARG001
        """Write Y = −f_n(x, 0)."""
        y[0] = -float(derivative(0.0, list(x), 0.0)[-1])

    units = tuple(state_units) or ('1', *(f'1/s^{i}' if i > 1 else '1/s' for i in range(1, order)))
    return cast('type[Plant]', type('ControlPlant', (Plant,), {
        '__doc__': f'The python-control system {name}.', '__module__': __name__,
        'name': f'control_{_word(name)}',
        'summary': f'python-control system {name}, order {order}', 'order': order,
        'regressor_count': 1, 'state_units': units, 'actuator_unit': actuator_unit or '1',
        'default_x0': (0.0,) * order, 'Parameters': Parameters, 'a': property(lambda _: (1.0,)),
        'b': property(lambda plant: float(plant.parameters.b)),
        'regressors': staticmethod(regressors)}))


def to_control(plant: Plant | Configuration | str | os.PathLike[str]) -> Any:
    """Return a plant as a ``control.NonlinearIOSystem``: input w or, with its dead-zone, v.

    Args:
        plant: A plant (input w), or a configuration, its name or file: its plant behind its
            dead-zone (input v).

    Raises:
        ConfigurationError: Neither a plant nor a configuration of one axis.
        MissingDependencyError: python-control is not installed.
    """
    if isinstance(plant, (str, os.PathLike)):
        plant = load_configuration(Path(plant))
    if not isinstance(plant, (Plant, Configuration)):
        raise ConfigurationError('plant', plant, 'must be a plant or a configuration, its name '
                                 'or its file')
    if isinstance(plant, Configuration):
        plant.require_one()
    try:
        import control
    except ImportError:
        raise MissingDependencyError('python-control is not installed: pip install control'
                                     ) from None
    zone = plant.zone_numbers if isinstance(plant, Configuration) else None
    model = plant.plant if isinstance(plant, Configuration) else plant
    y: Any = np.zeros(model.regressor_count)
    constants = model.constants

    def update(t: float, x: Any, u: Any, params: Any) -> Array:      # noqa: ARG001
        v = float(np.atleast_1d(u)[0])
        w = v if zone is None else dead_zone(v, t, zone)
        model.regressors(x, constants, y)
        top = constants[0] * w - model.disturbance(t, x, constants) \
            - float(np.dot(constants[1:1 + len(y)], y))
        top -= model.sticking(top, x, constants, y.tolist())
        return np.append(x[1:], top)

    return control.NonlinearIOSystem(
        update, lambda t, x, u, params: x, inputs=['w' if zone is None else 'v'],    # noqa: ARG005
        states=[f'x{i}' for i in range(model.order)],
        outputs=[f'x{i}' for i in range(model.order)], name=model.name)


def _word(text: str) -> str:
    """Return a text as a name of letters, digits and underscores."""
    return ''.join(letter if letter.isalnum() else '_' for letter in text).strip('_') or 'system'
