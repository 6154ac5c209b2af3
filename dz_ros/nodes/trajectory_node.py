"""The trajectory generator as a node: the reference of the next sample, before it is needed.

Publishes `reference`, subscribes `state` as its clock: when state k arrives it sends the reference
for the stamp of sample k + 1, so the controller need not wait for it. The loop has one clock, the
plant's; if states stop, so does the reference.
"""

from __future__ import annotations

from dz_ros.core.records import Reference, State
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.parameters import configure

CATCH_UP = 100
"""References of states that never came here are sent late, up to so many, to leave no gap."""


class TrajectoryNode(LoopNode):
    """Trajectory generator."""

    def __init__(self) -> None:
        super().__init__('trajectory_node')
        self.configuration = configure(self, 'loop', 'structure', 'trajectory')
        self._trajectory = self.configuration.trajectory
        self._period = self.configuration.loop.period
        self._order = self.configuration.plant.order
        self._publish_reference = self.offer('reference', Reference.labels(self._order))
        self._sent = -1
        self.announce('trajectory')

    def run(self) -> None:
        """Follow the states until told to end."""
        if not self.wait_for_peers():
            return
        self.take('state', State.labels(self._order), self._on_state)
        super().run()

    def _on_state(self, numbers: tuple[float, ...]) -> None:
        """Send the reference for the next sample, and those before it that were not sent."""
        state = State.from_numbers(numbers)
        if state.seq + 1 == self._sent:
            return
        sample = round(state.stamp / self._period)
        first = self._sent + 1 if 0 <= state.seq - self._sent < CATCH_UP else state.seq
        for seq in range(first, state.seq + 2):
            stamp = (sample + seq - state.seq) * self._period
            self._publish_reference((seq, stamp, *self._trajectory(stamp)))
        self._sent = state.seq + 1
