"""The records that flow offline, over topics, into recordings and back out.

Immutable values. Each carries ``seq`` (count of samples from 0) and ``stamp`` (loop time of the
sample in seconds, 0 at the first one). The field names of a record, in the order in which its
numbers travel, come from its ``labels`` and nowhere else: topic label, MCAP channel and plot
column are encodings of it.
"""

from __future__ import annotations

from dataclasses import dataclass
import enum

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


@dataclass(frozen=True)
class Reference:
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


@dataclass(frozen=True)
class State:
    """Measured state of the plant.

    Attributes:
        seq: Count of samples.
        stamp: Loop time of the measurement [s].
        x: x, x', …, x^(n−1), shape (n,).
        echo_seq: seq of the newest command received before it; −1 = none.
        echo_stamp: stamp of that command [s].
    """

    seq: int
    stamp: float
    x: tuple[float, ...]
    echo_seq: int = -1
    echo_stamp: float = 0.0

    @staticmethod
    def labels(order: int) -> tuple[str, ...]:
        """Return the field names for a plant of this order."""
        return ('seq', 'stamp', *(f'x{i}' for i in range(order)), 'echo_seq', 'echo_stamp')


@dataclass(frozen=True)
class Command:
    """What the controller asks of the actuator.

    Attributes:
        seq: Count of commands.
        stamp: Loop time for which it was computed [s].
        v: Command, before the dead-zone, in the actuator's unit.
        echo_seq: seq of the state it answers.
        echo_stamp: stamp of that state [s].
    """

    seq: int
    stamp: float
    v: float
    echo_seq: int = -1
    echo_stamp: float = 0.0

    @staticmethod
    def labels() -> tuple[str, ...]:
        """Return the field names."""
        return ('seq', 'stamp', 'v', 'echo_seq', 'echo_stamp')


@dataclass(frozen=True)
class Terms:
    """Every term of the law in one sample.

    Attributes:
        seq: seq of the state answered.
        stamp: Its stamp [s].
        values: The numbers named by `TERM_NAMES`, shape (8,).
        dt: Interval by which adaptation advanced [s]; 0 = frozen.
        status: Why it was frozen, `Status` bits.
        signals: The law's own numbers (θ̂, φ̂ as used in v, …), shape as its ``signal_names``.
    """

    seq: int
    stamp: float
    values: tuple[float, ...]
    dt: float
    status: Status
    signals: tuple[float, ...] = ()

    @staticmethod
    def labels(signal_names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the field names for a law with these signals."""
        return ('seq', 'stamp', *TERM_NAMES, 'dt', 'status', *signal_names)


@dataclass(frozen=True)
class Truth:
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
