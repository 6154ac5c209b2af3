"""What a control law is: a pure step from a measurement to a command, a memory and a record.

    (memory_k, reference at t_k, x(t_k), Y(x(t_k)), dt)  →  (v_k, memory_{k+1}, terms_k)

It never reads a clock, a file or a parameter. Gains are one frozen value that validates itself.
The numbers live in one static scalar function, `Law.kernel`, used as it is on line and compiled
off line; `Law.step` wraps it in records.

A law's *memory* is all it carries from sample to sample (θ̂, φ̂, integrals, …). Its *signals* are
what it publishes of itself in every sample; the memory before the step can be recovered from
them (`Law.memory_from_signals`), so a recording can be recomputed from any sample on.

``dt`` is the accepted interval, not an assumed constant; 0 freezes adaptation (mathematics.md §7).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from dz_ros.core.records import Command, Reference, State, STATUS, Status, Terms
from dz_ros.errors import ConfigurationError


def per_regressor(values: Sequence[float], count: int, key: str) -> tuple[float, ...]:
    """Return `count` numbers, one for each regressor, from as many or from one for all.

    Raises:
        ConfigurationError: Neither one number nor `count`.
    """
    if len(values) == count:
        return tuple(values)
    if len(values) == 1:
        return tuple(values) * count
    raise ConfigurationError(f'controller.{key}', list(values),
                             f'must have 1 or {count} numbers, one for each regressor')


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
        least_gain: What the law never lets `gain` fall below [actuator unit / unit of s].
        integral_rate: r_I of an integral of s inside the layer [actuator unit / unit of s / s].
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
    least_gain: float = 0.0
    integral_rate: float = 0.0
    inverse: bool = False
    guess: tuple[float, ...] = ()
    theta: tuple[tuple[float, float], ...] = ()
    phi: tuple[float, ...] = ()


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

    Raises:
        ConfigurationError: Gains that do not fit the order or the number of regressors.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    orders: ClassVar[tuple[int, ...]] = ()
    Gains: ClassVar[type]

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

    @property
    @abstractmethod
    def constants(self) -> tuple[float, ...]:
        """Flat numbers for `kernel`, made from gains, order and period."""

    @property
    @abstractmethod
    def signal_names(self) -> tuple[str, ...]:
        """Names of what `kernel` writes after the status; θ̂_i are theta1…, φ̂ is phi."""

    @property
    def design(self) -> Design | None:
        """What the design rules must know; None = the law is not built around s, or not known."""
        return None

    def reset_guard(self, memory: Sequence[float]) -> tuple[float, ...]:
        """Return the memory with a latched guard released; unchanged where a law has none."""
        return tuple(memory)

    @abstractmethod
    def initial_memory(self) -> tuple[float, ...]:
        """Memory before the first sample."""

    @abstractmethod
    def memory_from_signals(self, signals: Sequence[float]) -> tuple[float, ...]:
        """Return the memory before the step that published these signals."""

    @staticmethod
    @abstractmethod
    def kernel(c: Sequence[float], memory: Sequence[float], x_d: Sequence[float],
               x: Sequence[float], y: Sequence[float], dt: float, new_memory: Any,
               terms: Any) -> float:
        """Return v; fill new_memory and terms.

        Args:
            c: `constants`.
            memory: Memory before the step.
            x_d: x_d … x_d^(n), shape (n + 1,).
            x: Measured state, shape (n,).
            y: Y(x), shape (r,).
            dt: Accepted interval [s]; 0 = adaptation frozen.
            new_memory: Buffer for the memory after the step, as long as memory.
            terms: Buffer for `dz_ros.core.records.TERM_NAMES`, status bits, signals.
        """

    @cached_property
    def _step_numbers(self) -> tuple[tuple[float, ...], int]:
        """`constants` and the length of the terms' buffer, worked out once: gains never change."""
        return self.constants, STATUS + 1 + len(self.signal_names)

    def step(self, memory: Sequence[float], reference: Reference, state: State,
             y: Sequence[float], dt: float,
             status: Status = Status.ADAPTING,
             seq: int | None = None) -> tuple[Command, tuple[float, ...], Terms]:
        """Return command, next memory and terms for one sample, as records.

        Args:
            memory: Memory before the step.
            reference: Reference at the state's stamp.
            state: Measured state.
            y: Y(x), shape (r,).
            dt: Accepted interval [s]; 0 freezes adaptation.
            status: Why dt is 0, as far as the caller knows; the law adds its own reasons.
            seq: seq of the command; None = that of the state.
        """
        constants, width = self._step_numbers
        new_memory = [0.0] * len(memory)
        buffer = [0.0] * width
        v = self.kernel(constants, memory, reference.x_d, state.x, y, dt, new_memory, buffer)
        number = state.seq if seq is None else seq
        command = Command(number, state.stamp, v, state.seq, state.stamp)
        if buffer[STATUS]:      # joining flags costs as much as half a kernel
            status |= int(buffer[STATUS])
        terms = Terms(number, state.stamp, tuple(buffer[:STATUS]), dt, status, reference.seq,
                      state.seq, tuple(buffer[STATUS + 1:]))
        return command, tuple(new_memory), terms
