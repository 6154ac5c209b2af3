# SPDX-License-Identifier: Apache-2.0
"""Guards of what arrives: is it a message to act on (ours).

A guard never repairs: a message is taken or not, and each reason is counted. One that is not taken
does not feed the watchdog either, so a stream of bad messages ends like silence: in the safe
command.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
import enum
import math

from dz_ros.core.records import SEQ_LIMIT, State

JUMP = 1000
"""A seq that leaps ahead by more than this is not that of the same sender."""
AHEAD = 1000
"""A reference further ahead of the newest state is from the future [samples]: those sent ahead in
lockstep are some hundred, and one that is far ahead would hide that no others arrive."""
LARGEST_STAMP = 1e9
"""A loop does not run for 30 years: stamps beyond this are none [s]."""
STATE_ECHO = State.labels(0).index('echo_seq') - len(State.labels(0))
"""Place of echo_seq in a state of any order, from the end."""
FEW = 4
"""Stamps of another clock, fewer than which may all have come late."""
RIVALS, RIVALRY = 10, 1.0
"""Messages out of turn within this duration [s] are a second sender, if the graph shows one."""


class Verdict(enum.IntEnum):
    """Why a message is not taken; TAKEN = it is."""

    TAKEN = 0
    NOT_FINITE = 1
    BAD_SEQ = 2
    REPEATED = 3
    CONFLICT = 4
    BACK = 5
    JUMP = 6
    FUTURE = 7
    OLD = 8
    BAD_STAMP = 9
    BAD_ECHO = 10


TAKEN, REPEATED = Verdict.TAKEN, Verdict.REPEATED
"""What every sample is compared with: before Python 3.12, to ask an enumeration costs a call."""
WORDS = ('taken', 'not finite', 'seq is no count', 'repeated', 'same seq, other content',
         'seq jumps back', 'seq leaps ahead', 'stamp from the future', 'answers too old a state',
         'stamp is no loop time', 'echo_seq is no count')
"""Each `Verdict` as text."""


def plausible(numbers: Sequence[float], echo: int | None = None) -> bool:
    """Return whether the numbers of a message can be a record at all, whatever came before.

    Args:
        numbers: seq, stamp, and the rest.
        echo: Place of echo_seq among them; None = there is none.
    """
    return not _implausible(tuple(numbers), echo)


def _implausible(numbers: tuple[float, ...], echo: int | None) -> Verdict:
    """Return why numbers are no record; `Verdict.TAKEN` where they may be one."""
    if not all(map(math.isfinite, numbers)):
        return Verdict.NOT_FINITE
    seq = numbers[0]
    if seq != math.floor(seq) or not 0.0 <= seq < SEQ_LIMIT:
        return Verdict.BAD_SEQ
    if abs(numbers[1]) > LARGEST_STAMP:
        return Verdict.BAD_STAMP
    if echo is not None:
        seq = numbers[echo]
        if seq != math.floor(seq) or not -1.0 <= seq < SEQ_LIMIT:
            return Verdict.BAD_ECHO
    return Verdict.TAKEN


class SequenceGuard:
    """Judges the messages of one topic by their numbers.

    Args:
        echo: Place of echo_seq among the numbers, from the end if negative; None = there is none.
        axes: Names of the axes whose rows the numbers are; empty: one, without a name.

    Attributes:
        counts: Number of messages of each `Verdict`.
        skipped: Messages that never came, by the gaps in seq.
        last: Numbers of the last message taken; empty before the first.
    """

    def __init__(self, echo: int | None = None, axes: Sequence[str] = ()) -> None:
        self.counts = [0] * len(Verdict)
        self._axes = axes
        self._bad_axes: Counter[str] = Counter()
        self._echo = echo
        self.skipped = 0
        self.last: tuple[float, ...] = ()
        self._out_of_turn: deque[float] = deque(maxlen=RIVALS)

    def judge(self, numbers: Sequence[float], now: float, resync: bool) -> Verdict:
        """Return whether a message is to be taken, and take note of it.

        Args:
            numbers: All its numbers, seq first.
            now: Time of arrival [s].
            resync: True where a sender may have restarted: any seq is then taken.
        """
        numbers = tuple(numbers)
        last = self.last
        if (last and numbers[0] == last[0] + 1.0 and numbers[0] < SEQ_LIMIT
                and math.isfinite(sum(numbers)) and abs(numbers[1]) <= LARGEST_STAMP
                and (self._echo is None or (numbers[self._echo] % 1.0 == 0.0
                     and -1.0 <= numbers[self._echo] < SEQ_LIMIT))):
            self.counts[0] += 1         # as it nearly always is; the rest does the same, slower
            self.last = numbers
            return TAKEN
        verdict = self._verdict(numbers, resync)
        self.counts[verdict] += 1
        if verdict is Verdict.TAKEN:
            if self.last and numbers[0] > self.last[0] + 1.0:
                self.skipped += int(numbers[0] - self.last[0]) - 1
            self.last = numbers
        elif verdict in (Verdict.BACK, Verdict.JUMP, Verdict.CONFLICT):
            self._out_of_turn.append(now)
        elif verdict is Verdict.NOT_FINITE and len(self._axes) > 1:
            place = next(i for i, item in enumerate(numbers) if not math.isfinite(item))
            self._bad_axes[self._axes[place * len(self._axes) // len(numbers)]] += 1
        return verdict

    def rivalry(self, now: float) -> bool:
        """Whether enough messages came out of turn lately for two senders to be likely."""
        return len(self._out_of_turn) == RIVALS and now - self._out_of_turn[0] < RIVALRY

    def forget_rivals(self) -> None:
        """Begin to count again."""
        self._out_of_turn.clear()

    def restart(self) -> None:
        """Forget the last message: what is sent again is news."""
        self.last = ()

    def rejected(self) -> dict[str, int]:
        """Return reason → count of the messages not taken."""
        return {WORDS[verdict]: count for verdict, count in enumerate(self.counts)
                if count and verdict != Verdict.TAKEN and not (
                    verdict == Verdict.NOT_FINITE and self._bad_axes)} | {
            f'{WORDS[Verdict.NOT_FINITE]} (axis {axis})': count
            for axis, count in self._bad_axes.items()}

    def _verdict(self, numbers: tuple[float, ...], resync: bool) -> Verdict:
        bad = _implausible(numbers, self._echo)
        if bad:
            return bad
        seq = numbers[0]
        if not self.last:
            return Verdict.TAKEN
        if seq == self.last[0]:
            return Verdict.REPEATED if numbers == self.last else (
                Verdict.TAKEN if resync else Verdict.CONFLICT)
        if resync:
            return Verdict.TAKEN
        if seq < self.last[0]:
            return Verdict.BACK
        return Verdict.JUMP if seq > self.last[0] + JUMP else Verdict.TAKEN


class ReferenceGuard(SequenceGuard):
    """Judges references, at either end of the loop, by the newest state as well.

    Args:
        period: Of the loop [s].
        axes: As of `SequenceGuard`.
    """

    def __init__(self, period: float, axes: Sequence[str] = ()) -> None:
        super().__init__(axes=axes)
        self._period = period

    def early(self, reference: float, state: float) -> bool:
        """Whether a reference's stamp lies further ahead of a state's than any that is sent."""
        return reference > state + AHEAD * self._period

    def takes(self, numbers: Sequence[float], now: float, state: float, resync: bool) -> bool:
        """Return whether a reference is to be taken, and take note of it.

        Args:
            numbers: All its numbers.
            now: Time of arrival [s].
            state: Stamp of the newest state [s]; infinite before the first.
            resync: True where a sender may have restarted: any seq is then taken.
        """
        if self.early(numbers[1], state) and plausible(numbers):
            self.counts[Verdict.FUTURE] += 1    # its seq is none to go by either
            return False
        return self.judge(numbers, now, resync) is TAKEN


class FutureGuard:
    """Whether a stamp of another clock runs ahead of this one.

    The smallest difference ever seen between arrival and stamp is the quickest transport. A stamp
    that is ahead of that by more than the tolerance comes from the future. Right after a restart
    the few before it may have come late themselves, because their sender had stalled: where the
    next one confirms it, they did. A message must not be judged twice.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forget the other clock."""
        self._offset = self._refused = math.inf
        self._taken = 0

    def ahead(self, stamp: float, now: float, tolerance: float) -> bool:
        """Return whether the stamp lies in the future by more than the tolerance [s]."""
        offset = now - stamp
        if 0.0 < tolerance < self._offset - offset < math.inf:
            confirmed = self._taken < FEW and abs(offset - self._refused) <= tolerance
            self._refused = offset
            if not confirmed:
                return True
        self._offset, self._refused = min(self._offset, offset), math.inf
        self._taken += 1
        return False
