# SPDX-License-Identifier: Apache-2.0
"""Facts of a run besides its channels: units, gains, true parameters, what made it.

Everything here may be unknown: a recording made by another tool carries no configuration, real
hardware has no truth, and a plant that is not installed here has no units. Unknown is None, an
empty text or an empty mapping, never a guess.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.plants.coupled import CoupledPlant
from dz_ros.core.records import Command, Reference, State, Terms, Truth
from dz_ros.core.signals import declared, estimates, Signal
from dz_ros.core.units import Units
from dz_ros.runs.history import RunHistory


def state_columns(labels: Sequence[str]) -> list[int]:
    """Return the places of x0, x1, … among a state's labels, in their order."""
    places = {label: place for place, label in enumerate(labels)}
    found: list[int] = []
    while f'x{len(found)}' in places:
        found.append(places[f'x{len(found)}'])
    return found


@dataclass(frozen=True)
class Setting:
    """A run's setting.

    Attributes:
        mode: How it was made: offline, realtime, lockstep, …; '' = unknown.
        order: Plant order n; 0 = no state channel.
        period: Sample interval T [s]; None = unknown.
        plant: Name of the plant's model; '' = unknown.
        law: Name of the law; '' = unknown.
        trajectory: Kind of the trajectory; '' = unknown.
        lambda_: Slope λ of the filtered error [1/s].
        epsilon: Half-width ε of the boundary layer, unit of s; None = unknown or none.
        units: Units of the plant, unknown ones where it is not known here.
        signals: What is declared of the law's signals; empty where the law is not known here.
        simulated: True where the plant was a simulated one, so that its parameters are known.
        true_signals: Name of an estimate → its true value(s): a_i/(b m), 1/(b m), two where the
            slopes of the dead-zone differ. Empty unless simulated.
        flat: Dotted key → value with defaults filled in where the configuration can be built.
        configuration: The configuration, None where there is none or it cannot be built here.
        problem: Why a configuration that there is cannot be built here; '' = it can.
    """

    mode: str
    order: int
    period: float | None
    plant: str
    law: str
    trajectory: str
    lambda_: float | None
    epsilon: float | None
    units: Units
    signals: tuple[Signal, ...]
    simulated: bool
    true_signals: Mapping[str, tuple[float, ...]]
    flat: Mapping[str, Any]
    configuration: Configuration | None
    problem: str = ''

    @classmethod
    def of(cls, run: RunData) -> Setting:
        """Return the setting of a run."""
        history = RunHistory.of(run)
        configuration, problem = history.configuration, history.problem
        flat = {**run.configuration, **history.latest}
        if configuration is not None:
            flat.update(configuration.to_flat())
        state = run.channels.get('state')
        order = len(state_columns(state.labels)) if state is not None else 0
        units = Units(order)
        if configuration is not None and configuration.plant.order == order:
            units = Units.of(configuration.plant)
        mode = str(run.info.get('mode', ''))
        simulated = 'truth' in run.channels or mode == 'offline'
        rate = _number(flat.get('loop.rate'))
        return cls(
            mode, order, 1.0 / rate if rate else _median_interval(run),
            str(flat.get('plant.model', '')), str(flat.get('controller.law', '')),
            str(flat.get('trajectory.kind', '')),
            _number(flat.get('controller.lambda')), _epsilon(configuration, flat), units,
            configuration.law.signals if configuration else (), simulated,
            _true_signals(configuration) if simulated and configuration else {}, flat,
            configuration, problem)

    def unit(self, expression: str) -> str:
        """Return the unit of an expression of `dz_ros.core.units`; '' where it is unknown."""
        return self.units.resolve(expression)

    def column_units(self, names: Iterable[str]) -> dict[str, str]:
        """Return column of a run's table → unit; '' where there is none or it is not known."""
        n = self.order
        known = [*State.fields(n), *Reference.fields(n), *Command.fields(), *Terms.fields(()),
                 *Truth.fields(), *self.signals]
        found = {item.name: self.unit(item.unit) for item in declared(tuple(names), known)}
        return {name: '' if unit == '1' else unit for name, unit in {**found, 't': 's'}.items()}


def _number(value: Any) -> float | None:
    """Return a positive finite number as such, None for anything else."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        number = float(value)
        if np.isfinite(number) and number > 0.0:
            return number
    return None


def _epsilon(configuration: Configuration | None, flat: Mapping[str, Any]) -> float | None:
    """Return ε: the law's own (it may be automatic) before the configured one."""
    if configuration is not None:
        own = _number(getattr(configuration.law, 'epsilon', None))
        if own is not None:
            return own
        if not hasattr(configuration.law.gains, 'epsilon'):
            return None
    return _number(flat.get('controller.epsilon'))


def _median_interval(run: RunData) -> float | None:
    """Return the median distance of the states' stamps [s]."""
    state = run.channels.get('state')
    if state is None or len(state) < 2:
        return None
    return _number(float(np.nanmedian(np.diff(state['stamp']))))


def _true_signals(c: Configuration) -> dict[str, tuple[float, ...]]:
    """Return what θ̂_i and φ̂ estimate: a_i/(b m) and 1/(b m), for each slope m that differs.

    Of a law of all axes: the weights of the plant's structure over b m.
    """
    slopes = sorted({c.dead_zone.m_r, c.dead_zone.m_l})
    if c.law.coupled and isinstance(c.plant, CoupledPlant) and c.plant.structure_count:
        return {item.name: tuple(weight / m for m in slopes) for item, weight in zip(
            estimates(c.plant.structure_count), c.plant.structure_weights, strict=False)}
    b = c.plant.b
    return {item.name: tuple(numerator / (b * m) for m in slopes) for item, numerator in zip(
        estimates(c.plant.regressor_count), (*c.plant.a, 1.0), strict=True)}
