"""Guards of what arrives: is it a message to act on, and when did the last such one arrive (ours).

A guard never repairs: a message is taken or not, and each reason is counted. One that is not taken
does not feed the watchdog either, so a stream of bad messages ends like silence: in the safe
command.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import enum
import math

JUMP = 1000
"""A seq that leaps ahead by more than this is not that of the same sender."""
LARGEST_SEQ = 2.0 ** 53
"""Beyond this a float cannot count."""
RIVALS, RIVALRY = 10, 1.0
"""So many messages out of turn within so many seconds are a second sender, if the graph shows
one."""


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


WORDS = ('taken', 'not finite', 'seq is no count', 'repeated', 'same seq, other content',
         'seq jumps back', 'seq leaps ahead', 'stamp from the future', 'answers too old a state')
"""Each `Verdict` in words."""


class SequenceGuard:
    """Judges the messages of one topic by their numbers.

    Attributes:
        counts: Number of messages of each `Verdict`.
        skipped: Messages that never came, by the gaps in seq.
        last: Numbers of the last message taken; empty before the first.
    """

    def __init__(self) -> None:
        self.counts = [0] * len(Verdict)
        self.skipped = 0
        self.last: tuple[float, ...] = ()
        self._out_of_turn: deque[float] = deque(maxlen=RIVALS)

    def judge(self, numbers: Sequence[float], now: float, resync: bool) -> Verdict:
        """Return whether a message is to be taken, and take note of it.

        Args:
            numbers: All its numbers, seq first.
            now: Time of arrival [s].
            resync: True where a sender may have started anew: any seq is then taken.
        """
        numbers = tuple(numbers)
        last = self.last
        if (last and numbers[0] == last[0] + 1.0 and numbers[0] < LARGEST_SEQ
                and math.isfinite(sum(numbers))):
            self.counts[0] += 1         # as it nearly always is; the rest says the same, slower
            self.last = numbers
            return Verdict.TAKEN
        verdict = self._verdict(numbers, resync)
        self.counts[verdict] += 1
        if verdict is Verdict.TAKEN:
            if self.last and numbers[0] > self.last[0] + 1.0:
                self.skipped += int(numbers[0] - self.last[0]) - 1
            self.last = numbers
        elif verdict in (Verdict.BACK, Verdict.JUMP, Verdict.CONFLICT):
            self._out_of_turn.append(now)
        return verdict

    def rivalry(self, now: float) -> bool:
        """Whether so many messages came out of turn lately that two senders are likely."""
        return len(self._out_of_turn) == RIVALS and now - self._out_of_turn[0] < RIVALRY

    def forget_rivals(self) -> None:
        """Begin to count anew."""
        self._out_of_turn.clear()

    def restart(self) -> None:
        """Forget the last message: what is sent again is news."""
        self.last = ()

    def rejected(self) -> dict[str, int]:
        """Return reason → count of the messages not taken."""
        return {WORDS[verdict]: count for verdict, count in enumerate(self.counts)
                if count and verdict != Verdict.TAKEN}

    def _verdict(self, numbers: tuple[float, ...], resync: bool) -> Verdict:
        if not all(map(math.isfinite, numbers)):
            return Verdict.NOT_FINITE
        seq = numbers[0]
        if seq != math.floor(seq) or not 0.0 <= seq < LARGEST_SEQ:
            return Verdict.BAD_SEQ
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


class Watchdog:
    """Age of the newest good input, on whatever steady clock its owner uses.

    Attributes:
        fed: When it was last fed [s]; None = not yet, so nothing is stale.
    """

    def __init__(self) -> None:
        self.fed: float | None = None

    def feed(self, now: float) -> None:
        """Take note of a good input."""
        self.fed = now

    def stop(self) -> None:
        """Expect nothing until the next one."""
        self.fed = None

    def older(self, now: float, limit: float) -> bool:
        """Whether the input is older than a limit [s]; never where the limit is 0."""
        return self.fed is not None and limit > 0.0 and now - self.fed > limit + 1e-9


class FutureGuard:
    """Whether a stamp of another clock runs ahead of this one.

    The smallest difference ever seen between arrival and stamp is the quickest transport. A stamp
    that is ahead of that by more than the tolerance comes from the future. A message must not be
    judged twice.
    """

    def __init__(self) -> None:
        self._offset = math.inf

    def restart(self) -> None:
        """Forget the other clock."""
        self._offset = math.inf

    def ahead(self, stamp: float, now: float, tolerance: float) -> bool:
        """Return whether the stamp lies in the future by more than the tolerance [s]."""
        offset = now - stamp
        if 0.0 < tolerance < self._offset - offset < math.inf:
            return True
        self._offset = min(self._offset, offset)
        return False
