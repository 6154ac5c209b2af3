# SPDX-License-Identifier: Apache-2.0
"""What a trajectory is: x_d, x_d', …, x_d^(n) at any time, all from one closed form.

The law needs every derivative up to the plant's order; none is ever formed by differences.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
import math
from typing import Any, ClassVar

from dz_ros.core.schema import fields, shown


class Trajectory(ABC):
    """A desired motion; subclass it to add your own.

    Attributes:
        name: Name in configurations.
        summary: One line for lists.
        max_order: Highest derivative that is continuous enough to be tracked.
        Parameters: Frozen dataclass of `dz_ros.core.schema.parameter` fields.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    max_order: ClassVar[float] = math.inf
    Parameters: ClassVar[type]

    def __init__(self, parameters: Any = None, order: int = 2) -> None:
        self.parameters = self.Parameters() if parameters is None else parameters
        self.order = order

    def __repr__(self) -> str:
        """Return one line: the trajectory and its parameters."""
        return f'<{type(self).__name__} {shown(self.parameters)}>'

    @cached_property
    def constants(self) -> tuple[float, ...]:
        """Flat numbers for `evaluate`: the parameters in their order unless overridden."""
        return tuple(float(getattr(self.parameters, item.attribute))
                     for item in fields(self.Parameters))

    @staticmethod
    @abstractmethod
    def evaluate(t: float, p: Sequence[float], x_d: Any) -> None:
        """Write x_d, x_d', …, one more than the order asked for (``len(x_d) - 1``), at t [s]."""

    def __call__(self, t: float) -> tuple[float, ...]:
        """Return (x_d, …, x_d^(n)) at t [s], shape (n + 1,)."""
        x_d = [0.0] * (self.order + 1)
        self.evaluate(t, self.constants, x_d)
        return tuple(x_d)
