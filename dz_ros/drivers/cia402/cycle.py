# SPDX-License-Identifier: Apache-2.0
"""The thread that talks to the drive in each cycle, so that the loop never waits (ours).

    each command          RPDO at once
    once in a period      RPDO, if there was no command, then SYNC `lead` before the next sample
    each heartbeat        ours

The phase of the samples is learnt from the times at which they end, `Phase`. A loop that is silent
for `command_hold` while the drive is enabled gets a quick stop, as long as it is silent.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import struct
import threading
import time

from dz_ros.drivers.cia402.bus import DriveBus, HEARTBEAT, OPERATIONAL
from dz_ros.drivers.cia402.states import Controlword, DriveState, Goal, Walk

_RESET_TIME = 0.05
"""The fault reset is asked for again after this [s]: it is the edge that counts."""


class Phase:
    """When loop time 0 was on the steady clock: early samples are followed, late ones hardly.

    Args:
        period: T [s].
    """

    EARLIER, LATER = 0.3, 0.02
    RESTART = 1.0
    """Loop time that is off by more than this has restarted [s]."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._zero: float | None = None

    def sample_ended(self, now: float, t: float) -> float:
        """Note at `now` that a sample ends at loop time t [s]; return when that was [s]."""
        off = math.inf if self._zero is None else now - t - self._zero
        if self._zero is None or abs(off) > self.RESTART:
            self._zero = now - t
        else:
            self._zero += off * (self.EARLIER if off < 0.0 else self.LATER)
        return self._zero + t

    def next(self, now: float, lead: float) -> float:
        """Return the instant `lead` before a sample that is later than half a period from now."""
        base = now if self._zero is None else self._zero - lead
        return base + (math.floor((now - base) / self._period + 0.5) + 1.0) * self._period


class Cycle:
    """Sends commands, SYNC and heartbeats from a thread of its own.

    Args:
        bus: The drive.
        period: T [s].
        clock: Steady clock [s].

    Attributes:
        walk: The way to the goal.
        silences: How often the loop has been silent for too long.
        round_trips: From each SYNC to its answer [s], since they were last taken.
    """

    def __init__(self, bus: DriveBus, period: float,
                 clock: Callable[[], float] = time.monotonic) -> None:
        p = bus.parameters
        self.silences = 0
        self.round_trips: list[float] = []
        self._bus = bus
        self._period = period
        self._lead = min(p.sync_lead, period)
        self._heartbeat_period = p.heartbeat
        self._hold = p.command_hold
        self._clock = clock
        self._form = bus.command.form
        self._identifier = bus.command.cob_id(p.node_id)
        self.walk = Walk(p.transition_limit)
        self._phase = Phase(period)
        self._changed = threading.Condition()
        self._goal, self._target, self._watched = Goal.OFF, 0, False
        self._fresh = False
        self._silent = False
        self._resetting = False
        self._loop_at = clock()
        self._stop = False
        self._thread = threading.Thread(target=self._run, name='cia402', daemon=True)

    # From the loop's thread: at once.

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and wait until it has."""
        with self._changed:
            self._stop = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()

    def want(self, goal: Goal, target: int | None = None) -> None:
        """Have the drive go for this goal.

        Args:
            goal: Enabled, stopped, or without voltage.
            target: Number of its target object; None: 0, and the loop may be silent.
        """
        with self._changed:
            self._fresh = self._fresh or target is not None or goal is not self._goal
            self._goal, self._target, self._watched = goal, target or 0, target is not None
            self._loop_at = self._clock()
            self._changed.notify()

    @property
    def goal(self) -> Goal:
        """What the drive is wanted to be by now."""
        return self.walk.goal

    @property
    def since(self) -> float:
        """Since when [s]."""
        return self.walk.since

    def sample_ended(self, t: float) -> float:
        """Note that a sample ends at loop time t [s]; return when, by the clock [s]."""
        now = self._clock()
        with self._changed:
            self._loop_at = now
            return self._phase.sample_ended(now, t)

    def reset_fault(self, on: bool) -> None:
        """Ask the drive to leave its fault, again and again until `on` is False."""
        with self._changed:
            self._resetting = on
            self._fresh = True
            self._changed.notify()

    # The thread.

    def _run(self) -> None:
        next_sync = next_heartbeat = self._clock()
        while True:
            with self._changed:
                due = min(next_sync, next_heartbeat)
                self._changed.wait_for(lambda: self._fresh or self._stop,
                                       max(0.0, due - self._clock()))
                if self._stop:
                    return
                fresh, self._fresh = self._fresh, False
            now = self._clock()
            if fresh or now >= next_sync:
                self._send_command(now)
            if now >= next_sync:
                self._note_round_trip()
                self._bus.sync()
                with self._changed:
                    next_sync = self._phase.next(now, self._lead)
            if now >= next_heartbeat:
                self._bus.send(HEARTBEAT + self._bus.parameters.master_id, bytes((OPERATIONAL,)))
                next_heartbeat = max(next_heartbeat + self._heartbeat_period, now)
            self._bus.watch(now)

    def _send_command(self, now: float) -> None:
        """Send the controlword that the state asks for, and the target."""
        with self._changed:
            goal, target, resetting = self._goal, self._target, self._resetting
            silent = self._watched and now - self._loop_at > self._hold
            self.silences += silent and not self._silent
            self._silent = silent
        if silent or (self._bus.fault and goal is Goal.ENABLED and not resetting):
            goal = Goal.SAFE
        self.walk.want(goal, now)
        state = self._bus.state
        word, wrong = self.walk.look(state, self._bus.received_at, now)
        if wrong:
            self._bus.complain(wrong)
        if resetting and state is DriveState.FAULT:
            edge = int(now / _RESET_TIME) % 2 == 0
            word = Controlword.FAULT_RESET if edge else Controlword.DISABLE_VOLTAGE
        if goal is not Goal.ENABLED or state is not DriveState.ENABLED:
            target = 0
        self._bus.target = target
        self._bus.send(self._identifier, struct.pack(self._form, word, target))

    def _note_round_trip(self) -> None:
        """Take note of how long the answer to the last SYNC took."""
        found = self._bus.measurement
        if found is not None and found.synced_at == self._bus.synced_at:
            self.round_trips.append(found.at - found.synced_at)
            del self.round_trips[:-4096]
