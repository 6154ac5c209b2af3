"""What is known of a run besides its channels: units, gains, true parameters, what made it.

Everything here may be unknown: a recording made by another tool carries no configuration, real
hardware has no truth, and a plant that is not installed here has no units. Unknown is None, an
empty text or an empty mapping, never a guess.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration, SECTIONS
from dz_ros.core.dataset import RunData
from dz_ros.errors import DzRosError


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
        state_units: Units of x, x', …, shape (n,); '' = unknown.
        actuator_unit: Unit of v and w; '' = unknown.
        simulated: True where the plant was a simulated one, so that its parameters are known.
        true_signals: Name of an estimate → its true value(s): a_i/(b m), 1/(b m), two where the
            slopes of the dead-zone differ. Empty unless simulated.
        flat: Dotted key → value with defaults filled in where the configuration can be built.
        configuration: The configuration, None where there is none or it cannot be built here.
    """

    mode: str
    order: int
    period: float | None
    plant: str
    law: str
    trajectory: str
    lambda_: float | None
    epsilon: float | None
    state_units: tuple[str, ...]
    actuator_unit: str
    simulated: bool
    true_signals: Mapping[str, tuple[float, ...]]
    flat: Mapping[str, Any]
    configuration: Configuration | None

    @classmethod
    def of(cls, run: RunData) -> Setting:
        """Return the setting of a run."""
        configuration = _configuration(run)
        flat = dict(run.configuration)
        if configuration is not None:
            flat.update(configuration.to_flat())
        state = run.channels.get('state')
        order = len(state_columns(state.labels)) if state is not None else 0
        units: tuple[str, ...] = ('',) * order
        actuator_unit = ''
        if configuration is not None and configuration.plant.order == order:
            units = configuration.plant.state_units
            actuator_unit = configuration.plant.actuator_unit
        mode = str(run.info.get('mode', ''))
        simulated = 'truth' in run.channels or mode == 'offline'
        rate = _number(flat.get('loop.rate'))
        return cls(
            mode, order, 1.0 / rate if rate else _median_interval(run),
            str(flat.get('plant.model', '')), str(flat.get('controller.law', '')),
            str(flat.get('trajectory.kind', '')),
            _number(flat.get('controller.lambda')), _epsilon(configuration, flat), units,
            actuator_unit, simulated,
            _true_signals(configuration) if simulated and configuration else {}, flat,
            configuration)

    def unit(self, quantity: str) -> str:
        """Return the unit of a kind of quantity, '' where unknown.

        Args:
            quantity: ``x0``, ``x1``, … for a state, ``filtered_error``, ``v``, ``v/s``, or a unit
                as it is.
        """
        if quantity == 'filtered_error':
            quantity = f'x{self.order - 1}'
        if quantity in ('v', 'v/s'):
            rate = quantity == 'v/s' and self.actuator_unit
            return f'{self.actuator_unit}/s' if rate else self.actuator_unit
        if quantity[:1] == 'x' and quantity[1:].isdigit():
            index = int(quantity[1:])
            return self.state_units[index] if 0 <= index < len(self.state_units) else ''
        return quantity


def _number(value: Any) -> float | None:
    """Return a positive finite number as such, None for anything else."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        number = float(value)
        if np.isfinite(number) and number > 0.0:
            return number
    return None


def _configuration(run: RunData) -> Configuration | None:
    """Return the run's configuration; None where there is none that works here."""
    ours = {key: value for key, value in run.configuration.items()
            if key.partition('.')[0] in SECTIONS}
    if not ours:
        return None
    try:
        return Configuration.from_flat(ours, driven=False)
    except DzRosError:
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
    """Return what θ̂_i and φ̂ estimate: a_i/(b m) and 1/(b m), for each slope m that differs."""
    slopes = sorted({c.dead_zone.m_r, c.dead_zone.m_l})
    b = c.plant.b
    found = {f'theta{i + 1}': tuple(a / (b * m) for m in slopes) for i, a in enumerate(c.plant.a)}
    found['phi'] = tuple(1.0 / (b * m) for m in slopes)
    return found
