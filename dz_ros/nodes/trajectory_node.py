# SPDX-License-Identifier: Apache-2.0
"""The trajectory generator as a node: the reference of the next sample, before it is needed.

Publishes `reference`, subscribes `state` as its clock: after state k it sends the reference for
the stamp of sample k + 1, so the controller need not wait for it. It does so a third of a period
later (``runtime/phase_offset.py``): at once, it would keep the controller from the core it
needs. The loop has one clock, the plant's; if states stop, so does the reference. In lockstep
the references are sent many samples ahead, so that a step need not wait for a third process, and
the clock is `pace`, which comes once in some samples; a trajectory changed meanwhile is
followed after those.
"""

from __future__ import annotations

import sys
import time

from dz_ros.core.records import Reference, State
from dz_ros.core.safety.health import Rejections, Report
from dz_ros.core.safety.message_guards import SequenceGuard, STATE_ECHO, Verdict
from dz_ros.nodes.ros.lifecycle import ManagedNode
from dz_ros.nodes.ros.topics import PACE
from dz_ros.runtime.phase_offset import PhaseOffset

MAX_LATE_REFERENCES = 100
"""References of states that were lost here are sent late, up to this number, to leave no gap."""
REFERENCES_AHEAD = 100
"""References sent ahead in lockstep when the plant publishes where it is."""
OFFSET_PERIODS = (0.002, 0.05)
"""In real time the next reference is made with a phase offset for periods within these [s]."""


class TrajectoryNode(ManagedNode):
    """Trajectory generator."""

    def __init__(self) -> None:
        super().__init__('trajectory_node', 'loop', 'structure', 'trajectory')
        self._trajectories = [item.trajectory for item in self.configuration.each]
        self._period = self.configuration.loop.period
        self._order = self.configuration.plant.order
        self._guard = SequenceGuard(None if self.lockstep else STATE_ECHO)
        self._sent = -1
        loop = self.configuration.loop
        self._end = loop.samples + 1 if loop.duration > 0.0 else sys.maxsize
        self._rejections = Rejections()
        self._phase_offset = (PhaseOffset(self._period) if not self.lockstep
                              and OFFSET_PERIODS[0] <= self._period <= OFFSET_PERIODS[1] else None)
        self.watch_parameters()

    def report(self) -> Report:
        """Return how the generator has been since the last report."""
        report = super().report()
        report.put('newest reference', self._sent, 'd')
        if not self.lockstep:
            report.put('states lost', self._guard.skipped, 'd')
        topic = 'pace' if self.lockstep else 'state'
        self._rejections.report(report, self.ignored({topic: self._guard.rejected()}))
        return report

    def set_up(self) -> None:
        """Publish references; subscribe states only when all peers are there."""
        self._publish_reference = self.offer('reference', Reference.labels(self._order))
        self._subscribed_state = False
        self.announce('trajectory', seq=self._sent + 1)

    def reconfigure(self) -> None:
        """Follow another trajectory of the same kind from the next reference on."""
        self._trajectories = [item.trajectory for item in self.configuration.each]
        self.announce('trajectory', seq=self._sent + 1)

    def work(self) -> bool:
        """Follow the states while active."""
        # The first subscriber is served first, and the controller is in more of a hurry.
        if not self.wait_for_peers(lambda: self.not_subscribing('state', ('controller_node',))):
            return False
        if not self._subscribed_state:
            self._subscribed_state = True
            if self.lockstep:
                self.subscribe('pace', PACE, self._follow)
            else:
                self.subscribe('state', State.labels(self._order), self._follow)
        while not self.halted:
            self.spin()
            self.diagnostics.publish_if_due()
            if self._phase_offset is not None:
                self._phase_offset.rest()
        return False

    def _follow(self, numbers: tuple[float, ...]) -> None:
        """Send what is wanted where the loop is (seq, stamp, …), and what was not sent before."""
        now = time.monotonic()
        verdict = self._guard.judge(numbers, 0.0, resync=True)
        if not self.active or verdict not in (Verdict.TAKEN, Verdict.REPEATED):
            return
        newest, now_stamp = int(numbers[0]), numbers[1]
        if self._phase_offset is not None:
            self._phase_offset.received(now_stamp, now)
        first, after = self._wanted(newest, verdict)
        sample = round(now_stamp / self._period)
        for seq in range(first, after):
            stamp = (sample + seq - newest) * self._period
            try:
                rows = [trajectory(stamp) for trajectory in self._trajectories]
            except (ArithmeticError, ValueError) as error:
                self.count('no reference', f'for t = {stamp:g} s: {error}')
                self._sent = seq - 1
                return
            self._publish_reference([number for x_d in rows for number in (seq, stamp, *x_d)])

    def _wanted(self, seq: int, verdict: Verdict) -> tuple[int, int]:
        """Return the first reference to send now that the loop is at `seq`, and the one after."""
        ahead = self._sent - seq
        if not self.lockstep:
            first = self._sent + 1 if -MAX_LATE_REFERENCES < ahead <= 0 else seq
            self._sent = seq + 1
            return first, seq + 2
        first = self._sent + 1 if -MAX_LATE_REFERENCES < ahead <= REFERENCES_AHEAD else seq
        if verdict is Verdict.REPEATED:     # what was sent may not have arrived
            first = seq
        self._sent = max(min(seq + REFERENCES_AHEAD, self._end), seq + 1)
        return first, self._sent + 1
