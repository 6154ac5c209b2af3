# SPDX-License-Identifier: Apache-2.0
"""What a control law is: a pure step from a measurement to a command, a memory and a record.

    (memory_k, reference at t_k, x(t_k), Y(x(t_k)), dt)  →  (v_k, memory_{k+1}, terms_k)

It never reads a clock, a file or a parameter. The numbers live in one static scalar function,
`Law.kernel`, used as it is online and compiled offline; `Law.step` wraps it in records. ``dt`` is
the accepted interval; 0 freezes adaptation (mathematics.md §7).

A law's *memory* is all it carries from sample to sample (θ̂, φ̂, integrals, …). Its *signals* are
what it publishes in every sample, each declared with name, unit, meaning and role
(`dz_ros.core.signals`); labels, plots, pages and tables follow. The memory before the step can be
read from them, so a recording can be recomputed from any sample on.

A new field of `terms` is declared in `dz_ros.core.signals.TERMS`, a new signal in `Law.signals`;
besides, only the kernel that writes it changes. Kernels address terms by the constants of
`dz_ros.core.signals` (S, V_EXTRA, …) or by `places`, resolved when the module is loaded.

Over 300 lines: the one contract that every law keeps, and what each part of it means.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.design.linear_loop import LayerModel, surface_model
from dz_ros.core.records import Command, Reference, State, Status, Terms
from dz_ros.core.schema import shown
from dz_ros.core.signals import BEFORE, names, Role, Signal, STATUS
from dz_ros.errors import ConfigurationError, CountError

Numbers = Sequence[float]


def publish(numbers: Sequence[float], at: int, terms: Any) -> None:
    """Copy numbers into the terms from a place on."""
    for i in range(len(numbers)):
        terms[at + i] = numbers[i]


def per_regressor(values: Sequence[float], count: int, key: str) -> tuple[float, ...]:
    """Return `count` numbers from as many or from one for all.

    Raises:
        CountError: Neither one number nor `count`.
    """
    if len(values) == count:
        return tuple(values)
    if len(values) == 1:
        return tuple(values) * count
    allowed = '1 number' if count == 1 else f'1 or {count} numbers, one for each regressor'
    raise CountError(f'controller.{key}', list(values), f'must have {allowed}')


@dataclass(frozen=True)
class Design:
    """What the design rules must know of a law that is built around s (`Law.design`).

    Attributes:
        lambda_: λ of the filtered error [1/s].
        k_d: Damping gain [actuator unit / unit of s].
        k: Robust gain, the most the switching term gives [actuator unit].
        epsilon: Half-width of the boundary layer [unit of s]; 0 = no layer.
        gain: Slope −∂v/∂s inside the layer [actuator unit / unit of s].
        lead: Further slope of v against x^(n−1), Λ_v,n φ̂(0) [actuator unit / unit of s].
        target: Half-width of the set that the theorem lets s converge to [unit of s]; 0 = none.
        reserve: Share of k spent on something else than d/m, as an integral's authority ρ_I
            [actuator unit].
        inner_reserve: Authority of an integral inside the layer, where k has no part in it
            [actuator unit].
        least_gain: What the law never lets `gain` fall below [actuator unit / unit of s].
        inverse: True where the law compensates the dead-zone itself, so that k need not.
        guess: b̂_r, b̂_l, e0 of a dead-zone feed-forward [actuator unit]; empty = none.
        theta: Prior bounds of θ̂, (lowest, highest) of each; empty = not projected.
        phi: Prior bounds of φ̂; empty = not projected.
    """

    lambda_: float
    k_d: float
    k: float
    epsilon: float
    gain: float
    lead: float
    target: float = 0.0
    reserve: float = 0.0
    inner_reserve: float = 0.0
    least_gain: float = 0.0
    inverse: bool = False
    guess: tuple[float, ...] = ()
    theta: tuple[tuple[float, float], ...] = ()
    phi: tuple[float, ...] = ()


@dataclass(frozen=True)
class Tunable:
    """A free gain, as an optimiser may vary it.

    Attributes:
        key: Key of the gain, e.g. ``lambda``.
        low, high: Range.
        logarithmic: Whether it is searched by its logarithm.
    """

    key: str
    low: float
    high: float
    logarithmic: bool = True


class Law(ABC):
    """A control law for one plant structure; subclass it to add your own.

    Args:
        gains: Instance of `Gains`; None = its defaults.
        order: Order n of the plant.
        regressor_count: Number r of regressors Y_i.
        period: Nominal sample interval T [s].

    Attributes:
        name: Name in configurations.
        summary: One line for lists.
        orders: Plant orders it is defined for; empty = any.
        Gains: Frozen dataclass of `dz_ros.core.schema.parameter` fields.
        tunable: Free gains with their ranges; all others follow from knowledge of the plant.
        coupled: Whether its command of one axis follows from all axes of the loop. Its kernel then
            gets longer arguments: ``x_d``, ``x`` and ``memory`` hold this axis' numbers first and
            then those of the other axes in the order of `loop.axes`, all of them from before the
            step. ``y`` is what `dz_ros.core.plants.coupled.coupled_regressors` gives: the
            structure of the plant for this axis, or its own Y(x). ``new_memory``, ``terms`` and
            the command are this axis' own, so every axis stays a pure step, and the order in which
            axes are computed does not matter. A gain `axis` is set to the place of the axis. All
            axes must have the law; a gain that concerns another axis (a row of an inertia matrix)
            is given in the same order, own first.

    Raises:
        ConfigurationError: Gains that do not fit the order or the number of regressors.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    orders: ClassVar[tuple[int, ...]] = ()
    Gains: ClassVar[type]
    tunable: ClassVar[tuple[Tunable, ...]] = ()
    coupled: ClassVar[bool] = False

    def __init__(self, gains: Any = None, order: int = 2, regressor_count: int = 2,
                 period: float = 0.005) -> None:
        self.gains = self.Gains() if gains is None else gains
        self.order = order
        self.regressor_count = regressor_count
        self.period = period
        if self.orders and order not in self.orders:
            allowed = ' or '.join(str(item) for item in self.orders)
            raise ConfigurationError('controller.law', self.name,
                                     f'needs a plant of order {allowed}, this one has {order}')

    def __repr__(self) -> str:
        """Return one line: the law, what it is for, its gains."""
        return (f'<{type(self).__name__} for order {self.order}, {1.0 / self.period:g} Hz: '
                f'{shown(self.gains)}>')

    @property
    @abstractmethod
    def constants(self) -> tuple[float, ...]:
        """Flat numbers for `kernel`, made from gains, order and period."""

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Declare what `kernel` writes after the status, in this order; none by default.

        Either the whole memory as it was used in v, or anything and then the memory before the
        step by `dz_ros.core.signals.before`. θ̂_i, φ̂ are `dz_ros.core.signals.estimates`.
        """
        return ()

    @cached_property
    def signal_names(self) -> tuple[str, ...]:
        """Names of `signals`."""
        return names(self.signals)

    @property
    def design(self) -> Design | None:
        """What the design rules must know; None = the law is not built around s, or not known."""
        return None

    @property
    def schedule_place(self) -> int:
        """Place of the scheduling variable in the memory, written after each step; -1 = none."""
        return -1

    def known_slopes(self, psi: float) -> tuple[float, float]:  # noqa: ARG002
        """Return the slopes right and left that the law divides by at this value of ψ; 1 = none.

        The bounds of m are those of the dead-zone's slopes over these.
        """
        return (1.0, 1.0)

    def layer_model(self, gain: float | None = None) -> LayerModel | None:
        """Return the law inside its boundary layer, a linear step; None = not known.

        Where the memory rests in the layer it follows from `design`; a law with an integral or an
        observer there brings its own. The contract tests compare it with the kernel.

        Args:
            gain: K to use instead of the law's own [actuator unit per unit of s].
        """
        design = self.design
        if design is None:
            return None
        return surface_model(self.order, design.lambda_, design.gain if gain is None else gain,
                             design.lead)

    def check_axes(self, laws: Mapping[str, Law]) -> None:  # noqa: B027  most have nothing to check
        """Check the laws of all axes of a loop together; nothing unless a law overrides it.

        Args:
            laws: Axis → its law, of all axes in their order, this one among them.

        Raises:
            ConfigurationError: They do not go together.
        """

    def reset_guard(self, memory: Sequence[float]) -> tuple[float, ...]:
        """Return the memory with a latched guard released; unchanged where a law has none."""
        return tuple(memory)

    def take_over(self, memory: Sequence[float]) -> tuple[float, ...]:
        """Return the memory for a new start from whatever state the plant is in.

        Called when the controller answers again after it sent the safe command, with the memory
        that `safety.estimates` chose; unchanged where a law has nothing to start again.
        """
        return tuple(memory)

    def initial_memory(self) -> tuple[float, ...]:
        """Memory before the first sample; none by default."""
        return ()

    @property
    def memory_signals(self) -> tuple[str, ...]:
        """Names of the signals from which the memory before the step is read."""
        return self.signal_names[self._memory_at:]

    @property
    def memory_names(self) -> tuple[str, ...]:
        """Names of the memory's numbers."""
        return tuple(name.removesuffix(BEFORE) for name in self.memory_signals)

    @cached_property
    def _memory_at(self) -> int:
        """Place of the memory before the step among the signals; 0 where they are the memory."""
        return next((i for i, item in enumerate(self.signals) if item.role is Role.MEMORY), 0)

    def memory_from_signals(self, signals: Sequence[float]) -> tuple[float, ...]:
        """Return the memory before the step that published these signals."""
        return tuple(signals[self._memory_at:])

    @staticmethod
    @abstractmethod
    def kernel(c: Numbers, memory: Numbers, x_d: Numbers, x: Numbers, y: Numbers,
               dt: float, new_memory: Any, terms: Any) -> float:
        """Return v; fill new_memory and terms.

        Args:
            c: `constants`.
            memory: Memory before the step.
            x_d: x_d … x_d^(n), shape (n + 1,).
            x: Measured state, shape (n,).
            y: Y(x), shape (r,).
            dt: Accepted interval [s]; 0 = adaptation frozen.
            new_memory: Buffer for the memory after the step, as long as memory.
            terms: Buffer for TERMS, status bits, signals, zeros at first. Of TERMS a kernel writes
                in every step what it has; the others stay 0.
        """

    @cached_property
    def _step_numbers(self) -> tuple[tuple[float, ...], int]:
        """`constants` and the length of the terms' buffer, worked out once: gains never change."""
        return self.constants, STATUS + 1 + len(self.signal_names)

    @cached_property
    def _memory_size(self) -> int:
        """Number of this axis' own numbers of memory."""
        return len(self.initial_memory())

    def step(self, memory: Sequence[float], reference: Reference, state: State,
             y: Sequence[float], dt: float,
             status: Status = Status.ADAPTING,
             seq: int | None = None) -> tuple[Command, tuple[float, ...], Terms]:
        """Return command, next memory and terms for one sample, as records.

        Args:
            memory: Memory before the step; of a coupled law that of the other axes follows.
            reference: Reference at the state's stamp; likewise.
            state: Measured state; likewise.
            y: Y(x), shape (r,).
            dt: Accepted interval [s]; 0 freezes adaptation.
            status: Why dt is 0, as far as the caller knows; the law adds its own reasons.
            seq: seq of the command; None = that of the state.
        """
        constants, width = self._step_numbers
        new_memory = [0.0] * (self._memory_size if self.coupled else len(memory))
        buffer = [0.0] * width
        v = self.kernel(constants, memory, reference.x_d, state.x, y, dt, new_memory, buffer)
        number = state.seq if seq is None else seq
        command = Command(number, state.stamp, v, state.seq, state.stamp)
        if buffer[STATUS]:      # joining flags costs as much as half a kernel
            status |= int(buffer[STATUS])
        terms = Terms(number, state.stamp, tuple(buffer[:STATUS]), dt, status, reference.seq,
                      state.seq, tuple(buffer[STATUS + 1:]))
        return command, tuple(new_memory), terms
