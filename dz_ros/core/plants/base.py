# SPDX-License-Identifier: Apache-2.0
"""What a plant is: normal form of order n, linear in its unknown parameters, (6) of [wang2004].

    x^(n) + Σ a_i Y_i(x, x', …, x^(n−1)) + disturbance(t, x) = b w(t),     b > 0

A plant is a class: `order`, a frozen dataclass `Parameters` (physical parameters with units and
source; ``b`` may be one of them), the true `a` and `b` they give, and two static functions, the
regressors Y (known to the controller) and the disturbance (not known). The two are plain scalar
code over flat numbers, without side effect but the buffer they fill, so that the same source runs
online and, compiled, offline.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from dz_ros.core.schema import shown


class Plant(ABC):
    """A plant in normal form; subclass it to add your own.

    Attributes:
        name: Name in configurations.
        summary: One line for lists.
        order: n.
        regressor_count: r, the number of unknown parameters a_i.
        state_units: Units of x, x', …, shape (n,).
        actuator_unit: Unit of v and w.
        regressor_units: Units of Y_1 … Y_r, shape (r,); empty = not stated, θ̂ has none then.
        default_x0: Initial state used where the configuration gives none, shape (n,).
        friction: Places i − 1 of the Y_i that are constant while the motion keeps its sign (order
            2 and above): the sign of the motion, a constant force. A motion that shows both apart
            from the dead-zone is rare.
        Parameters: Frozen dataclass of `dz_ros.core.schema.parameter` fields.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    order: ClassVar[int]
    regressor_count: ClassVar[int]
    state_units: ClassVar[tuple[str, ...]]
    actuator_unit: ClassVar[str]
    regressor_units: ClassVar[tuple[str, ...]] = ()
    default_x0: ClassVar[tuple[float, ...]]
    friction: ClassVar[tuple[int, ...]] = ()
    Parameters: ClassVar[type]

    def __init__(self, parameters: Any = None) -> None:
        self.parameters = self.Parameters() if parameters is None else parameters

    def __repr__(self) -> str:
        """Return one line: the plant and its parameters."""
        return f'<{type(self).__name__} {shown(self.parameters)}>'

    @property
    @abstractmethod
    def a(self) -> tuple[float, ...]:
        """True a_i, shape (r,)."""

    @property
    @abstractmethod
    def b(self) -> float:
        """True input gain b > 0, [unit of x^(n) per actuator unit]."""

    @property
    def extra(self) -> tuple[float, ...]:
        """Further constants the regressors and the disturbance need."""
        return ()

    @property
    def constants(self) -> tuple[float, ...]:
        """Flat numbers for the two functions: b, a_1 … a_r, extra; never a ROS or file object."""
        return (self.b, *self.a, *self.extra)

    @staticmethod
    @abstractmethod
    def regressors(x: Sequence[float], p: Sequence[float], y: Any) -> None:
        """Write Y(x), shape (r,), into y.

        The law calls this too: of p it may use known constants only, never b or a_i.
        """

    @staticmethod
    def sticking(free: float, x: Sequence[float], p: Sequence[float],  # noqa: ARG004
                 y: Sequence[float]) -> float:                         # noqa: ARG004
        """Return what a force that depends on the others takes off x^(n); 0 unless overridden.

        Static friction holds against whatever else acts. It is part of the disturbance.

        Args:
            free: x^(n) by everything else, the regressors included.
            x: State, shape (n,).
            p: `constants`.
            y: Y(x), shape (r,).
        """
        return 0.0

    @staticmethod
    def disturbance(t: float, x: Sequence[float], p: Sequence[float]) -> float:  # noqa: ARG004
        """Return the unmodelled part at time t [s], in units of x^(n); 0 unless overridden."""
        return 0.0
