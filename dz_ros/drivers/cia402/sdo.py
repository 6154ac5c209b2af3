"""Reading and writing objects of the drive by SDO, with errors that say what to do (CiA 301)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dz_ros.drivers.cia402.connection import bus_errors
from dz_ros.drivers.cia402.objects import dictionary, Object
from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.errors import DriverError

REQUEST, ANSWER = 0x600, 0x580


class Sdo:
    """The drive's objects; each call waits for its answer.

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

    def _entry(self, item: Object) -> Any:
        found = self._client[item.index]
        return found[item.sub] if hasattr(found, 'keys') else found

    def _transfer(self, item: Object, do: Callable[[], Any]) -> Any:
        """Do a transfer; say what failed."""
        from canopen.sdo import SdoAbortedError, SdoCommunicationError

        try:
            return do()
        except SdoAbortedError as error:
            raise DriverError(f'{self._place}: {item}: {error}') from error
        except SdoCommunicationError:
            raise DriverError(f'{self._place}: no answer within {self._limit:g} s: is the drive '
                              'on, is that its node id and its bit rate?') from None
        except bus_errors() as error:
            raise DriverError(f'{self._place}: the bus does not take frames: {error}') from None

    def _try(self, item: Object, do: Callable[[], Any]) -> Any:
        """Do a transfer that the drive may refuse; then None."""
        from canopen.sdo import SdoAbortedError

        try:
            return self._transfer(item, do)
        except DriverError as error:
            if not isinstance(error.__cause__, SdoAbortedError):
                raise
            self.missing.append(str(item))
            return None
