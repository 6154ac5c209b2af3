# SPDX-License-Identifier: Apache-2.0
"""Deadlines of the messages of a run; the ROS-free part of ``nodes/replay_node.py``.

A message logged at t is due at

    start + (t − t_first) / rate

on the steady clock, an absolute deadline: lateness of one message never moves another. Messages
keep the order of their recording, same times included; where the log's clock stepped back, a
message is due with the one before it. The anchor of that line moves only by a pause, a
seek or another rate.

The run is streamed, `READ_AHEAD` messages at a time, so it may be larger than memory. A lap of a
loop begins where the one before it ended.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
import math
import time
from typing import NamedTuple

from dz_ros.core.lateness import LATE
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.recording.messages import Message

READ_AHEAD = 1000
"""Messages kept ready."""
LATE_NS = round(LATE * 1e9)
RATES = (1e-6, 1e9)
"""Allowed rates."""
_SHORTEST_LAP_NS = 1_000_000
"""A lap takes at least this long, also where all its messages have the same time."""

Batches = Iterable[Sequence[Message]]


class _Due(NamedTuple):
    """A message that waits: its time with all laps before it added, those laps, itself."""

    time: int
    laps: int
    message: Message


class Player:
    """Plays one run; nothing moves before `begin`.

    Args:
        open_batches: Returns the messages of the run, some at a time; those before the first one
            as late as its argument [ns since the epoch] may be left out.
        rate: How many times faster than recorded; > 0.
        start: Offset at which to begin, from the first message of the run [s]; >= 0.
        duration: Length of what is played, in recorded time [s]; 0 = to the end.
        loop: Begin again at the end, for ever.
        topics: Names of the topics played; None = all.
        paused: Begin paused.
        clock: Steady clock [ns].

    Attributes:
        paused: Whether time stands still.
        rate: See above.
        first_ns: Log time of the run's first message, of whatever topic [ns since the epoch].
        played: Messages taken.
        late: Messages taken more than `LATE_NS` after their deadline.
        worst_ns: Largest lateness [ns].

    Raises:
        ConfigurationError: A rate, start or duration that cannot be.
        RecordingError: Nothing of the run would be played.
    """

    def __init__(self, open_batches: Callable[[int], Batches], *, rate: float = 1.0,
                 start: float = 0.0, duration: float = 0.0, loop: bool = False,
                 topics: Container[str] | None = None, paused: bool = False,
                 clock: Callable[[], int] = time.monotonic_ns) -> None:
        for name, value in (('start', start), ('duration', duration)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigurationError(name, value, 'must be a number of seconds >= 0')
        self._open = open_batches
        self._topics = topics
        self._loop = loop
        self._clock = clock
        self.rate = checked_rate(rate)
        self.paused = paused
        self.played = self.late = self.worst_ns = 0
        self.first_ns = next((message.log_time for batch in open_batches(0) for message in batch),
                             0)
        self._start = self.first_ns + round(start * 1e9)
        self._limit = self._start + round(duration * 1e9) if duration else None
        self._queue: deque[_Due] = deque()
        self._ended = self._begun = False
        self._laps = 0
        self._anchor_time = self._start
        self._anchor_ns = 0
        self._stream = self._items(self._start)
        self._fill()
        if not self._queue:
            raise RecordingError(f'nothing to play: no message of the chosen topics from {start:g}'
                                 f' s on{f", for {duration:g} s" if duration else ""}')

    def begin(self) -> None:
        """Let time run from now on, unless paused."""
        self._anchor_ns = self._clock()
        self._begun = True

    @property
    def finished(self) -> bool:
        """Whether everything was taken and the player is not paused."""
        return self._ended and not self._queue and not self.paused

    @property
    def low(self) -> bool:
        """Whether `read_ahead` should be called when there is time for it."""
        return len(self._queue) < READ_AHEAD and not self._ended

    def read_ahead(self) -> None:
        """Read some messages, what one chunk of the file holds.

        Raises:
            RecordingError: The run cannot be read further.
        """
        found = next(self._stream, None)
        if found is None:
            self._ended = True
        else:
            self._queue.extend(found)

    @property
    def due_ns(self) -> int | None:
        """Deadline of the next message on the steady clock [ns]; None while there is none."""
        if self._stands or not self._queue:
            return None
        return self._anchor_ns + round((self._queue[0].time - self._anchor_time) / self.rate)

    def take(self) -> Message | None:
        """Return the next message if its time has come."""
        due, now = self.due_ns, self._clock()
        if due is None or due > now:
            return None
        self.late += now - due > LATE_NS
        self.worst_ns = max(self.worst_ns, now - due)
        return self._pop()

    def step(self) -> Message | None:
        """Return the next message of a paused player, whose time becomes the message's.

        Returns:
            None where it is not paused or nothing is left.
        """
        if not self.paused:
            return None
        while not self._queue and not self._ended:
            self.read_ahead()
        if not self._queue:
            return None
        self._anchor_time = max(self._anchor_time, self._queue[0].time)
        return self._pop()

    def pause(self) -> None:
        """Let time stand still."""
        if not self.paused:
            self._anchor_time = self._time()
            self.paused = True

    def resume(self) -> None:
        """Let time run again."""
        if self.paused:
            self.paused = False
            self._anchor_ns = self._clock()

    def set_rate(self, rate: float) -> None:
        """Change the rate from now on.

        Raises:
            ConfigurationError: It is none.
        """
        rate = checked_rate(rate)
        self._anchor_time = self._time()
        self._anchor_ns = self._clock()
        self.rate = rate

    def seek(self, time_ns: int) -> bool:
        """Go to an instant: what is logged from then on comes next.

        Args:
            time_ns: Time of the log [ns since the epoch]; before the run means its beginning.

        Returns:
            Whether any message to be played lies there.

        Raises:
            RecordingError: The run cannot be read.
        """
        time_ns = max(time_ns, self.first_ns)
        self._queue.clear()
        self._laps = 0
        self._ended = False
        self._stream = self._items(time_ns)
        self._fill()
        self._anchor_time = time_ns
        self._anchor_ns = self._clock()
        return bool(self._queue)

    @property
    def time_ns(self) -> int:
        """Where the player is, in the time of the log [ns since the epoch]."""
        return self._time() - self._laps

    @property
    def offset(self) -> float:
        """The same from the run's first message on [s]."""
        return (self.time_ns - self.first_ns) * 1e-9

    @property
    def _stands(self) -> bool:
        return self.paused or not self._begun

    def _time(self) -> int:
        """Return where the player is, with the laps before added [ns]."""
        if self._stands:
            return self._anchor_time
        return self._anchor_time + round((self._clock() - self._anchor_ns) * self.rate)

    def _fill(self) -> None:
        """Read until `READ_AHEAD` messages are ready or the run ends."""
        while self.low:
            self.read_ahead()

    def _pop(self) -> Message:
        """Return the next message as played."""
        _, self._laps, message = self._queue.popleft()
        self.played += 1
        return message

    def _items(self, begin: int) -> Iterator[list[_Due]]:
        """Yield what is to be played from a time of the log on, lap by lap, some at a time."""
        laps = 0
        while True:
            played = over = False
            now = 0
            for batch in self._open(begin):
                found = []
                for message in batch:
                    now = max(now, message.log_time)
                    if self._limit is not None and now > self._limit:
                        now, over = self._limit, True
                        break
                    if now >= begin and (self._topics is None or message.topic in self._topics):
                        found.append(_Due(now + laps, laps, message))
                played = played or bool(found)
                yield found
                if over:
                    break
            if not self._loop or not (played or begin > self._start):
                return
            laps += max(max(now, begin) - self._start, _SHORTEST_LAP_NS)
            begin = self._start


def checked_rate(rate: float) -> float:
    """Return a rate.

    Raises:
        ConfigurationError: It is none.
    """
    low, high = RATES
    if not low <= rate <= high:
        raise ConfigurationError('rate', rate, f'must be a number from {low:g} to {high:g}')
    return float(rate)
