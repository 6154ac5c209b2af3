# SPDX-License-Identifier: Apache-2.0
"""A serial line without hardware: a pseudo-terminal that can be unplugged, cut and disturbed."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import tty

import numpy as np

from dz_ros.errors import DriverError

CHUNK = 4096


class Cable:
    """The device's end of a pseudo-terminal; the driver opens the other end as a port.

    Args:
        link: Path of a symbolic link to the port, '' for none; the port's own name changes with
            each `plug`.
        seed: Of what happens to the bytes.

    Attributes:
        port: Path by which a driver finds it; '' while it is unplugged.
    """

    def __init__(self, link: str, seed: int) -> None:
        self.port = ''
        self._link = Path(link) if link else None
        self._random = np.random.default_rng(seed)
        self._interval, self._open = -1, False
        self._master = -1
        self._slave = -1

    @property
    def plugged(self) -> bool:
        """Whether there is a port."""
        return self._master >= 0

    def fileno(self) -> int:
        """Return the descriptor to wait on; -1 while unplugged."""
        return self._master

    def plug(self) -> None:
        """Make the port appear.

        Raises:
            DriverError: There is something else at the link's place.
        """
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        name = os.ttyname(self._slave)
        if self._link is None:
            self.port = name
            return
        if self._link.exists() and not self._link.is_symlink():
            self.unplug()
            raise DriverError(f'{self._link}: exists and is no symbolic link: choose another name')
        try:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(name)
        except OSError as error:
            self.unplug()
            raise DriverError(f'{self._link}: {error.strerror}') from None
        self.port = str(self._link)

    def unplug(self) -> None:
        """Make the port vanish, as a USB device does: a process that has it open gets an error."""
        if self._link is not None and self.port:
            self._link.unlink(missing_ok=True)
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1
        self.port = ''

    def read(self) -> bytes:
        """Return what the driver has sent, at once."""
        if self.plugged:
            with contextlib.suppress(OSError):
                return os.read(self._master, CHUNK)
        return b''

    def write(self, data: bytes) -> None:
        """Send to the driver; what does not fit, because nothing reads, is lost."""
        if self.plugged and data:
            with contextlib.suppress(OSError):
                os.write(self._master, data)

    # What can happen to bytes on their way.

    def corrupt(self, data: bytes, share: float) -> bytes:
        """Return the data with one bit wrong in this share of its bytes."""
        found = np.frombuffer(data, np.uint8)
        hit = self._random.random(len(found)) < share
        return (found ^ np.where(hit, 1 << self._random.integers(0, 8, len(found)), 0)
                .astype(np.uint8)).tobytes()

    def lose(self, data: bytes, share: float) -> bytes:
        """Return the data without this share of its bytes."""
        found = np.frombuffer(data, np.uint8)
        return found[self._random.random(len(found)) >= share].tobytes()

    def noise(self, count: int) -> bytes:
        """Return as many bytes of nothing in particular."""
        return self._random.integers(0, 256, count, np.uint8).tobytes()

    def open_contact(self, interval: int, share: float) -> bool:
        """Return whether a bad contact is open in an interval of this number, as both ways see."""
        if interval != self._interval:
            self._interval, self._open = interval, bool(self._random.random() < share)
        return self._open
