# SPDX-License-Identifier: Apache-2.0
"""Reading and writing objects of the drive by SDO, with errors that name the remedy (CiA 301)."""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Any

from dz_ros.drivers.cia402.connection import bus_errors
from dz_ros.drivers.cia402.objects import dictionary, Object
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.errors import DriverError

REQUEST, ANSWER = 0x600, 0x580
_ATTEMPTS = 3


class Sdo:
    """The drive's objects; each call waits for its answer, threads for each other.

    Args:
        network: canopen's, connected.
        parameters: Node id and longest wait.
        place: Where the drive is, for messages.

    Attributes:
        missing: Objects that were not needed and that the drive does not have.
    """

    def __init__(self, network: Any, parameters: Cia402Parameters, place: str) -> None:
        from canopen.sdo import SdoClient

        self.missing: list[str] = []
        self._place = place
        self._lock = threading.Lock()
        self._limit = parameters.answer_limit
        self._client = SdoClient(REQUEST + parameters.node_id, ANSWER + parameters.node_id,
                                 dictionary())
        self._client.RESPONSE_TIMEOUT = parameters.answer_limit
        self._client.network = network
        network.subscribe(self._client.tx_cobid, self._client.on_response)

    def read(self, item: Object) -> int:
        """Read an object.

        Raises:
            DriverError: The drive does not answer, or has no such object.
        """
        return int(self._transfer(item, lambda: self._entry(item).raw))

    def read_optional(self, item: Object) -> int | None:
        """Read an object that the drive need not have; then None.

        Raises:
            DriverError: The drive does not answer.
        """
        value = self._try(item, lambda: self._entry(item).raw)
        return None if value is None else int(value)

    def write(self, item: Object, value: int, needed: bool = True) -> None:
        """Write an object; one that is not needed may be missing.

        Raises:
            DriverError: The drive does not answer, or refuses.
        """
        def do() -> None:
            self._entry(item).raw = value
        (self._transfer if needed else self._try)(item, do)

    def look(self, item: Object) -> int | None:
        """Read an object that is no loss if the drive lacks it; then None.

        Raises:
            DriverError: The drive does not answer.
        """
        value, _ = self._ask(item, lambda: self._entry(item).raw)
        return None if value is None else int(value)

    def hold(self, item: Object, value: int) -> int | None:
        """Have the drive hold a value if it can; return what it holds, None if it lacks it.

        What it holds already is not written; what it refuses is found by reading it again.

        Raises:
            DriverError: The drive does not answer.
        """
        held = self.read_optional(item)
        if held is None or held == value:
            return held
        self.offer(item, value)
        return self.look(item)

    def offer(self, item: Object, value: int) -> str:
        """Write an object; return why the drive refuses it, or ''.

        Raises:
            DriverError: The drive does not answer.
        """
        def do() -> None:
            self._entry(item).raw = value
        return self._ask(item, do)[1]

    def _entry(self, item: Object) -> Any:
        found = self._client[item.index]
        return found[item.sub] if hasattr(found, 'keys') else found

    def _transfer(self, item: Object, do: Callable[[], Any]) -> Any:
        """Do a transfer; name what failed. An answer to another's request is waited out."""
        from canopen.sdo import SdoAbortedError, SdoCommunicationError

        for attempt in range(_ATTEMPTS):
            try:
                with self._lock:
                    return do()
            except SdoAbortedError as error:
                raise DriverError(f'{self._place}: {item}: {error}') from error
            except SdoCommunicationError as error:
                if 'No SDO response' in str(error):
                    raise DriverError(f'{self._place}: no answer within {self._limit:g} s: is the '
                                      'drive on, is that its node id and its bit rate?') from None
                if attempt == _ATTEMPTS - 1:
                    raise DriverError(f'{self._place}: {item}: answers what was not asked '
                                      f'({error}): is there another master, or another node with '
                                      'this id?') from None
            except bus_errors() as error:
                raise DriverError(f'{self._place}: the bus does not take frames: {error}'
                                  ) from None
        raise AssertionError

    def _try(self, item: Object, do: Callable[[], Any]) -> Any:
        """Do a transfer that the drive may refuse; then None."""
        value, refusal = self._ask(item, do)
        if refusal:
            self.missing.append(str(item))
        return value

    def _ask(self, item: Object, do: Callable[[], Any]) -> tuple[Any, str]:
        """Do a transfer that the drive may refuse; return what it gives and why not."""
        from canopen.sdo import SdoAbortedError

        try:
            return self._transfer(item, do), ''
        except DriverError as error:
            if not isinstance(error.__cause__, SdoAbortedError):
                raise
            return None, str(error.__cause__)
