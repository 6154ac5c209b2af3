# SPDX-License-Identifier: Apache-2.0
"""The records that flow offline, over topics, into recordings and back out.

Immutable values. Each carries ``seq`` (count of samples from 0) and ``stamp`` (loop time of the
sample in seconds, 0 at the first one). What its numbers are, in the order in which they travel,
is declared by its ``fields`` and nowhere else: topic label, MCAP channel and plot column are
encodings of it. They are named tuples: a sample makes three of them, in a third of the time that
frozen dataclasses take.
"""

from __future__ import annotations

from collections.abc import Sequence
import enum
from typing import Any, NamedTuple

from dz_ros.core.signals import names, Role, Signal, TERMS

SEQ_LIMIT = 2 ** 40
"""Every seq is below this, 34 years at 1 kHz, wherever one is read: message, event, recording."""

_SEQ = Signal('seq', '1', 'count of samples', Role.INDEX, 'k')
_STAMP = Signal('stamp', 's', 'loop time', Role.INDEX, 't')
_ECHO = (Signal('echo_seq', '1', 'seq of the message answered', Role.INDEX),
         Signal('echo_stamp', 's', 'stamp of the message answered', Role.INDEX))


def _derivatives(name: str, symbol: str, meaning: str, count: int) -> tuple[Signal, ...]:
    """Return the signals of a motion and its derivatives."""
    return tuple(Signal(
        f'{name}{i}', f'x^({i})' if i else 'x', f'derivative {i} of it' if i else meaning,
        symbol=symbol + (f'^({i})' if i > 3 else "'" * i)) for i in range(count))


class Status(enum.IntFlag):
    """Why adaptation did not advance in a sample (mathematics.md §7); 0 = it did."""

    ADAPTING = 0
    BAD_INTERVAL = 1
    """The interval since the last accepted sample lies outside [T/2, 2T]."""
    SATURATED = 2
    """The command exceeds the known limit against s (anti-windup)."""
    STALE_REFERENCE = 4
    """The newest reference is older than allowed."""
    INACTIVE = 8
    """The controller is not in a state that adapts."""


def extrapolate(x_d: Sequence[Any], ahead: Any, moved: Any) -> None:
    """Write a reference brought to another instant by its own derivatives.

        x_d^(i)(t + h) = Σ_j x_d^(i+j)(t) h^j / j!,      j = 0 … n − i

    Args:
        x_d: x_d … x_d^(n): numbers, or arrays of many instants.
        ahead: h [s].
        moved: Written, as long as x_d; may be x_d itself.
    """
    for i in range(len(x_d)):
        value, factor = 0.0, 1.0
        for j in range(i, len(x_d)):
            value = value + x_d[j] * factor
            factor = factor * (ahead / (j - i + 1))
        moved[i] = value


class Reference(NamedTuple):
    """Desired motion at one instant.

    Attributes:
        seq: Sample the reference is meant for.
        stamp: Loop time it is meant for [s].
        x_d: x_d, x_d', …, x_d^(n), shape (n + 1,), units of the plant's output per s^i.
    """

    seq: int
    stamp: float
    x_d: tuple[float, ...]

    @staticmethod
    def fields(order: int) -> tuple[Signal, ...]:
        """Return the fields for a plant of this order."""
        return (_SEQ, _STAMP, *_derivatives('xd', 'x_d', 'desired output', order + 1))

    @staticmethod
    def labels(order: int) -> tuple[str, ...]:
        """Return the field names for a plant of this order."""
        return names(Reference.fields(order))

    def numbers(self) -> tuple[float, ...]:
        """Return the record as its labels name it."""
        return (self.seq, self.stamp, *self.x_d)

    @classmethod
    def from_numbers(cls, numbers: Sequence[float]) -> Reference:
        """Return the record from its numbers; the order follows from their count."""
        return cls(int(numbers[0]), numbers[1], tuple(numbers[2:]))

    def at(self, stamp: float) -> Reference:
        """Return the reference brought to another instant by its own derivatives (Taylor)."""
        ahead = stamp - self.stamp
        if ahead == 0.0:
            return self
        moved = list(self.x_d)
        extrapolate(moved, ahead, moved)
        return Reference(self.seq, stamp, tuple(moved))


class State(NamedTuple):
    """Measured state of the plant.

    Attributes:
        seq, stamp: Count of samples, loop time of the measurement [s].
        x: x, x', …, x^(n−1), shape (n,).
        echo_seq, echo_stamp: Of the newest command received before it; −1 = none.
        round_trip: Time from publishing the state that command answers to its arrival back here,
            both by this side's own clock [s]; 0 where no transport is involved.
    """

    seq: int
    stamp: float
    x: tuple[float, ...]
    echo_seq: int = -1
    echo_stamp: float = 0.0
    round_trip: float = 0.0

    @staticmethod
    def fields(order: int) -> tuple[Signal, ...]:
        """Return the fields for a plant of this order."""
        return (_SEQ, _STAMP, *_derivatives('x', 'x', 'measured output', order), *_ECHO,
                Signal('round_trip', 's', 'from a state to its command and back'))

    @staticmethod
    def labels(order: int) -> tuple[str, ...]:
        """Return the field names for a plant of this order."""
        return names(State.fields(order))

    def numbers(self) -> tuple[float, ...]:
        """Return the record as its labels name it."""
        return (self.seq, self.stamp, *self.x, self.echo_seq, self.echo_stamp, self.round_trip)

    @classmethod
    def from_numbers(cls, numbers: Sequence[float]) -> State:
        """Return the record from its numbers; the order follows from their count."""
        return cls(int(numbers[0]), numbers[1], tuple(numbers[2:-3]), int(numbers[-3]),
                   numbers[-2], numbers[-1])


class Command(NamedTuple):
    """What the controller asks of the actuator.

    Attributes:
        seq, stamp: Count of commands, loop time for which it was computed [s].
        v: Command, before the dead-zone, in the actuator's unit.
        echo_seq, echo_stamp: Of the state it answers.
        hold: Time from taking that state to publishing this, by the controller's clock [s]; 0
            where no transport is involved.
    """

    seq: int
    stamp: float
    v: float
    echo_seq: int = -1
    echo_stamp: float = 0.0
    hold: float = 0.0

    @staticmethod
    def fields() -> tuple[Signal, ...]:
        """Return the fields."""
        return (_SEQ, _STAMP, Signal('v', 'v', 'command'), *_ECHO,
                Signal('hold', 's', 'from a state to its command, in the controller'))

    @staticmethod
    def labels() -> tuple[str, ...]:
        """Return the field names."""
        return names(Command.fields())

    def numbers(self) -> tuple[float, ...]:
        """Return the record as its labels name it."""
        return self

    @classmethod
    def from_numbers(cls, numbers: Sequence[float]) -> Command:
        """Return the record from its numbers."""
        return cls(int(numbers[0]), numbers[1], numbers[2], int(numbers[3]), numbers[4],
                   numbers[5])


class Terms(NamedTuple):
    """Every term of the law in one sample.

    Attributes:
        seq, stamp: Of the command they explain.
        values: The numbers that `dz_ros.core.signals.TERMS` declares, in its order.
        dt: Interval by which adaptation advanced [s]; 0 = frozen.
        status: Why it was frozen, `Status` bits.
        reference_seq, echo_seq: seq of the reference used and of the state answered.
        signals: The law's own numbers (θ̂, φ̂ as used in v, …), as its ``signals`` declare them.
    """

    seq: int
    stamp: float
    values: tuple[float, ...]
    dt: float
    status: Status
    reference_seq: int
    echo_seq: int
    signals: tuple[float, ...] = ()

    @staticmethod
    def fields(signals: tuple[Signal, ...]) -> tuple[Signal, ...]:
        """Return the fields for a law with these signals."""
        return (_SEQ, _STAMP, *TERMS,
                Signal('dt', 's', 'interval by which adaptation advanced; 0 = frozen'),
                Signal('status', '1', 'why adaptation was frozen: bits of `Status`'),
                Signal('reference_seq', '1', 'seq of the reference used', Role.INDEX), _ECHO[0],
                *signals)

    @staticmethod
    def labels(signal_names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the field names for a law with signals of these names."""
        return (*names(Terms.fields(())), *signal_names)

    def numbers(self) -> tuple[float, ...]:
        """Return the record as its labels name it."""
        return (self.seq, self.stamp, *self.values, self.dt, self.status,
                self.reference_seq, self.echo_seq, *self.signals)


class Truth(NamedTuple):
    """What only a simulated plant knows.

    Attributes:
        seq, stamp: Of the state it belongs to.
        w: Output of the dead-zone, D(v) (1).
        d: w − m·v with m the slope of v's side (2).
        disturbance: What the controller does not model, in units of x^(n).
    """

    seq: int
    stamp: float
    w: float
    d: float
    disturbance: float

    @staticmethod
    def fields() -> tuple[Signal, ...]:
        """Return the fields."""
        return (_SEQ, _STAMP, Signal('w', 'v', 'output of the dead-zone (1)'),
                Signal('d', 'v', 'D(v) − m v (2)'),
                Signal('disturbance', 'x^(n)', 'what the controller does not model'))

    @staticmethod
    def labels() -> tuple[str, ...]:
        """Return the field names."""
        return names(Truth.fields())

    def numbers(self) -> tuple[float, ...]:
        """Return the record as its labels name it."""
        return self
