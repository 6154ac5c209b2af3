# SPDX-License-Identifier: Apache-2.0
"""What a device may be asked to do in an experiment (ours)."""

from __future__ import annotations

from dataclasses import dataclass

from dz_ros.core.schema import parameter

LEAST_REPEATS = 4
"""Fewer do not show how much the repeats differ."""
MOVING = 0.03
"""Share of the speed limit (order 1: of the travel) beyond which the device counts as moving …"""
NOISE = 6.0
"""… and at least this number of standard deviations of the noise."""


@dataclass(frozen=True)
class Limits:
    """How far, how fast and how hard; an experiment does not go to them, it stops before."""

    travel: float = parameter(0.0, 'unit of x', 'largest distance from where it stood at the '
                              'beginning', minimum=0.0, open_minimum=True)
    speed: float = parameter(0.0, "unit of x'", 'largest speed; has no meaning at order 1, where '
                             'x itself is limited', minimum=0.0)
    effort: float = parameter(0.0, 'actuator unit', 'largest |v|', minimum=0.0,
                              open_minimum=True)


@dataclass(frozen=True)
class Plan:
    """What is done within the limits."""

    repeats: int = parameter(16, '1', 'how often each kind of move is made both ways',
                             minimum=LEAST_REPEATS, maximum=1000)
    ramp: float = parameter(4.0, 's', 'time in which a ramp would reach the largest |v|',
                            minimum=0.1, maximum=600.0)
    pause: float = parameter(1.0, 's', 'rest between repeats, drawn from half to one and a half '
                             'of it, so that no drift keeps step with the repeats', minimum=0.1)
    seed: int = parameter(0, '1', 'seed of the pauses and places', minimum=0)
