# SPDX-License-Identifier: Apache-2.0
"""No sequence of messages, events and times lets a bad command out of either end of the loop."""

import math

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, rule, RuleBasedStateMachine

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.actuator_guard import ActuatorGuard
from dz_ros.core.safety.controller_guard import ControllerGuard
from dz_ros.core.safety.modes import LIFECYCLE, LifecycleState, Mode
from dz_ros.core.safety.settings import SafetySettings
from dz_ros.core.schema import to_dict

T = 0.005
ANY = st.one_of(st.floats(), st.floats(-20.0, 20.0),
                st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0]))
WAIT = st.one_of(st.floats(0.0, 3.5 * T), st.floats(0.0, 30.0), st.just(T))
SEQ = st.one_of(st.integers(-3, 20), st.integers(-2 ** 60, 2 ** 60), ANY)
TRANSITIONS = st.sampled_from(sorted({name for _, name in LIFECYCLE} - {'shutdown'}))


def positive(largest):
    return st.one_of(st.just(0.0), st.floats(1e-3, largest))


SETTINGS = st.builds(
    SafetySettings, safe_command=st.floats(-1.0, 1.0), command_limit=st.one_of(
        st.just(0.0), st.floats(1.0, 50.0)),
    rate_limit=positive(1e4), ramp=positive(2.0), error_limit=positive(100.0),
    theta_limit=positive(100.0), phi_limit=positive(100.0), command_hold=st.integers(0, 5),
    state_hold=st.integers(0, 5), reference_hold=st.integers(0, 20),
    echo_limit=st.integers(0, 30), fault_after=st.sampled_from([0, 20, 80]),
    estimates=st.sampled_from(['keep', 'reset', 'restore']))


class Ends(RuleBasedStateMachine):
    """Both ends of a loop and everything that can happen to them, in any order, at any time."""

    @initialize(limits=SETTINGS, timing=st.sampled_from(['realtime', 'lockstep']),
                law=st.sampled_from(['wang2004', 'pd']))
    def begin(self, limits, timing, law):
        self.now = 0.0
        self.seq = 0
        self.out = []
        self.limits = limits
        self.configuration = Configuration.from_flat({
            'loop.timing': timing, 'controller.law': law,
            **{f'safety.{key}': value for key, value in to_dict(limits).items()}})
        self.controller = ControllerGuard(self.configuration)
        self.actuator = ActuatorGuard(limits, T, timing == 'realtime')
        for name in ('configure', 'activate'):
            self.controller.transition(name)
            self.actuator.transition(name, 0.0)

    def sent(self, answer):
        """Keep what the controller sends, and let it arrive."""
        if answer is None:
            return
        command, _ = answer
        assert all(map(math.isfinite, command.numbers()))
        self.out.append(command.v)
        if self.controller.supervisor.mode is not Mode.RUNNING:
            assert command.v == self.controller.controller.limiter.settings.safe_command
        self.held(self.actuator.command(command.numbers(), self.seq, self.now))

    def held(self, v):
        if v is not None:
            self.out.append(v)

    @rule(wait=WAIT)
    def time_passes(self, wait):
        self.now += wait
        self.sent(self.controller.poll(self.now))
        found = self.actuator.poll(self.now)
        if found is not None:
            self.held(found[0])
            assert found[1] <= self.now + 1e-9

    @rule(x=st.floats(-3.0, 3.0), speed=st.floats(-4.0, 4.0), x_d=st.floats(-3.0, 3.0))
    def a_good_sample(self, x, speed, x_d):
        self.time_passes(T)
        self.seq += 1
        self.controller.reference((self.seq, self.now, x_d, 0.0, 0.0), self.now)
        self.any_state((self.seq, self.now, x, speed, self.seq - 1.0, self.now, 0.0))

    @rule(numbers=st.tuples(SEQ, ANY, ANY, ANY, ANY, ANY, ANY))
    def any_state(self, numbers):
        state = self.controller.take(numbers, self.now)
        if state is not None and self.controller.ready(state):
            before = self.controller.controller.memory
            self.sent(self.controller.answer(state, self.now))
            if not self.controller.supervisor.running:
                earlier = self.controller.controller
                assert earlier.memory in (before, earlier._earlier)

    @rule(numbers=st.tuples(SEQ, ANY, ANY, ANY, ANY))
    def any_reference(self, numbers):
        self.controller.reference(numbers, self.now)

    @rule(numbers=st.tuples(SEQ, ANY, ANY, SEQ, ANY, ANY))
    def any_command(self, numbers):
        self.held(self.actuator.command(numbers, self.seq, self.now))

    @rule(v=ANY, echo=st.integers(-1, 3))
    def a_well_formed_command(self, v, echo):
        last = self.actuator.guard.last[0] if self.actuator.guard.last else -1.0
        self.held(self.actuator.command(
            (last + 1.0, self.now, v, max(self.seq - echo, -1), self.now, 0.0), self.seq,
            self.now))

    @rule(pressed=st.booleans())
    def estop(self, pressed):
        self.sent(self.controller.estop(pressed))
        self.held(self.actuator.estop(self.now, pressed))
        if pressed:
            assert self.controller.supervisor.mode is Mode.ESTOP
            assert self.actuator.supervisor.mode is Mode.ESTOP
            assert self.actuator.output == self.actuator.limiter.settings.safe_command

    @rule()
    def reset(self):
        for end, arguments in ((self.controller, (self.now,)), (self.actuator, (self.now,))):
            was = end.supervisor.mode
            refused = end.reset(*arguments)
            assert (end.supervisor.mode is was) if refused else not end.supervisor.latched

    @rule(name=TRANSITIONS)
    def transition(self, name):
        for end in (self.controller, self.actuator):
            latched = end.supervisor.latched
            if (end.supervisor.lifecycle_state, name) not in LIFECYCLE:
                continue
            if end is self.controller:
                for answer in end.transition(name):
                    self.sent(answer)
            else:
                self.held(end.transition(name, self.now))
            assert end.supervisor.latched == latched

    @rule(limit=st.floats(1.0, 50.0), gain=st.floats(0.1, 1e6))
    def other_gains_and_limits(self, limit, gain):
        changed = self.configuration.replace(**{'safety.command_limit': limit,
                                                'controller.k_d': gain})
        self.limits = changed.safety
        self.controller.configure(changed)
        self.actuator.configure(changed.safety)

    @rule()
    def the_other_end_stops(self):
        self.controller.end()
        self.held(self.actuator.end(self.now))

    @invariant()
    def nothing_bad_has_left(self):
        for v in getattr(self, 'out', ()):
            assert math.isfinite(v)
            assert self.limits.command_limit == 0.0 or abs(v) <= self.limits.command_limit
        if hasattr(self, 'out'):
            self.out.clear()
            assert all(map(math.isfinite, self.controller.controller.memory))
            if not self.actuator.supervisor.running:
                assert self.actuator.output == self.actuator.limiter.settings.safe_command
            assert self.actuator.supervisor.lifecycle_state is not LifecycleState.FINALIZED


TestEnds = Ends.TestCase
TestEnds.settings = settings(max_examples=6 * settings.default.max_examples // 10,
                             stateful_step_count=60, deadline=None)
