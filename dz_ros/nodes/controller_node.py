"""The controller as a node: answers each state at once with a command.

Publishes `command` and `terms`, subscribes `reference` and, once everybody who listens to its
commands is there, `state`. The twin without ROS is ``core/controller.py``.
"""

from __future__ import annotations

import time

from rcl_interfaces.msg import ParameterDescriptor

from dz_ros.core.controller import Controller
from dz_ros.core.records import Command, Reference, State, Terms
from dz_ros.errors import LoopError
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.parameters import configure
from dz_ros.nodes.progress import Progress
from dz_ros.nodes.start_checks import refuse_bad_design

GONE_NS = 5_000_000_000
"""In lockstep, a reference that does not come within this means that its sender is gone [ns]."""


class ControllerNode(LoopNode):
    """Adaptive controller, or any other law."""

    def __init__(self) -> None:
        super().__init__('controller_node')
        self.configuration = configure(self, 'loop', 'structure', 'controller')
        refuse_bad_design(self, self.configuration)
        self._controller = Controller(self.configuration)
        self._order = self.configuration.plant.order
        self._publish_command = self.offer('command', Command.labels())
        self._publish_terms = self.offer(
            'terms', Terms.labels(self.configuration.law.signal_names))
        self._waiting: tuple[State, int] | None = None
        rate = self.declare_parameter('progress_rate', 0.0, ParameterDescriptor(
            read_only=True, description='lines of progress a second on standard output, as '
            'JSON, for the program that started this node; 0 = none [Hz]')).value
        self._progress = Progress(self.configuration, rate) if rate > 0.0 else None
        self.take('reference', Reference.labels(self._order), self._on_reference)
        # From this command on, with this memory: all a reader needs to recompute the run.
        self.announce('controller', seq=0, memory=self._controller.memory)

    def run(self) -> None:
        """Answer states until told to end.

        Raises:
            LoopError: In lockstep, a reference did not come.
        """
        if not self.wait_for_peers():
            return
        self.take('state', State.labels(self._order), self._on_state)
        while not self.stopping:
            self.spin()
            if self.lockstep and self._waiting is not None:
                state, taken_ns = self._waiting
                if time.monotonic_ns() - taken_ns > GONE_NS:
                    raise LoopError(f'no reference for sample {state.seq} within '
                                    f'{GONE_NS * 1e-9:g} s: the trajectory is gone')
        self.event('finished', ignored=self._controller.ignored)

    def _on_reference(self, numbers: tuple[float, ...]) -> None:
        self._controller.set_reference(Reference.from_numbers(numbers))
        if self._waiting is not None and self._ready(self._waiting[0]):
            state, taken_ns = self._waiting
            self._waiting = None
            self._answer(state, taken_ns)

    def _on_state(self, numbers: tuple[float, ...]) -> None:
        taken_ns = time.monotonic_ns()
        state = State.from_numbers(numbers)
        if self._ready(state):
            self._answer(state, taken_ns)
        else:
            self._waiting = (state, taken_ns)

    def _ready(self, state: State) -> bool:
        """Whether a state can be answered: in lockstep it waits for its very own reference."""
        if self.lockstep:
            return self._controller.has_reference_for(state)
        return self._controller.has_reference

    def _answer(self, state: State, taken_ns: int) -> None:
        answer = self._controller.respond(state)
        if answer is None:
            return
        command, terms = answer
        if self._progress is not None:
            self._progress.sample(state, terms, self._controller.error, command.v, taken_ns)
        hold = 0.0 if self.lockstep else (time.monotonic_ns() - taken_ns) * 1e-9
        self._publish_command((*command.numbers()[:-1], hold))
        self._publish_terms(terms.numbers())
