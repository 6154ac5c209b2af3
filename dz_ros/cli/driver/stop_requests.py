# SPDX-License-Identifier: Apache-2.0
"""The e-stop, and signals, for a verb that drives a device in its own process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
import json
import signal
import threading
import time

from dz_ros.cli.operator import operator
from dz_ros.errors import DriverError
from dz_ros.runtime.os_signals import stop_on_signals, Stopping

START_LIMIT = 20.0
"""The node that receives the e-stop must have started within this [s]."""
POLL = 0.05
"""A reason to stop is noticed within this while the node starts [s]."""


@contextmanager
def stop_on_requests(lockstep: bool, namespace: str) -> Iterator[Stopping]:
    """Yield why to stop: a signal that ends the program, or the e-stop as of `stop_on_estop`.

    Raises:
        DriverError: There is such a reason; or as of `stop_on_estop`.
        KeyboardInterrupt: It is Ctrl-C.
    """
    with stop_on_signals() as stopping, stop_on_estop(stopping, lockstep, namespace):
        try:
            yield stopping
            if stopping.reason:
                raise DriverError(stopping.reason)
        except DriverError as error:
            if stopping.reason == signal.SIGINT.name:
                raise KeyboardInterrupt(str(error).removeprefix(stopping.reason).lstrip('; ')
                                        ) from error
            raise


@contextmanager
def stop_on_estop(stopping: Stopping, lockstep: bool, namespace: str) -> Iterator[None]:
    """Stop when the e-stop is pressed on its topic, where ROS is installed and a device moves.

    Raises:
        DriverError: The node that receives the e-stop does not start.
    """
    if lockstep or find_spec('rclpy') is None:
        yield
        return
    ready = threading.Event()
    with operator('receive_estop', namespace) as process:
        def read() -> None:
            assert process.stdout is not None
            try:
                for line in process.stdout:
                    received = json.loads(line)
                    if received.get('pressed'):
                        stopping.stop('e-stop pressed')
                    elif received.get('subscribed'):
                        ready.set()
            finally:            # however this thread ends
                stopping.stop('the node that receives the e-stop has ended')

        threading.Thread(target=read, name='e-stop', daemon=True).start()
        deadline = time.monotonic() + START_LIMIT
        while not (ready.wait(POLL) or stopping.reason):
            if time.monotonic() > deadline:
                raise DriverError('the node that receives the e-stop has not started within '
                                  f'{START_LIMIT:g} s')
        yield
