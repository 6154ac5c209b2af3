# SPDX-License-Identifier: Apache-2.0
"""The other side of the state machine: a drive's response to controlwords and faults (CiA 402).

`Device` is a drive without bus, motor or clock: controlwords and faults go in, state and
statusword come out. The simulated drive is built on it, and the driver is tested against it.
"""

from __future__ import annotations

from dz_ros.drivers.cia402.states import (
    DriveState,
    FOLLOWS,
    INTERNAL_LIMIT,
    REMOTE,
    STATUS,
    TARGET_REACHED,
    VOLTAGE,
)

_PATTERN = {state: pattern for state, _, pattern in STATUS}
_POWERED = (DriveState.READY, DriveState.SWITCHED_ON, DriveState.ENABLED, DriveState.QUICK_STOP,
            DriveState.REACTING)


class Device:
    """State machine of a drive.

    Attributes:
        state: Its state.
        quick_stop_code: Object 605Ah: 0 to 2 end without voltage, 5 and 6 stay.
        stuck: A fault that a reset does not clear.
        error_code: Object 603Fh.
        standing: Whether the axis stands; the owner of the motor sets it.
        limited: Whether the drive clips its target.
        fault_reaction: Object 605Eh: 0 lets the axis coast.
        abort_connection: Object 6007h: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop.
        local: Operated at the drive itself: no controlword is obeyed.
    """

    def __init__(self) -> None:
        self.state = DriveState.NOT_READY
        self.quick_stop_code = 2
        self.fault_reaction = 2
        self.abort_connection = 1
        self.local = False
        self.stuck = False
        self.error_code = 0
        self.standing = True
        self.limited = False
        self._word = 0

    def boot(self) -> None:
        """Do the transitions a drive does by itself after it was switched on (0, 1)."""
        self.state = DriveState.DISABLED
        self.error_code = self._word = 0
        self.quick_stop_code, self.fault_reaction, self.abort_connection = 2, 2, 1

    def control(self, word: int) -> None:
        """Take a controlword: at most one transition."""
        if self.local:
            return
        rising = word & ~self._word
        self._word = word
        if self.state is DriveState.FAULT:
            if rising & 0x80 and not self.stuck:
                self.state, self.error_code = DriveState.DISABLED, 0
            return
        if self.state in (DriveState.NOT_READY, DriveState.REACTING):
            return
        if not word & 0x02:                                     # disable voltage: 7, 9, 10, 12
            self.state = DriveState.DISABLED
        elif not word & 0x04:                                   # quick stop: 7, 10, 11
            if self.state is DriveState.ENABLED:
                self.state = DriveState.QUICK_STOP
            elif self.state is not DriveState.QUICK_STOP:
                self.state = DriveState.DISABLED
        elif self.state is DriveState.QUICK_STOP:
            if word & 0x0F == 0x0F and self.quick_stop_code >= 5:   # 16
                self.state = DriveState.ENABLED
        elif not word & 0x01:                                   # shutdown: 2, 6, 8
            self.state = DriveState.READY
        elif self.state is DriveState.READY:                    # switch on: 3
            self.state = DriveState.SWITCHED_ON
        elif self.state in (DriveState.SWITCHED_ON, DriveState.ENABLED):    # 4, 5
            self.state = DriveState.ENABLED if word & 0x08 else DriveState.SWITCHED_ON

    def fault(self, code: int) -> None:
        """Begin the reaction to a fault: transition 13."""
        if self.state not in (DriveState.REACTING, DriveState.FAULT):
            self.state, self.error_code = DriveState.REACTING, code

    def lose_connection(self, code: int) -> bool:
        """React to a lost connection as 6007h defines; return whether by a fault (13)."""
        if self.state not in _POWERED or self.abort_connection == 0:
            return False
        if self.abort_connection == 1:
            self.fault(code)
            return True
        if self.abort_connection == 2:
            self.state = DriveState.DISABLED
        elif self.state is DriveState.ENABLED:
            self.state = DriveState.QUICK_STOP
        return False

    def drop(self) -> None:
        """Lose the voltage without a fault, as by a safe-torque-off input."""
        if self.state in _POWERED:
            self.state = DriveState.DISABLED

    def settle(self) -> None:
        """Do the transitions that wait for the axis to stand (12, 14)."""
        if self.state is DriveState.REACTING and (self.standing or not self.fault_reaction):
            self.state = DriveState.FAULT
        elif self.state is DriveState.QUICK_STOP and (
                self.quick_stop_code == 0 or (self.quick_stop_code < 5 and self.standing)):
            self.state = DriveState.DISABLED

    @property
    def statusword(self) -> int:
        """The statusword now."""
        word = _PATTERN[self.state] | (0 if self.local else REMOTE)
        if self.state in _POWERED:
            word |= VOLTAGE
        if self.state is DriveState.ENABLED:
            word |= FOLLOWS | (INTERNAL_LIMIT if self.limited else 0)
        if self.state is DriveState.QUICK_STOP and self.standing:
            word |= TARGET_REACHED
        return word
