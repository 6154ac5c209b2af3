# SPDX-License-Identifier: Apache-2.0
"""A recorded run fed to a live controller: each sample waits for the command to the one before.

Publishes `reference` and `state`, subscribes `command`, all in lockstep, so that nothing is lost
and the controller's numbers do not depend on any speed. A recorder stores the answers. The samples
are those of ``recording/exchanges.py``.
"""

from __future__ import annotations

from pathlib import Path
import time

from dz_ros.core.records import Command, Reference, State
from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.nodes.ros.base import LoopNode
from dz_ros.nodes.ros.parameters import configure
from dz_ros.recording.exchanges import Exchanges
from dz_ros.recording.run_source import open_source

REPEAT_PERIOD = 0.25
"""A state that waits for its command is published again after each of these [s]."""
COMMAND_TIMEOUT = 10.0
"""A command that does not come within this means that the controller is gone [s]."""


class FeedNode(LoopNode):
    """Feeder of one run.

    Raises:
        ConfigurationError: No run given.
        RecordingError: The run cannot be read, or lacks what a controller needs.
    """

    def __init__(self) -> None:
        super().__init__('feed_node')
        self.configuration = configure(self, 'loop')
        path = self.given('run', '', 'directory of the run, or its .mcap')
        namespace = self.given('of', '', 'namespace of the loop in the run; / for the root, '
                               'none = the only one')
        if not path:
            raise ConfigurationError('run', path, 'must be the directory of a run')
        self._exchanges = Exchanges(open_source(Path(path)), namespace or None)
        order = self.configuration.plant.order
        self._publish_reference = self.offer('reference', Reference.labels(order))
        self._publish_state = self.offer('state', State.labels(order))
        self._answered = -1
        self.subscribe('command', Command.labels(), self._on_command)

    def run(self) -> None:
        """Feed the run to its end, or until it is to end.

        Raises:
            LoopError: A command did not come, or the run is not for such a plant.
            RecordingError: The run cannot be read further.
        """
        if not self.wait_for_peers():
            return
        order = self.configuration.plant.order
        for state, reference in self._exchanges:
            if len(state.x) != order or len(reference.x_d) != order + 1:
                raise LoopError(f'the run is of a plant of order {len(state.x)}, the '
                                f'controller is for {self.configuration.plant.name}, order '
                                f'{order}')
            if not self._ask(state, reference):
                break
        self.get_logger().info(f'{self._exchanges.count} samples fed')
        if self._exchanges.carried:
            self.get_logger().info(f'{self._exchanges.carried} references brought to the stamp of '
                                   'a state, as was done then')
        if self._exchanges.foreign:
            self.get_logger().warning(f'{self._exchanges.foreign} messages left out: they are no '
                                      'records of such a loop')
        if self._exchanges.missing:
            self.get_logger().warning(f'{self._exchanges.missing} samples could not be fed: their '
                                      'state or reference is not in the run')

    def _ask(self, state: State, reference: Reference) -> bool:
        """Publish a sample until it is answered; return False if it is to end before."""
        self._answered = -1
        asked = time.monotonic()
        self._publish_reference(reference.numbers())
        while not self.stopping:
            self._publish_state(state.numbers())
            self.spin_until(time.monotonic() + REPEAT_PERIOD, lambda: self._answered == state.seq)
            if self._answered == state.seq:
                return True
            if time.monotonic() - asked > COMMAND_TIMEOUT:
                raise LoopError(f'no command for sample {state.seq} within {COMMAND_TIMEOUT:g} s: '
                                'the controller is gone')
        return False

    def _on_command(self, numbers: tuple[float, ...]) -> None:
        self._answered = Command.from_numbers(numbers).echo_seq
