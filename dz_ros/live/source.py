# SPDX-License-Identifier: Apache-2.0
"""What a page shows: a running loop or recorded runs, as the server sees either."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from dz_ros.errors import LoopError
from dz_ros.live.history import History


class Source(ABC):
    """Something to show.

    Attributes:
        history: Rows that are sent to every viewer as they come.
    """

    history: History

    @property
    def stops(self) -> int:
        """Number of e-stops so far."""
        return 0

    def still(self, stops: int) -> None:
        """Go on only if the number of e-stops is still `stops`.

        Raises:
            LoopError: One has.
        """
        if self.stops != stops:
            raise LoopError('cancelled: an e-stop was pressed after this was asked')

    def of_axis(self, axis: str) -> Source | None:  # noqa: ARG002 - of those that keep them apart
        """Return what a viewer that asks for an axis is shown; None = there is no such axis.

        What can be stopped is shown whatever the address of the page asks for: its e-stop must be
        within reach. So only a source that keeps its axes apart refuses one.

        Args:
            axis: Name of the axis; '' = the viewer asks for none.
        """
        return self

    @abstractmethod
    def hello(self) -> dict[str, Any]:
        """Return what a page must know first: columns, units, parameters, what it may do."""

    def now(self) -> list[dict[str, Any]]:
        """Return the messages with state and events for a new viewer."""
        return []

    def estop(self, viewer: str) -> dict[str, Any]:
        """Stop the loop at once.

        Raises:
            LoopError: There is nothing to stop.
        """
        raise LoopError(f'nothing runs here that {viewer} could stop')

    async def act(self, viewer: str, request: dict[str, Any], stops: int) -> dict[str, Any]:
        """Do what an operator asks; return what came of it: `ok` and `message`.

        Args:
            viewer: Name of the viewer that asks.
            request: What.
            stops: `stops` when it was accepted; a later e-stop cancels what is not done yet.

        Raises:
            DzRosError: It cannot be done, and why.
        """
        self.still(stops)
        raise LoopError(f'nothing runs here: {request.get("do")} by {viewer} changes nothing')

    @abstractmethod
    async def ask(self, request: dict[str, Any]) -> bytes | dict[str, Any]:
        """Return the numbers or the text that a viewer asks for.

        Raises:
            DzRosError: There are none.
        """
