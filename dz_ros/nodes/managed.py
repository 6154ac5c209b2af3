"""Managed nodes, as ROS 2 means it, whose parameters may change while they run.

Life: unconfigured, inactive, active, finalized, by the services that every managed node has.
`autostart` (default true) configures and activates the node when it starts, so that it needs no
manager. An impossible transition is refused; it does not end the process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Level, Report
from dz_ros.errors import DzRosError, LoopError
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.diagnosing import Diagnosing
from dz_ros.nodes.parameters import configure

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ManagedNode(LifecycleNodeMixin, LoopNode):
    """A managed node of the loop; subclasses fill in what the transitions do.

    Args:
        name: Default node name.
        *sections: Sections of the configuration that the node declares as parameters.

    Attributes:
        active: Whether the node is active.
    """

    def __init__(self, name: str, *sections: str) -> None:
        LoopNode.__init__(self, name)
        LifecycleNodeMixin.__init__(self)
        self.active = False
        self._problem: Exception | None = None
        self._starting = False
        self._judged: Configuration | None = None
        # rclpy lets the exception of an impossible transition end the executor.
        self._standard_change = self._service_change_state.callback
        self._service_change_state.callback = self._change_state
        self.configuration = configure(self, *sections)
        self._autostart = self.declare_parameter('autostart', True, ParameterDescriptor(
            read_only=True, description='configure and activate the node when it starts')).value

        self.diagnosing = Diagnosing(self, self.report)

    def report(self) -> Report:
        """Return how the node has been since the last report."""
        report = Report()
        life = self._state_machine.current_state[1]
        report.put('state', life)
        report.say(Level.OK if self.active else Level.WARN, life)
        return report

    def watch_parameters(self) -> None:
        """Let parameters change from now on."""
        self.add_on_set_parameters_callback(self._judge)
        self.add_post_set_parameters_callback(self._apply)

    @property
    def halted(self) -> bool:
        """Whether the present work is to be left."""
        return self.stopping or not self.active

    def run(self) -> None:
        """Start by oneself if that is wanted; work while active, serve callbacks otherwise.

        Raises:
            DzRosError: The node cannot start.
        """
        if self._autostart:
            self._start()
        while not self.stopping:
            if not self.active:
                self.spin()
                self.diagnosing.look()
            elif self.work():
                return

    def close(self) -> None:
        """Stop in order, then release everything."""
        # What has arrived is heard first: the other end may have stopped already.
        self.spin_out()
        if self._state_machine.current_state[1] in ('unconfigured', 'inactive', 'active'):
            self.trigger_shutdown()
        super().close()

    # What subclasses do.

    def work(self) -> bool:
        """Work until `halted`; return True when all is done."""
        while not self.halted:
            self.spin()
            self.diagnosing.look()
        return False

    def set_up(self) -> None:
        """Offer topics and listen to them."""

    def change_life(self, name: str) -> None:
        """Hear of a transition of the life: configure, cleanup, activate, deactivate, shutdown."""

    def vet(self, configuration: Configuration) -> None:
        """Look whether the node would run with a configuration.

        Raises:
            DzRosError: It would not.
        """

    def reconfigure(self) -> None:
        """Use `configuration`, which has changed, from now on."""

    # Transitions, as rclpy names them.

    def on_configure(self, _state: LifecycleState) -> Any:
        """Offer topics and listen to them."""
        def do() -> None:
            self.set_up()
            self.change_life('configure')
        return self._attempt(do, self.withdraw)

    def on_cleanup(self, _state: LifecycleState) -> Any:
        """Withdraw from the topics."""
        def do() -> None:
            self.change_life('cleanup')
            self.withdraw()
        return self._attempt(do)

    def on_activate(self, _state: LifecycleState) -> Any:
        """Begin to work."""
        def do() -> None:
            self.change_life('activate')
            self.active = True
        return self._attempt(do)

    def on_deactivate(self, _state: LifecycleState) -> Any:
        """Stop in order."""
        def do() -> None:
            self.active = False
            self.change_life('deactivate')
            self.flush()
        return self._attempt(do)

    def on_shutdown(self, _state: LifecycleState) -> Any:
        """Stop in order and end the process."""
        def do() -> None:
            self.active = False
            self.change_life('shutdown')
            self.stopping = True        # what was published is delivered on closing
        return self._attempt(do)

    def _attempt(self, do: Callable[[], None], undo: Callable[[], None] = lambda: None) -> Any:
        """Do it, undo it after an error, which is kept: rclpy would swallow it."""
        try:
            do()
        except DzRosError as error:
            self._problem = error
            undo()
            if not self._starting:      # then it is what the process ends with
                self.get_logger().error(str(error))
            return FAILURE
        except Exception as error:
            self._problem = error
            self.stopping = True
            raise
        return SUCCESS

    def _start(self) -> None:
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != SUCCESS:
                raise self._problem or LoopError(f'{self.get_name()} cannot start')
        self._starting = False

    def _change_state(self, request: Any, response: Any) -> Any:
        """Serve ``~/change_state``; an impossible transition is refused in the response."""
        try:
            return self._standard_change(request, response)
        except RuntimeError as error:
            self.count(f'a transition that is not possible now was asked for: {error}'
                       .split(', at /')[0])
            response.success = False
            return response

    # Parameters.

    def _judge(self, changed: Sequence[Parameter]) -> SetParametersResult:
        """Say whether parameters may take these values, all together."""
        flat = self.configuration.to_flat()
        values = {item.name: list(item.value) if isinstance(flat.get(item.name), list)
                  and item.value is not None else item.value
                  for item in changed if item.name in flat}
        self._judged = None
        if not values:
            return SetParametersResult(successful=True)
        try:
            found = self.configuration.replace(**values)
            self.vet(found)
        except DzRosError as error:
            return SetParametersResult(successful=False, reason=str(error))
        before, after = self.configuration.law, found.law
        if (len(before.initial_memory()), before.signal_names) != (len(after.initial_memory()),
                                                                  after.signal_names):
            return SetParametersResult(successful=False, reason='this would change what the law '
                                       'remembers: stop the loop and start it with that value')
        self._judged = found
        return SetParametersResult(successful=True)

    def _apply(self, _changed: Sequence[Parameter]) -> None:
        """Use what was judged; callbacks come one after the other, so never within a sample."""
        if self._judged is not None:
            self.configuration, self._judged = self._judged, None
            self.reconfigure()
