# SPDX-License-Identifier: Apache-2.0
"""Connecting to a CAN bus, for the driver and for the simulated drive."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import logging
import time
from typing import Any

from dz_ros.drivers.cia402.settings import Cia402Parameters
from dz_ros.errors import DriverError, MissingDependencyError

NOTIFIER_CYCLE = 0.1
"""canopen's receiving thread looks whether it shall end this often [s]."""


def bus_errors() -> tuple[type[Exception], ...]:
    """Return what sending and receiving may raise when a bus has gone."""
    import can

    return (can.CanError, OSError, RuntimeError)


def connect(p: Cia402Parameters, *listeners: Any) -> Any:
    """Return a canopen network on the bus the parameters name.

    Args:
        p: Interface, channel, bit rate, options.
        *listeners: Further listeners of python-can.

    Raises:
        MissingDependencyError: canopen or python-can is not installed.
        DriverError: There is no such bus.
    """
    try:
        import can  # noqa: F401
        import canopen
    except ImportError as error:
        raise MissingDependencyError(f"driver.name = 'cia402' needs {error.name}: pip install "
                                     "'dz_ros[cia402]'") from None
    for name in ('can', 'canopen'):     # what they log comes back to us as errors
        logger = logging.getLogger(name)
        if not logger.handlers:
            logger.addHandler(logging.NullHandler())
    network = canopen.Network()
    network.NOTIFIER_CYCLE = NOTIFIER_CYCLE
    network.listeners[:] = [_standard_frames(network), *listeners]
    refusals: tuple[type[Exception], ...] = (*bus_errors(), ValueError, TypeError, ImportError)
    try:
        network.connect(interface=p.interface, channel=p.channel, bitrate=p.bitrate, **p.options)
    except refusals as error:
        reason = ' '.join(str(error.__cause__ or error).split()) or type(error).__name__
        raise DriverError(f'no CAN bus at driver.interface = {p.interface!r}, driver.channel = '
                          f'{p.channel!r}: {reason}') from None
    return network


def share(network: Any) -> Any:
    """Return another canopen network on the bus of one that is connected, with its own receivers.

    The bus is that of `network`, which alone is disconnected; `unshare` ends the other.
    """
    import canopen

    found = canopen.Network(network.bus)
    found.notifier, found.send_lock = network.notifier, network.send_lock
    found.listeners[:] = [_standard_frames(found)]
    network.notifier.add_listener(found.listeners[0])
    return found


def unshare(shared: Any) -> None:
    """Receive no more for what `share` returned."""
    with suppress(ValueError):
        shared.notifier.remove_listener(shared.listeners[0])


def _standard_frames(network: Any) -> Any:
    """Return canopen's receiver for frames of 11 bits alone: it mixes them with those of 29."""
    receiver: Any = type(network.listeners[0])

    class StandardFrames(receiver):     # type: ignore[misc]
        def on_message_received(self, msg: Any) -> None:
            if not msg.is_extended_id:
                super().on_message_received(msg)

    return StandardFrames(network)


class Watcher:
    """Receives error frames and failures of the receiving thread.

    python-can calls listeners with each message, and `on_error` with what ends its thread.
    """

    def __init__(self, frame: Callable[[int], None],
                 failure: Callable[[BaseException], None]) -> None:
        self._frame = frame
        self._failure = failure

    def __call__(self, message: Any) -> None:
        """Take a message."""
        if message.is_error_frame:
            self._frame(message.arbitration_id)

    def on_error(self, error: Exception) -> None:
        """Note that receiving failed; it is tried again a little later."""
        self._failure(error)
        time.sleep(NOTIFIER_CYCLE)
