# SPDX-License-Identifier: Apache-2.0
"""The example plant with the velocity in its second term [zhang_feng1997].

    x'' = a1 (1 − e^−x)/(1 + e^−x) − a2 (x'² + 2x) sin x' − 0.5 a3 x sin 3t + b w

The form in which the plant of (19) appears elsewhere in the literature; [wang2004] prints x for x'
in the second term. State (x, x') without physical units. Y1 = −tanh(x/2), Y2 = (x'² + 2x) sin x';
parameters and disturbance are those of `dz_ros.core.plants.wang2004`.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from dz_ros.core.plants.wang2004 import Wang2004


class ZhangFeng1997(Wang2004):
    """Plant (19) with velocity in the second term."""

    name = 'zhang_feng1997'
    summary = 'example (19) with the velocity in the second term, order 2'

    @staticmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:  # noqa: ARG004
        """Write Y1 = −tanh(x/2), Y2 = (x'² + 2x) sin x'."""
        position = x[0]
        velocity = x[1]
        y[0] = -math.tanh(0.5 * position)
        y[1] = (velocity * velocity + 2.0 * position) * math.sin(velocity)
