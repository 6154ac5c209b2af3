# SPDX-License-Identifier: Apache-2.0
"""When messages came, by a clock that a step of the wall clock does not disturb (ours).

The middleware stamps what arrives with the wall clock, and messages are taken some time later,
many at once. Log times advance with the steady clock, so a stamp is moved by what the two have
drifted apart since the recording began. What came before a step and is taken after it would be off
by the whole step; so a log time never leaves the window in which the message must have come.
"""

from __future__ import annotations

from collections.abc import Iterable

Arrival = tuple[int, str, bytes, int]
"""When it came, topic, bytes, when it was published; times in ns since the epoch."""


class Arrivals:
    """Log times of the messages of one recording.

    Args:
        epoch_ns: The wall's time at zero of the steady clock, when the recording begins [ns].
        now_ns: Steady clock [ns].
    """

    def __init__(self, epoch_ns: int, now_ns: int) -> None:
        self._epoch_ns = epoch_ns
        self._began_ns = now_ns
        self._last: dict[str, int] = {}

    def settle(self, batch: Iterable[Arrival], epoch_ns: int, began_ns: int,
               ended_ns: int) -> list[Arrival]:
        """Return messages with their log times, in the order of their coming.

        Args:
            batch: Messages as stamped by the wall clock, each topic in its order; 0 = not stamped.
            epoch_ns: The wall's time at zero of the steady clock, now [ns].
            began_ns: Steady clock when taking them began [ns].
            ended_ns: Steady clock when it ended [ns].
        """
        shift = self._epoch_ns - epoch_ns
        # What was not there when the last batch was begun came since.
        earliest, latest = self._began_ns + self._epoch_ns, ended_ns + self._epoch_ns
        self._began_ns = began_ns
        found = []
        for received, topic, payload, published in batch:
            came = received + shift if received else latest
            # What was repaired came later than what it held up: a topic stays in its order.
            came = max(min(max(came, earliest), latest), self._last.get(topic, 0))
            self._last[topic] = came
            found.append((came, topic, payload, published))
        found.sort(key=_came)
        return found


def _came(item: Arrival) -> int:
    return item[0]
