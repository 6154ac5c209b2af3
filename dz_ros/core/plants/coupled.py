# SPDX-License-Identifier: Apache-2.0
"""Contract of a plant that serves several axes at once: links of an arm, degrees of a vehicle.

    x_i^(n) = f_i(t, x, w),      i = 1 … axes,      x = states of all axes, w = (D_1(v_1), …)

Everything but the motion itself stays scalar. Each axis of the loop has a dead-zone, limits,
noise, a law and a trajectory of its own, and the loop has one instance of the class for each
axis: the *view* of that axis, an ordinary plant of order n,

    x_i^(n) + Σ a_ij Y_ij(x_i) = b_i w_i + what the other axes do to it

whose ``a``, ``b``, ``regressors`` are those of the axis alone (the others at rest, at a nominal
configuration). Design rules, tuning and independent loops work on the view and see nothing of the
other axes; what they do is part of the true disturbance of the axis, which the simulation derives:

    disturbance_i = b_i w_i − Σ a_ij Y_ij(x_i) − f_i(t, x, w)

Only the simulated actuator and the offline loop of several axes ask for `dynamics`. A law that is
to know the coupling declares `Law.coupled` and is given the references, states and memories of all
axes (`dz_ros.core.laws.base`).

A configuration chooses the class as `plant.model` for all axes of `loop.axes`, whose number is
`axes`; the first name is axis 0. All other parameters are those of the machine: they are set in
the section `plant`, and axes in which they differ are refused.

A plant may also state the *structure* of its motion, known up to weights m_k that are not,

    Σ_k m_k (g_ik(x) + Σ_j M_ijk(x) x_j^(n) + C_ijk(x) x_j^(n−1)) = w_i b_i,

which laws of all axes use with other accelerations and speeds than those of the motion
(`dz_ros.core.laws.coupled_eso`). (ours)
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from dz_ros.core.plants.base import Plant
from dz_ros.core.schema import parameter


@dataclass(frozen=True)
class CoupledParameters:
    """Parameter that every such plant has; derive its `Parameters` from this class."""

    axis: int = parameter(0, '1', 'axis of the plant that the view is of; follows from the place '
                          'in loop.axes', minimum=0, maximum=31, structural=True)


class CoupledPlant(Plant):
    """The view of one axis of a plant that serves several; subclass it to add your own.

    Attributes:
        axes: Number of axes it serves. All have the order `order`; class attributes that are one
            for all axes (`regressor_count`, `state_units`, `actuator_unit`) are shared, those that
            differ may be properties that read `axis`.
        structure_count: Number r of the weights m_k of the structure; 0 = none is stated.
        structure_units: Units of what each weight is multiplied by, shape (r,).
        Parameters: Frozen dataclass, derived from `CoupledParameters`.
    """

    axes: ClassVar[int]
    structure_count: ClassVar[int] = 0
    structure_units: ClassVar[tuple[str, ...]] = ()

    @property
    def axis(self) -> int:
        """Axis that this view is of, 0 … axes − 1."""
        return int(self.parameters.axis)

    @property
    @abstractmethod
    def machine_constants(self) -> tuple[float, ...]:
        """Flat numbers for `dynamics`, the same in the view of every axis."""

    @property
    def structure_weights(self) -> tuple[float, ...]:
        """True weights of the structure over the input gain, m_k/b, shape (r,)."""
        return ()

    @staticmethod
    @abstractmethod
    def dynamics(t: float, x: Sequence[float], w: Sequence[float], p: Sequence[float],
                 out: Any) -> None:
        """Write x_i^(n) of every axis into out, shape (axes,).

        Plain scalar code without side effect but `out`; the true motion, with everything that the
        views do not model.

        Args:
            t: Loop time [s].
            x: States axis after axis, x_1, x_1', …, x_2, x_2', …: shape (axes n,).
            w: Outputs of the dead-zones, shape (axes,) [actuator unit].
            p: `machine_constants`.
            out: Buffer, shape (axes,) [unit of x^(n)].
        """

    @staticmethod
    def structure(x: Sequence[float], p: Sequence[float], y: Any) -> None:
        """Write the structure of all axes into y, shape (axes, r, 1 + 2 axes), flat.

        Axis after axis and weight after weight: g_ik, M_i1k, M_i2k, …, C_i1k, C_i2k, …. Plain
        scalar code. The law calls this: of p it may use known constants only.

        Args:
            x: States axis after axis, shape (axes n,).
            p: `machine_constants`.
            y: Buffer.
        """

    def coupled_regressors(self, x: Sequence[float]) -> list[float]:
        """Return the rows of the structure for this axis, itself first, then the other axes.

        Args:
            x: States, those of this axis first, then those of the others: shape (axes n,).

        Returns:
            g_k, M_1k, M_2k, …, C_1k, C_2k, … for each weight k, shape (r (1 + 2 axes),); without
            a structure the regressors of the view, shape (regressor_count,).
        """
        if self.structure_count == 0:
            own = [0.0] * self.regressor_count
            self.regressors(x[:self.order], self.constants, own)
            return own
        n, own_axis, axes = self.order, self.axis, self.axes
        width = 1 + 2 * axes
        rows = [0.0] * (axes * self.structure_count * width)
        self.structure([*x[n:(own_axis + 1) * n], *x[:n], *x[(own_axis + 1) * n:]],
                       self.machine_constants, rows)
        columns = [own_axis, *(j for j in range(axes) if j != own_axis)]
        first = own_axis * self.structure_count * width
        found = []
        for at in range(first, first + self.structure_count * width, width):
            found.append(rows[at])
            found.extend(rows[at + 1 + j] for j in columns)
            found.extend(rows[at + 1 + axes + j] for j in columns)
        return found


def regressor_count(plant: Plant, coupled: bool) -> int:
    """Return the number of weights that a law has for a plant; `coupled`: `Law.coupled`."""
    if coupled and isinstance(plant, CoupledPlant) and plant.structure_count:
        return plant.structure_count
    return plant.regressor_count


def coupled_regressors(plant: Plant, x: Sequence[float]) -> list[float]:
    """Return what the kernel of a coupled law takes as y for an axis of any plant.

    Args:
        plant: The view of the axis, or a plant that serves one axis.
        x: States of all axes, its own first.
    """
    if isinstance(plant, CoupledPlant):
        return plant.coupled_regressors(x)
    own = [0.0] * plant.regressor_count
    plant.regressors(x[:plant.order], plant.constants, own)
    return own
