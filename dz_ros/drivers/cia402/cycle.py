# SPDX-License-Identifier: Apache-2.0
"""The thread that talks to the drives of a bus in each cycle, so that the loop never waits (ours).

    each command          RPDO of its drive at once
    once in a period      RPDO of every drive, then one SYNC `lead` before the next sample
    each heartbeat        ours, one for all

The phase of the samples is learnt from the times at which they end, `Phase`. A loop that is silent
for `command_hold` while a drive is enabled gets a quick stop, as long as it is silent. A fault of
one drive is a quick stop of each that the loop commands.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import struct
import threading
import time
from typing import TYPE_CHECKING

from dz_ros.drivers.cia402.bus import DriveBus, HEARTBEAT, OPERATIONAL
from dz_ros.drivers.cia402.states import Controlword, DriveState, Goal, Walk
from dz_ros.drivers.phase import Phase

if TYPE_CHECKING:
    from dz_ros.drivers.cia402.shared_bus import SharedBus

_RESET_TIME = 0.05
"""The fault reset is asked for again after this [s]: it is the edge that counts."""


class DriveCycle:
    """What is sent to one drive in each cycle.

    Args:
        drive: The drive.
        cycle: The thread of its bus.

    Attributes:
        drive: The drive.
        walk: The way to the goal.
        silences: How often the loop has been silent for too long.
        round_trips: From each SYNC to its answer [s], since they were last taken.
        fresh: Whether there is something to send at once.
    """

    def __init__(self, drive: DriveBus, cycle: SharedCycle) -> None:
        p = drive.parameters
        self.drive = drive
        self.silences = 0
        self.round_trips: list[float] = []
        self.fresh = False
        self._cycle = cycle
        self._hold = p.command_hold
        self._form = drive.command.form
        self._identifier = drive.command.cob_id(p.node_id)
        self.walk = Walk(p.transition_limit)
        self._goal, self._target, self._watched = Goal.OFF, 0, False
        self._silent = False
        self._resetting = False
        self._loop_at = cycle.clock()

    # From the loop's thread: at once.

    def stop(self) -> None:
        """Send to it no more; with the last drive the thread ends."""
        self._cycle.drop(self)

    def want(self, goal: Goal, target: int | None = None) -> None:
        """Have the drive go for this goal.

        Args:
            goal: Enabled, stopped, or without voltage.
            target: Number of its target object; None: 0, and the loop may be silent.
        """
        with self._cycle.changed:
            self.fresh = self.fresh or target is not None or goal is not self._goal
            self._goal, self._target, self._watched = goal, target or 0, target is not None
            self._loop_at = self._cycle.clock()
            self._cycle.changed.notify()

    @property
    def goal(self) -> Goal:
        """What the drive is wanted to be by now."""
        return self.walk.goal

    @property
    def since(self) -> float:
        """Since when [s]."""
        return self.walk.since

    @property
    def faulty(self) -> bool:
        """Whether the drive has a fault while it is not wanted to be without voltage."""
        return self._goal is not Goal.OFF and bool(self.drive.fault)

    def sample_ended(self, t: float) -> float:
        """Note that a sample ends at loop time t [s]; return when, by the clock [s]."""
        now = self._cycle.clock()
        with self._cycle.changed:
            self._loop_at = now
            return self._cycle.sample_ended(now, t)

    def reset_fault(self, on: bool) -> None:
        """Ask the drive to leave its fault, again and again until `on` is False."""
        with self._cycle.changed:
            self._resetting = on
            self.fresh = True
            self._cycle.changed.notify()

    # From the thread.

    def send_command(self, now: float) -> None:
        """Send the controlword that the state asks for, and the target."""
        drive = self.drive
        with self._cycle.changed:
            goal, target, resetting = self._goal, self._target, self._resetting
            watched = self._watched
            silent = watched and now - self._loop_at > self._hold
            self.silences += silent and not self._silent
            self._silent = silent
        if silent or (goal is Goal.ENABLED and not resetting and (
                drive.fault or (watched and self._cycle.faulty))):
            goal = Goal.SAFE
        self.walk.want(goal, now)
        state = drive.state
        word, wrong = self.walk.look(state, drive.received_at, now)
        if wrong:
            drive.complain(wrong, state not in (DriveState.FAULT, DriveState.REACTING))
        if resetting and state is DriveState.FAULT:
            edge = int(now / _RESET_TIME) % 2 == 0
            word = Controlword.FAULT_RESET if edge else Controlword.DISABLE_VOLTAGE
        if goal is not Goal.ENABLED or state is not DriveState.ENABLED:
            target = 0
        drive.target = target
        drive.send(self._identifier, struct.pack(self._form, word, target))

    def note_round_trip(self) -> None:
        """Take note of how long the answer to the last SYNC took."""
        found = self.drive.measurement
        if found is not None and found.synced_at == self.drive.synced_at:
            self.round_trips.append(found.at - found.synced_at)
            del self.round_trips[:-4096]


class SharedCycle:
    """Sends commands, SYNC and heartbeats of a bus from a thread of its own.

    Args:
        bus: The bus.
        period: T [s].
        clock: Steady clock [s].

    Attributes:
        members: The drives that are sent to.
        ended: Whether the thread has ended, after the last of them.
        changed: Guards what the loop wants, and notifies the thread.
        clock: Steady clock [s].
    """

    def __init__(self, bus: SharedBus, period: float,
                 clock: Callable[[], float] = time.monotonic) -> None:
        p = bus.parameters
        self.clock = clock
        self.changed = threading.Condition()
        self.members: tuple[DriveCycle, ...] = ()
        self.ended = False
        self._bus = bus
        self._lead = min(p.sync_lead, period)
        self._heartbeat_period = p.heartbeat
        self._identifier = HEARTBEAT + p.master_id
        self._phase = Phase(period)
        self._sample = (math.nan, 0.0)
        self._thread = threading.Thread(target=self._run, name='cia402', daemon=True)

    def serve(self, drive: DriveBus) -> DriveCycle:
        """Send to a drive from now on; the first one begins the thread."""
        found = DriveCycle(drive, self)
        with self.changed:
            self.members = (*self.members, found)
        if len(self.members) == 1:
            self._thread.start()
        return found

    def drop(self, member: DriveCycle) -> None:
        """Send to a drive no more; after the last one wait until the thread has ended."""
        with self.changed:
            self.members = tuple(item for item in self.members if item is not member)
            self.ended = not self.members
            self.changed.notify()
        if self.ended and self._thread.is_alive():
            self._thread.join()

    @property
    def faulty(self) -> bool:
        """Whether one of the drives has a fault."""
        return any(member.faulty for member in self.members)

    def sample_ended(self, now: float, t: float) -> float:
        """Note at `now` that a sample ends at loop time t [s], for each drive; return when [s]."""
        if t != self._sample[0]:
            self._sample = (t, self._phase.sample_ended(now, t))
        return self._sample[1]

    def _run(self) -> None:
        next_sync = next_heartbeat = self.clock()
        while True:
            with self.changed:
                due = min(next_sync, next_heartbeat)
                self.changed.wait_for(
                    lambda: self.ended or any(item.fresh for item in self.members),
                    max(0.0, due - self.clock()))
                if self.ended:
                    return
                members = self.members
                fresh = [item for item in members if item.fresh]
                for item in fresh:
                    item.fresh = False
            now = self.clock()
            synced = now >= next_sync
            for item in members if synced else fresh:
                item.send_command(now)
            if synced:
                for item in members:
                    item.note_round_trip()
                self._bus.sync([item.drive for item in members])
                with self.changed:
                    next_sync = self._phase.next(now, self._lead)
            if now >= next_heartbeat:
                self._bus.send(self._identifier, bytes((OPERATIONAL,)))
                next_heartbeat = max(next_heartbeat + self._heartbeat_period, now)
            for item in members:
                item.drive.watch(now)
