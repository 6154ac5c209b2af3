# SPDX-License-Identifier: Apache-2.0
"""One publisher for each topic of the loop on a machine: claims that die with their process.

A claim is a listening socket in Linux's abstract namespace, named after domain and topic. It needs
no file, is released when the process ends however it ends, and lives in the network namespace,
as discovery does. Elsewhere nothing is claimed and nothing is refused.
"""

from __future__ import annotations

import errno
import os
import socket
import struct

MAX_DOMAIN = 232
"""The largest domain whose UDP ports exist."""


class ClaimedError(RuntimeError):
    """Another process holds the claim.

    Attributes:
        pid: Its id; 0 = not known.
        process: The same as text.
    """

    def __init__(self, name: str, pid: int) -> None:
        self.pid = pid
        self.process = f'process {pid}' if pid else 'process not known'
        super().__init__(f'{name} is claimed: {self.process}')


def claim(name: str) -> socket.socket:
    """Return the claim on a name; it is held until the socket is closed or the process ends.

    Raises:
        ClaimedError: Another process holds it.
    """
    holder = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        holder.bind('\0dz_ros/' + name)
        holder.listen(socket.SOMAXCONN)     # each process that is refused stays in its queue
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            return holder
        holder.close()
        raise ClaimedError(name, _holder(name)) from None
    return holder


def domain() -> int:
    """Return the ROS domain of this process.

    Raises:
        ValueError: ROS_DOMAIN_ID is not a domain; the message is one line for users.
    """
    given = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (given.isascii() and given.isdigit() and int(given) <= MAX_DOMAIN):
        raise ValueError(f'ROS_DOMAIN_ID = {given!r}: must be a whole number from 0 to '
                         f'{MAX_DOMAIN} (0 to 101 have free ports on every system)')
    return int(given)


def domain_topic(topic: str) -> str:
    """Return the name to claim for a fully qualified topic in this process's ROS domain."""
    return f'{domain()}{topic}'


def _holder(name: str) -> int:
    """Return the process id of the holder of a claim, 0 if unknown."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect('\0dz_ros/' + name)
            credentials = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        except (OSError, AttributeError):
            return 0
        return int(struct.unpack('3i', credentials)[0])
