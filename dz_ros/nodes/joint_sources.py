# SPDX-License-Identifier: Apache-2.0
"""Publishers of one joint's state, distinguished by what their messages carry (ours).

Several broadcasters may share `/joint_states`, each with joints of its own. Two that publish
states of one joint (a `joint_state_publisher` beside the broadcaster) must not be mixed: their
messages are two streams. A stream goes on where the middleware's number of the publication goes up
by a little, by one where the fields change; where the middleware has none, where the message has
the same fields and a later stamp.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

JUMP = 1000
"""A publication number that is higher by more belongs to another publisher."""
SWITCH = 0.5
"""Time without its messages after which another publisher takes a publisher's place [s]."""


@dataclass
class Stream:
    """Messages of one publisher.

    Attributes:
        form: What all its messages have in common.
        number: Number of the newest one, rising.
        numbered: Whether that is the middleware's count of publications.
        received: When it came [s].
    """

    form: Hashable
    number: int
    numbered: bool
    received: float

    def goes_on(self, form: Hashable, number: int, numbered: bool) -> bool:
        """Return whether a message can be its next."""
        if numbered != self.numbered:
            return False
        if numbered:        # the very next one may have its joints in another order
            return 0 < number - self.number <= (JUMP if form == self.form else 1)
        return form == self.form and (number >= self.number or number == 0)


class JointSources:
    """The streams of the last seconds, and whose messages are taken.

    Args:
        memory: Duration without messages after which a stream is forgotten [s].
    """

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._streams: list[Stream] = []
        self._latest: Stream | None = None
        self._taken: Stream | None = None
        self._mixed_at = -memory

    def take(self, form: Hashable, number: int | None, stamp: int, now: float) -> bool:
        """Return whether a message is of the publisher whose messages are taken.

        Args:
            form: What all messages of one publisher have in common.
            number: Publication number; None where the middleware has none.
            stamp: Its header's stamp [ns], 0 = none.
            now: When it came [s].
        """
        self._streams = [item for item in self._streams if now - item.received <= self._memory]
        numbered, count = number is not None, stamp if number is None else number
        found = max((item for item in self._streams if item.goes_on(form, count, numbered)),
                    key=lambda item: item.number, default=None)
        if found is None:
            found = Stream(form, count, numbered, now)
            self._streams.append(found)
        elif found is not self._latest:     # it goes on after another has begun
            self._mixed_at = now
        found.number, found.received = count or found.number, now
        self._latest = found
        taken = self._taken
        if taken is None or now - taken.received > SWITCH:
            self._taken = found
        return found is self._taken

    def mixed(self, now: float) -> bool:
        """Return whether two publishers sent states of the joint within the memory."""
        return now - self._mixed_at <= self._memory and len(self._streams) > 1
