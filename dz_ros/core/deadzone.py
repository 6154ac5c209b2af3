"""Dead-zone of an actuator, equations (1)–(4) of Wang, Su and Hong (2004) [wang2004].

    D(v) = m_r (v − b_r)   v ≥ b_r
           0               b_l < v < b_r                                   (1)
           m_l (v − b_l)   v ≤ b_l

    D(v) = m v + d(v),  m the slope of the side v is on                    (2)
    |d| ≤ ρ = max{m_max b_r,max, −m_max b_l,min}                           (4)

v: command, w = D(v): what reaches the plant, both in the actuator's unit. The slopes may differ
and each parameter may drift, p(t) = p + A sin(ω t) (ours).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

from dz_ros.core.schema import parameter
from dz_ros.errors import ConfigurationError

_DRIFT = '[amplitude, angular frequency in rad/s] of a sinusoidal drift of {0}; 0 = constant'


def dead_zone(v: float, t: float, z: Sequence[float]) -> float:
    """Return w = D(v) at time t, (1).

    Args:
        v: Command.
        t: Time [s], for drifting parameters.
        z: `DeadZone.constants`.
    """
    m_r, m_l, b_r, b_l = z[1], z[2], z[3], z[4]
    if z[0] != 0.0:
        m_r += z[5] * math.sin(z[6] * t)
        m_l += z[7] * math.sin(z[8] * t)
        b_r += z[9] * math.sin(z[10] * t)
        b_l += z[11] * math.sin(z[12] * t)
    if v >= b_r:
        return m_r * (v - b_r)
    if v <= b_l:
        return m_l * (v - b_l)
    return 0.0


def residual(v: float, w: float, t: float, z: Sequence[float]) -> float:
    """Return d(v) = w − m v of (2), m the slope on v's side at time t."""
    right = v >= 0.0
    m = z[1] if right else z[2]
    if z[0] != 0.0:
        m += (z[5] * math.sin(z[6] * t)) if right else (z[7] * math.sin(z[8] * t))
    return w - m * v


def rho(b_r_max: float, b_l_min: float, m_max: float) -> float:
    """Return ρ, the bound (4) on |d|, from the known bounds (A4)."""
    return max(m_max * b_r_max, -m_max * b_l_min)


@dataclass(frozen=True)
class DeadZone:
    """Parameters of the dead-zone, (A2)–(A3); the controller never sees them (A1)."""

    m_r: float = parameter(1.0, '1', 'slope right of the band', minimum=0.0, open_minimum=True)
    m_l: float = parameter(1.0, '1', 'slope left of the band', minimum=0.0, open_minimum=True)
    b_r: float = parameter(0.5, 'actuator unit', 'right break point', minimum=0.0)
    b_l: float = parameter(-0.6, 'actuator unit', 'left break point', maximum=0.0)
    m_r_drift: tuple[float, ...] = parameter((0.0, 0.0), '', _DRIFT.format('m_r'), length=2)
    m_l_drift: tuple[float, ...] = parameter((0.0, 0.0), '', _DRIFT.format('m_l'), length=2)
    b_r_drift: tuple[float, ...] = parameter((0.0, 0.0), '', _DRIFT.format('b_r'), length=2)
    b_l_drift: tuple[float, ...] = parameter((0.0, 0.0), '', _DRIFT.format('b_l'), length=2)

    def check(self, prefix: str) -> None:
        """Check that drift keeps each parameter on its side of zero.

        Raises:
            ConfigurationError: A drift that changes a sign.
        """
        for name in ('m_r', 'm_l', 'b_r', 'b_l'):
            drift = getattr(self, f'{name}_drift')
            if drift[0] == 0.0:
                continue
            least = abs(getattr(self, name)) - abs(drift[0])
            if least < 0.0 or (least == 0.0 and name.startswith('m')):
                raise ConfigurationError(f'{prefix}{name}_drift', list(drift),
                                         f'amplitude must be smaller than |{name}|')

    @property
    def constants(self) -> tuple[float, ...]:
        """Flat numbers for `dead_zone`: drift flag, m_r, m_l, b_r, b_l, 4 × (amplitude, ω)."""
        drifts = [getattr(self, f'{name}_drift') for name in ('m_r', 'm_l', 'b_r', 'b_l')]
        drifting = 1.0 if any(amplitude != 0.0 for amplitude, _ in drifts) else 0.0
        return (drifting, self.m_r, self.m_l, self.b_r, self.b_l,
                *(number for drift in drifts for number in drift))

    def __call__(self, v: float, t: float = 0.0) -> float:
        """Return w = D(v) at time t [s]."""
        return dead_zone(v, t, self.constants)
