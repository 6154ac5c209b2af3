# SPDX-License-Identifier: Apache-2.0
"""What the system says of processes: time on a core, memory, children (Linux)."""

from __future__ import annotations

from pathlib import Path


def cpu_ns(pid: int) -> int:
    """Return the time all threads of a process have had a core [ns]."""
    whole = 0
    for task in Path(f'/proc/{pid}/task').iterdir():
        try:
            whole += int((task / 'schedstat').read_text().split()[0])
        except (OSError, IndexError):      # a thread that ended meanwhile
            continue
    return whole


def resident(pid: int) -> int:
    """Return the memory of a process that is in RAM [bytes]."""
    return int(Path(f'/proc/{pid}/statm').read_text().split()[1]) * 4096


def nodes_below(pid: int) -> dict[str, int]:
    """Return the nodes that a process has started, name → process id."""
    found = {}
    for task in Path(f'/proc/{pid}/task').iterdir():
        for child in (task / 'children').read_text().split():
            words = Path(f'/proc/{child}/cmdline').read_bytes().split(b'\0')
            names = [word.decode() for word in words if word.endswith(b'_node')]
            if names:
                found[names[0]] = int(child)
    return found
