"""The records that flow offline, over topics, into recordings and back out.

Immutable values. Each carries ``seq`` (count of samples from 0) and ``stamp`` (loop time of the
sample in seconds, 0 at the first one). The field names of a record, in the order in which its
numbers travel, come from its ``labels`` and nowhere else: topic label, MCAP channel and plot
column are encodings of it. They are named tuples: a sample makes three of them, in a third of the
time that frozen dataclasses take.
"""

from __future__ import annotations

from collections.abc import Sequence
import enum
from typing import NamedTuple

TERM_NAMES = ('s', 's_eps', 'u_fd', 'v_damping', 'v_feed_forward', 'v_regressor', 'v_robust',
              'v_extra')
"""What every law reports of a step, in this order, before its status and its own signals."""

STATUS = len(TERM_NAMES)
"""Place of the law's status bits in the buffer a law's kernel writes; its signals follow."""


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
    def labels(order: int) -> tuple[str, ...]:
        """Return the field names for a plant of this order."""
        return ('seq', 'stamp', *(f'xd{i}' for i in range(order + 1)))

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
        moved = []
        for i in range(len(self.x_d)):
            value, factor = 0.0, 1.0
            for j in range(i, len(self.x_d)):
                value += self.x_d[j] * factor
                factor *= ahead / (j - i + 1)
            moved.append(value)
        return Reference(self.seq, stamp, tuple(moved))


class State(NamedTuple):
    """Measured state of the plant.

    Attributes:
        seq: Count of samples.
        stamp: Loop time of the measurement [s].
        x: x, x', …, x^(n−1), shape (n,).
        echo_seq: seq of the newest command received before it; −1 = none.
        echo_stamp: stamp of that command [s].
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
    def labels(order: int) -> tuple[str, ...]:
        """Return the field names for a plant of this order."""
        return ('seq', 'stamp', *(f'x{i}' for i in range(order)), 'echo_seq', 'echo_stamp',
                'round_trip')

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
        seq: Count of commands.
        stamp: Loop time for which it was computed [s].
        v: Command, before the dead-zone, in the actuator's unit.
        echo_seq: seq of the state it answers.
        echo_stamp: stamp of that state [s].
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
    def labels() -> tuple[str, ...]:
        """Return the field names."""
        return ('seq', 'stamp', 'v', 'echo_seq', 'echo_stamp', 'hold')

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
        seq: seq of the command they explain.
        stamp: Loop time for which it was computed [s].
        values: The numbers named by `TERM_NAMES`, shape (8,).
        dt: Interval by which adaptation advanced [s]; 0 = frozen.
        status: Why it was frozen, `Status` bits.
        reference_seq: seq of the reference used.
        echo_seq: seq of the state answered.
        signals: The law's own numbers (θ̂, φ̂ as used in v, …), shape as its ``signal_names``.
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
    def labels(signal_names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the field names for a law with these signals."""
        return ('seq', 'stamp', *TERM_NAMES, 'dt', 'status', 'reference_seq', 'echo_seq',
                *signal_names)

    def numbers(self) -> tuple[float, ...]:
        """Return the record as its labels name it."""
        return (self.seq, self.stamp, *self.values, self.dt, self.status,
                self.reference_seq, self.echo_seq, *self.signals)


class Truth(NamedTuple):
    """What only a simulated plant knows.

    Attributes:
        seq: seq of the state it belongs to.
        stamp: Its stamp [s].
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
    def labels() -> tuple[str, ...]:
        """Return the field names."""
        return ('seq', 'stamp', 'w', 'd', 'disturbance')

    def numbers(self) -> tuple[float, ...]:
        """Return the record as its labels name it."""
        return self
