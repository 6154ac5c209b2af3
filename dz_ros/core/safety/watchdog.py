# SPDX-License-Identifier: Apache-2.0
"""The watchdog: how old the newest input is that a guard has taken (ours)."""

from __future__ import annotations


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
