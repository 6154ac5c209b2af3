# SPDX-License-Identifier: Apache-2.0
"""Set-up of a process of the loop before it starts; all of it may be refused."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys

PARENT = 'DZ_ROS_PARENT'
"""Environment variable with the process id of the program that started this one, if it did."""
SWITCH_INTERVAL = 2e-4
"""A thread that wakes up waits this long for one that computes [s]; CPython's own is 5 ms."""
_PR_SET_PDEATHSIG = 1
_PR_SET_TIMERSLACK = 29


def end_with_parent() -> None:
    """Let the system send SIGTERM when the program that started this process has ended (Linux).

    Without it a killed parent would leave a loop running that no program stops in order.
    """
    parent = os.environ.get(PARENT, '')
    if not parent.isdigit():
        return
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
    except (AttributeError, OSError):
        return
    if os.getppid() != int(parent):
        os.kill(os.getpid(), signal.SIGTERM)


def settle(collect_garbage: bool = False) -> None:
    """Keep the garbage collector, other threads and the kernel's timer slack out of the loop.

    Objects made so far are frozen and automatic collection is off: a node makes no cycles per
    sample, so nothing accumulates. Timers then wake within a microsecond of their time instead of
    the default 50 (Linux; elsewhere nothing happens). The thread of a device that computes gives
    the interpreter up after `SWITCH_INTERVAL`, not after a whole sample.

    Args:
        collect_garbage: True leaves automatic collection on, for what does make cycles.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()
    if not collect_garbage:
        gc.disable()
    try:
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    except (AttributeError, OSError):
        return
