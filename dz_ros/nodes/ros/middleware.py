# SPDX-License-Identifier: Apache-2.0
"""Settings of Fast DDS that the nodes need, where it is the middleware and the user has set none.

Profiles of the writers (`fastdds.xml`), and UDP alone as the transport. Shared memory can hold a
sender up: the first message to a process waits until a thread of that process has shown that it is
alive, which an idle one does every third of a second, and every publisher of the sending process
waits with it. A receiver that is frozen while it holds a lock holds up all its senders.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Environment variables that name a file of profiles for Fast DDS."""
LOCAL_PROFILES = 'DEFAULT_FASTRTPS_PROFILES.xml'
"""File of profiles that Fast DDS takes from the folder in which it is started."""
TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
LOCALHOST_ONLY = 'ROS_LOCALHOST_ONLY'
_FOLDER = Path(__file__).parents[1]


def wishes(environment: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return the environment variables that Fast DDS is to find set.

    Discovery within this machine is a matter of the profile then: rmw_fastrtps has no LOCALHOST
    without shared memory, and with SYSTEM_DEFAULT it leaves the profile as it is. Static peers
    are not in a profile: with them and LOCALHOST shared memory stays.

    Args:
        environment: What the process was started with.
        folder: Where it was started.
    """
    if any(environment.get(name) for name in PROFILES):
        return {}
    found = {PROFILES[0]: str(_FOLDER / 'fastdds.xml')}
    if (environment.get(TRANSPORTS) or 'UDPv4') != 'UDPv4' or (folder / LOCAL_PROFILES).exists():
        return found
    found[TRANSPORTS] = 'UDPv4'
    only = environment.get(LOCALHOST_ONLY) == '1'       # rcl passes over range and peers then
    if only or (environment.get(RANGE) == 'LOCALHOST' and not environment.get('ROS_STATIC_PEERS')):
        found |= {PROFILES[0]: str(_FOLDER / 'fastdds_localhost.xml'), RANGE: 'SYSTEM_DEFAULT',
                  LOCALHOST_ONLY: '0'}
    return found
