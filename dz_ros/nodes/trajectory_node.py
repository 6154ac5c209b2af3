"""The trajectory generator as a node: the reference of the next sample, before it is needed.

Publishes `reference`, subscribes `state` as its clock: when state k arrives it sends the reference
for the stamp of sample k + 1, so the controller need not wait for it. The loop has one clock, the
plant's; if states stop, so does the reference.
"""

from __future__ import annotations

from dz_ros.core.records import Reference, State
from dz_ros.core.safety.guards import SequenceGuard, Verdict
from dz_ros.core.safety.health import Rejections, Report
from dz_ros.nodes.managed import ManagedNode

CATCH_UP = 100
"""References of states that never came here are sent late, up to so many, to leave no gap."""
LAST = 1e9
"""Stamps beyond this are none [s]."""


class TrajectoryNode(ManagedNode):
    """Trajectory generator."""

    def __init__(self) -> None:
        super().__init__('trajectory_node', 'loop', 'structure', 'trajectory')
        self._trajectory = self.configuration.trajectory
        self._period = self.configuration.loop.period
        self._order = self.configuration.plant.order
        self._guard = SequenceGuard()
        self._sent = -1
        self._rejections = Rejections()
        self.watch_parameters()

    def report(self) -> Report:
        """Return how the generator has been since the last report."""
        report = super().report()
        report.put('newest reference', self._sent, 'd')
        report.put('states lost', self._guard.skipped, 'd')
        self._rejections.report(report, {f'state: {reason}': count for reason, count
                                         in self._guard.rejected().items()})
        return report

    def set_up(self) -> None:
        """Offer references; listen to states only when everybody is there."""
        self._publish_reference = self.offer('reference', Reference.labels(self._order))
        self._listening = False
        self.announce('trajectory', seq=self._sent + 1)

    def reconfigure(self) -> None:
        """Follow another trajectory of the same kind from the next reference on."""
        self._trajectory = self.configuration.trajectory
        self.announce('trajectory', seq=self._sent + 1)

    def work(self) -> bool:
        """Follow the states while active."""
        if not self.wait_for_peers():
            return False
        if not self._listening:
            self._listening = True
            self.take('state', State.labels(self._order), self._on_state)
        return super().work()

    def _on_state(self, numbers: tuple[float, ...]) -> None:
        """Send the reference for the next sample, and those before it that were not sent."""
        verdict = self._guard.judge(numbers, 0.0, resync=True)
        if not self.active or verdict not in (Verdict.TAKEN, Verdict.REPEATED):
            return
        state = State.from_numbers(numbers)
        if abs(state.stamp) > LAST:
            return
        if state.seq + 1 == self._sent:     # asked again: what was sent may not have arrived
            self._sent = state.seq - 1
        sample = round(state.stamp / self._period)
        first = self._sent + 1 if 0 <= state.seq - self._sent < CATCH_UP else state.seq
        for seq in range(first, state.seq + 2):
            stamp = (sample + seq - state.seq) * self._period
            try:
                x_d = self._trajectory(stamp)
            except (ArithmeticError, ValueError) as error:
                self.count(f'no reference for t = {stamp:g} s: {error}')
                return
            self._publish_reference((seq, stamp, *x_d))
        self._sent = state.seq + 1
