# SPDX-License-Identifier: Apache-2.0
"""Managed nodes, as ROS 2 means it, whose parameters may change while they run.

Lifecycle states: unconfigured, inactive, active, finalized, by the services that every managed
node has. `autostart` (default true) configures and activates the node when it starts, so that it
needs no manager. An impossible transition is refused; it does not end the process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Sized
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from dz_ros.core.axes_keys import section_of
from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Level, Report
from dz_ros.errors import DzRosError, LoopError
from dz_ros.nodes.ros.base import LoopNode
from dz_ros.nodes.ros.diagnostics import Diagnostics
from dz_ros.nodes.ros.parameters import configure

MAX_ITEMS = 10_000
"""Numbers, texts or letters of one parameter that is set: while each is checked the loop waits."""
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
        self._error: Exception | None = None
        self._starting = False
        self._accepted: Configuration | None = None
        # rclpy lets the exception of an impossible transition end the executor.
        self._standard_change = self._service_change_state.callback
        self._service_change_state.callback = self._change_state
        self.configuration = configure(self, *sections)
        self._autostart = self.given('autostart', True,
                                     'configure and activate the node when it starts')
        self.diagnostics = Diagnostics(self, self.report)

    def watch_parameters(self) -> None:
        """Let parameters change from now on."""
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)

    @property
    def halted(self) -> bool:
        """Whether the present work is to be left."""
        return self.stopping or not self.active

    @property
    def lifecycle_state(self) -> str:
        """Name of the primary state, or of the transition under way."""
        return str(self._state_machine.current_state[1])

    def run(self) -> None:
        """Start if `autostart`; work while active, serve callbacks otherwise.

        Raises:
            DzRosError: The node cannot start.
        """
        if self._autostart:
            self._start()
        while not self.stopping:
            if not self.active:
                self.spin()
                self.diagnostics.publish_if_due()
            elif self.work():
                return

    def close(self) -> None:
        """Stop in order, then release everything."""
        # What has arrived is served first: the other end may have stopped already.
        self.spin_out()
        if self.lifecycle_state in ('unconfigured', 'inactive', 'active'):
            self.trigger_shutdown()
        super().close()

    # What subclasses do.

    def report(self) -> Report:
        """Return how the node has been since the last report."""
        report = Report()
        report.put('state', self.lifecycle_state)
        report.summarize(Level.OK if self.active else Level.WARN, self.lifecycle_state)
        return report

    def work(self) -> bool:
        """Work until `halted`; return True when all is done."""
        while not self.halted:
            self.spin()
            self.diagnostics.publish_if_due()
        return False

    def set_up(self) -> None:
        """Publish and subscribe to the loop's topics."""

    def on_transition(self, name: str) -> None:
        """Follow a transition: configure, cleanup, activate, deactivate or shutdown."""

    def check_configuration(self, configuration: Configuration) -> None:
        """Check whether the node would run with a configuration.

        Raises:
            DzRosError: It would not.
        """

    def reconfigure(self) -> None:
        """Use `configuration`, which has changed, from now on."""

    # Transitions, as rclpy names them.

    def on_configure(self, _state: LifecycleState) -> Any:
        """Publish and subscribe to the loop's topics."""
        def do() -> None:
            self.set_up()
            self.on_transition('configure')
        return self._attempt(do, self.withdraw)

    def on_cleanup(self, _state: LifecycleState) -> Any:
        """Withdraw from the topics."""
        def do() -> None:
            self.on_transition('cleanup')
            self.withdraw()
        return self._attempt(do)

    def on_activate(self, _state: LifecycleState) -> Any:
        """Begin to work, after what is urgent: stopped where the e-stop was pressed meanwhile."""
        def do() -> None:
            if self.urgent is not None:
                self.urgent()
            self.on_transition('activate')
            self.active = True
        return self._attempt(do)

    def on_deactivate(self, _state: LifecycleState) -> Any:
        """Stop in order."""
        def do() -> None:
            self.active = False
            self.on_transition('deactivate')
            self.flush()
        return self._attempt(do)

    def on_shutdown(self, _state: LifecycleState) -> Any:
        """Stop in order and end the process."""
        def do() -> None:
            self.active = False
            self.on_transition('shutdown')
            self.stopping = True        # what was published is delivered on closing
        return self._attempt(do)

    def _attempt(self, do: Callable[[], None], undo: Callable[[], None] = lambda: None) -> Any:
        """Do it, undo it after an error, which is kept: rclpy would swallow it."""
        try:
            do()
        except DzRosError as error:
            self._error = error
            undo()
            if not self._starting:      # then it is what the process ends with
                self.get_logger().error(str(error))
            return FAILURE
        except Exception as error:
            self._error = error
            self.stopping = True
            raise
        return SUCCESS

    def _start(self) -> None:
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != SUCCESS:
                raise self._error or LoopError(f'{self.get_name()} cannot start')
        self._starting = False

    def _change_state(self, request: Any, response: Any) -> Any:
        """Serve ``~/change_state``; an impossible transition is refused in the response."""
        try:
            return self._standard_change(request, response)
        except (RuntimeError, TypeError, ValueError) as error:
            self.count(f'a transition that is not possible now was asked for: {error}'
                       .split(', at /')[0])
            response.success = False
            return response

    # Parameters.

    def _check_parameters(self, changed: Sequence[Parameter]) -> SetParametersResult:
        """Return whether parameters may take these values, all together."""
        for item in changed:
            if isinstance(item.value, Sized) and len(item.value) > MAX_ITEMS:
                return SetParametersResult(successful=False, reason=f'{item.name} has '
                                           f'{len(item.value)} items: at most {MAX_ITEMS} can be '
                                           'set while the node runs')
        flat = self.configuration.to_flat(*{section_of(item.name) for item in changed})
        values = {item.name: list(item.value) if isinstance(flat.get(item.name), list)
                  and item.value is not None else item.value
                  for item in changed if item.name in flat}
        self._accepted = None
        if not values:
            return SetParametersResult(successful=True)
        try:
            found = self.configuration.replace(**values)
            self.check_configuration(found)
        except DzRosError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if any((len(before.law.initial_memory()), before.law.signal_names)
               != (len(after.law.initial_memory()), after.law.signal_names)
               for before, after in zip(self.configuration.each, found.each, strict=True)):
            return SetParametersResult(successful=False, reason='this would change what the law '
                                       'remembers: stop the loop and start it with that value')
        self._accepted = found
        return SetParametersResult(successful=True)

    def _apply_parameters(self, _changed: Sequence[Parameter]) -> None:
        """Use what was accepted; callbacks come one after the other, so never within a sample."""
        if self._accepted is not None:
            self.configuration, self._accepted = self._accepted, None
            self.reconfigure()
