# SPDX-License-Identifier: Apache-2.0
"""Record of which publishers press the e-stop (ours).

Every `true` is a press, whatever follows it. A publisher holds the e-stop from its `true` to its
own `false`: the release of one does not free what another presses. One that disappears while it
presses cannot release any more; its press ends with the operator's reset, and not before. Where
the middleware does not name the publisher of a message, no `false` releases anything: each
publisher that is there may be the one that presses, until it disappears.

One message may arrive by several subscriptions; it is identified by its publisher and by the
number that the publisher gave it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection

NOT_NUMBERED = 2 ** 64 - 1
"""What a middleware that does not number messages gives instead of a number."""
MAX_REMEMBERED = 4096
"""Publishers, and presses, that are remembered to recognize what was received before."""


class Presses:
    """Presses and releases of the e-stop, by publisher.

    Attributes:
        holders: Publishers whose newest message is a press.
        unknown: Whether a press came whose publisher is not known.
    """

    def __init__(self) -> None:
        self.holders: set[bytes] = set()
        self.unknown = False
        self._newest: OrderedDict[bytes, int] = OrderedDict()
        self._received: OrderedDict[tuple[bytes, int], None] = OrderedDict()

    def receive(self, publisher: bytes | None, number: int, pressed: bool) -> bool:
        """Take a message; return whether it is a press that was not received before.

        Args:
            publisher: Its identity in the middleware, None = not known.
            number: Place of the message among those of its publisher; without it (`NOT_NUMBERED`)
                a press could not be distinguished from its copy, and the publisher does not count.
            pressed: Its content.
        """
        if publisher is None or number == NOT_NUMBERED:
            self.unknown = self.unknown or pressed
            return pressed
        if number > self._newest.get(publisher, -1):
            self._newest[publisher] = number
            if len(self._newest) > MAX_REMEMBERED:
                self._newest.popitem(last=False)
            (self.holders.add if pressed else self.holders.discard)(publisher)
        elif not pressed or (publisher, number) in self._received:
            return False
        # A press that comes after a later message of its publisher was repaired: it counts.
        if pressed:
            self._received[publisher, number] = None
            if len(self._received) > MAX_REMEMBERED:
                self._received.popitem(last=False)
        return pressed

    def held_by(self, present: Collection[bytes]) -> set[bytes]:
        """Return which publishers press, or may press, and forget those that are gone.

        Args:
            present: Publishers of the topic that there are now and whose press is held against
                a reset.
        """
        self.holders.intersection_update(present)
        self.unknown = self.unknown and bool(present)
        return set(present) if self.unknown else set(self.holders)
