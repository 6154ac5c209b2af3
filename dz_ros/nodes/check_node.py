# SPDX-License-Identifier: Apache-2.0
"""The conformance kit's second half: a driver's node against docs/topics.md, from outside.

It takes the controller's place, of several axes for one of them, answers states with small
commands, then provokes: bad messages, silence, a commander that restarts, the e-stop, a commander
that goes and comes back. It needs nothing but the topics; where the node also publishes `events`,
`truth` or diagnostics, these show what the actuator does; where it does not, that is reported as
unseen. Results are JSON lines on standard output, for ``dz driver check``.

Over 300 lines: the checks share one stream of evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
import json
import math
import sys
import time

from dz_ros.core.records import Command
from dz_ros.drivers.conformance.driver_checks import wave
from dz_ros.drivers.conformance.machine import lateness, MachineWatch
from dz_ros.drivers.conformance.result import Result
from dz_ros.drivers.conformance.stream_checks import check_stream
from dz_ros.errors import DriverError, LoopError
from dz_ros.nodes.parts.check_evidence import Evidence, Send
from dz_ros.nodes.ros.base import LoopNode
from dz_ros.nodes.ros.estop_topic import EstopTopic
from dz_ros.nodes.ros.parameters import configure

FIRST_STATE = 15.0
"""A node must publish its first state within this [s]."""
WATCH_DURATION = 3.0
"""How long it is watched while all is well [s]."""
DELAY_EVERY, DELAY_PERIODS = 10, 0.5
"""One command in ten is sent half a period later, which round_trip must show."""
RECOVERY = 5.0
"""After a stop, commands must act again within this [s]."""
STANDSTILL = 0.1
"""A check is repeated if no state came for longer than this, and 5 T, meanwhile [s]."""
STOP, STOPPED = 0.5, 20
"""From this loop time after an e-stop on no command may act [s]; this number of states shows that
none does."""
ATTEMPTS = 10
"""Largest number of times that a bad message is sent: where the node had gone without a command
before it, it may take any seq."""


class CheckNode(LoopNode):
    """Replaces the controller and reports."""

    def __init__(self) -> None:
        super().__init__('controller_node')
        self.configuration = configure(self, 'loop', 'structure', 'safety')

        self._amplitude = self.given('amplitude', 0.1, 'largest command sent [command unit]')
        self._limit = self.given('limit', 0.0, 'send twice this, which the driver must limit; '
                                 '0 = do not [command unit]')
        axis = self.given('axis', '', 'the axis to check, of a configuration of several')
        self._axes = self.configuration.axis_names
        self._own = self.configuration.axis(axis) if self._axes else self.configuration
        self._only = self.given('only', '', 'the one check to make, under this name; empty = all')
        self._period = self.configuration.loop.period
        self._safe = self._own.safety.safe_command
        self._evidence = Evidence(self, axis, self._answer)
        self._estop = EstopTopic(self)
        self.unspun += self._estop.subscriptions
        self.urgent = self._check_estop
        self._seq = 0
        self._answering = self._holding = False
        self._unanswered = 0        # states that are to come and get no answer
        self._v: float | None = None

    def _check_estop(self) -> None:
        """Raise DriverError where another node presses the e-stop; ends repeat this node's."""
        pressed = self._estop.receive() - {None}
        if pressed and pressed - self._estop.ends():
            raise DriverError('e-stop pressed by another node: no more is checked')

    def run(self) -> None:
        """Make the checks, write the results.

        Raises:
            LoopError: No node publishes states.
            DriverError: Another node presses the e-stop.
        """
        with MachineWatch() as self._watch:
            for result in self._alone() if self._only else self._all():
                if self.stopping:
                    return
                sys.stdout.write(json.dumps(asdict(result)) + '\n')
                sys.stdout.flush()

    def _alone(self) -> Iterator[Result]:
        started = time.monotonic()
        self._connect()
        acts = self._acts(RECOVERY)
        yield Result(self._only, acts, f'{time.monotonic() - started:.2f} s',
                     f'<= {FIRST_STATE + RECOVERY:g} s', '' if acts else 'no command acts')

    def _all(self) -> Iterator[Result]:
        self._connect()
        evidence = self._evidence
        if evidence.wrong_labels:
            yield Result('order and labels', False, evidence.wrong_labels, 'of order '
                         f'{self._own.plant.order}', 'see docs/topics.md')
            return
        if not self._acts(RECOVERY):    # it was left alone before, and is in a fault
            evidence.reset(RECOVERY)
            self._acts(RECOVERY)
        evidence.begin()
        self._watch.stalls()
        self._holding = True
        self._wait(WATCH_DURATION)
        self._holding = False
        yield from check_stream(
            evidence.states, evidence.arrivals, evidence.commands, self._period,
            self._own.plant.order, evidence.taken, self._watch.stalls())
        for name, check in (
                ('bad messages refused', self._bad_messages), ('saturation', self._saturation),
                ('stale command', self._silence), ('commander restarts', self._new_commander),
                ('e-stop', self._stop), ('reset', self._way_out),
                ('disconnect and reconnect', self._gone_and_back)):
            evidence.begin_silence()
            self._watch.stalls()
            try:
                result = check(name)
                stood_still = evidence.silence() > max(STANDSTILL, 5.0 * self._period)
                if result.passed is not None and stood_still:
                    # It proves nothing: the machine stood still, commands aged, a fault latched,
                    # or states came in a burst, none of which could have had the new command.
                    self._answering = True
                    self._estop.publish(False)
                    self._wait(0.2)
                    evidence.reset(RECOVERY)
                    self._acts(RECOVERY)
                    result = check(name)
            except DriverError:
                raise
            except LoopError as error:
                yield Result(name, False, 'silence', 'publishes states', str(error))
                raise
            late = lateness(self._watch.stalls()) if result.passed is False else ''
            yield replace(result, words='; '.join(filter(None, (result.words, late))))

    # The checks that provoke.

    def _bad_messages(self, name: str) -> Result:
        """NaN, infinities, seq back and far ahead, wrong labels or axes: none may be echoed."""
        self._wait(0.1)     # commands were not sent while figures were made; then any seq is taken
        evidence, labels = self._evidence, Command.labels()
        before, last = len(evidence.states), self._seq
        axes = self._axes
        kinds: list[tuple[int, float, float, Sequence[str], Sequence[str]]] = [
            (400, math.nan, 0.0, labels, axes), (410, math.inf, 0.0, labels, axes),
            (420, -math.inf, 0.0, labels, axes), (430, 0.0, math.nan, labels, axes),
            (5000, 0.0, 0.0, labels, axes), (-50, 0.0, 0.0, labels, axes),
            (450, 0.0, 0.0, ('nonsense', *labels[1:]), axes), (460, 0.0, 0.0, labels[:-1], axes)]
        if axes:
            kinds += [(470, 0.0, 0.0, labels, axes[::-1]), (480, 0.0, 0.0, labels, axes[:-1])]
        with evidence.stranger() as send:
            found = [self._provoke(send, *kind) for kind in kinds]
        self._wait(0.5)
        seen = evidence.states[before:]
        ill = [item.seq for item in seen if not all(map(math.isfinite, item.numbers()))]
        acted = [number for number, unseen in found if number is not None and not unseen]
        acting = bool(seen) and seen[-1].echo_seq > last
        words = (f'acted on {acted}' if acted else
                 f'state {ill[0]} is not finite' if ill else
                 'good commands act no more' if not acting else '')
        unseen = sum(unseen for _, unseen in found)
        return Result(name, False if words else None if unseen else True,
                      f'{len(kinds) - len(acted) - unseen} of {len(kinds)}', f'{len(kinds)}',
                      words or ('commands come too late to show that seq is judged' if unseen
                                else ''))

    def _provoke(self, send: Send, ahead: int, v: float, later: float, names: Sequence[str],
                 axes: Sequence[str]) -> tuple[int | None, bool]:
        """Send a bad message between two good ones, again where no good one came for too long.

        Args:
            send: Sends it.
            ahead: Its seq beyond that of the next good one.
            v: Its command.
            later: Its stamp beyond that of the newest state [s].
            names: Its labels.
            axes: Its axes.

        Returns:
            Its seq if it acted, and whether it might: after too long a time any seq is taken.
        """
        states, commands = self._evidence.states, self._evidence.commands
        hold, number = self._own.safety.command_hold, 0
        for _ in range(ATTEMPTS):
            state, before, number = states[-1], len(states), self._seq + ahead
            # A reader of the newest sees the last of a burst: this is the last for a period.
            self._unanswered = 1 if not hold or hold > 2 else 0
            send(names, (number, state.stamp + later, v, state.seq, state.stamp,
                         0.0)[:len(names)], axes)
            self._wait(2.3 * self._period)
            age = next((item.stamp - earlier.echo_stamp
                        for earlier, item in pairwise(states[before - 1:])
                        if item.echo_seq == number and commands.get(number) != item.echo_stamp),
                       None)
            if age is None:
                return None, False
            if not hold or age <= (hold - 0.5) * self._period or not math.isfinite(v + later):
                return number, False
        return number, True

    def _saturation(self, name: str) -> Result:
        limit = self._limit
        if limit <= 0.0:
            return Result(name, None, 'not tried', 'limited and reported', 'it would move the '
                          'device with all it has: --saturate tries, with a limit known')
        held_back = self._evidence.held_back()
        self._v = 2.0 * limit
        self._wait(2.5)     # two reports of diagnostics
        held, reported = self._evidence.largest_held(), self._evidence.held_back()
        self._v = None
        self._wait(0.2)
        if held is None and reported is None:
            return Result(name, None, 'sent', 'limited and reported', 'neither truth nor '
                          'diagnostics show what the actuator holds')
        more = reported is not None and reported > (held_back or 0)
        kept = held is None or held <= limit * (1.0 + 1e-6)
        return Result(name, kept and more,
                      f'{"" if held is None else f"holds {held:g}, "}'
                      f'{reported or 0} commands limited', f'<= {limit:g}, reported',
                      '' if kept and more else 'more than the limit acts' if not kept else
                      'the diagnostics do not count it')

    def _silence(self, name: str) -> Result:
        """No commands: the safe one within `safety.command_hold`."""
        hold = self._own.safety.command_hold
        limit = f'<= {hold + 2} samples'
        if not hold:
            return Result(name, None, 'safety.command_hold is 0', limit, 'a command never ages')
        self._answering = False
        self._evidence.note('silence')
        self._wait((hold + 20) * self._period + 0.3)
        samples = self._evidence.safe_after(self._safe)
        if not self._amplitude:
            return Result(name, None, 'unseen', limit, 'with amplitude 0 the last command is the '
                          'safe one')
        if samples is None and not self._evidence.reports:
            return Result(name, None, 'unseen', limit, 'neither events nor truth show when the '
                          'actuator takes the safe command')
        if samples is None:
            return Result(name, False, 'never', limit, 'the last command acts on')
        return Result(name, samples <= hold + 2, f'{samples} samples', limit,
                      '' if samples <= hold + 2 else 'the last command acts for too long')

    def _new_commander(self, name: str) -> Result:
        """A commander that restarts after a silence counts from 0."""
        self._answering = False
        self._wait((self._own.safety.command_hold + 20) * self._period)
        self._answering = True
        acts = self._acts(RECOVERY, fresh=True)
        return Result(name, acts, 'acts' if acts else 'does not act',
                      f'within {RECOVERY:g} s', '' if acts else 'commands that count from 0 again '
                      'after a silence are not taken')

    def _stop(self, name: str) -> Result:
        """The e-stop by its topic."""
        evidence = self._evidence
        states, before = evidence.states, len(evidence.states)
        evidence.note('stop')
        self._estop.publish(True)

        def echoed() -> set[int]:
            return {item.echo_seq for item in states[max(before, len(states) - STOPPED):]}

        def done() -> bool:
            passed = len(states) - before
            stopped = (passed >= STOPPED and len(echoed()) == 1
                       and (not evidence.reports or evidence.safe_after(self._safe) is not None))
            return stopped or passed >= STOPPED + STOP / self._period

        self.spin_until(time.monotonic() + RECOVERY, done)
        self._check_states(before, RECOVERY)
        safe = evidence.safe_after(self._safe)
        ignored = len(echoed()) == 1
        seen = not evidence.reports or safe is not None
        words = ('commands act although the e-stop is pressed' if not ignored else
                 '' if seen else 'the safe command was not taken')
        return Result(name, ignored and seen, f'{max(len(echoed()) - 1, 0)} commands acted', '0',
                      words)

    def _way_out(self, name: str) -> Result:
        """The way out of the e-stop."""
        self._estop.publish(True)
        self._wait(0.2)
        self._estop.publish(False)
        self._wait(0.2)
        refused = self._evidence.reset(RECOVERY)
        acts = self._acts(RECOVERY)
        return Result(name, acts and not refused, 'acts' if acts else 'does not act',
                      f'within {RECOVERY:g} s', refused or (
                          '' if acts else 'no command acts after the reset'))

    def _gone_and_back(self, name: str) -> Result:
        """The commander's publisher goes and comes back."""
        self._answering = False
        self._evidence.disconnect()
        self._wait(self._own.safety.fault_after * self._period + 0.5)
        self._evidence.connect()
        started = time.monotonic()
        self._answering = True
        acts = self._acts(1.0, fresh=True)
        if not acts:
            self._evidence.reset(RECOVERY)
            acts = self._acts(RECOVERY)
        return Result(name, acts, f'{time.monotonic() - started:.2f} s',
                      f'<= {RECOVERY:g} s', '' if acts else
                      'no command acts when the commander is back, reset or not')

    def _connect(self) -> None:
        """Wait for states, and begin to answer them."""
        self._answering = True
        seen = self._evidence
        self.spin_until(time.monotonic() + FIRST_STATE,
                        lambda: bool(seen.states or seen.wrong_labels))
        if not (seen.states or seen.wrong_labels or self.stopping):
            raise LoopError(f'no state on {self.resolve_topic_name("state")} within '
                            f'{FIRST_STATE:g} s: is the driver running in this ROS_DOMAIN_ID and '
                            'namespace, and does it wait for no other node (loop.peers)?')

    def _answer(self, seq: int, stamp: float) -> None:
        if not self._answering:
            return
        if self._unanswered:
            self._unanswered -= 1
            return
        v = self._safe + self._amplitude * wave(stamp) if self._v is None else self._v
        if self._holding and self._seq % DELAY_EVERY == 0:
            time.sleep(DELAY_PERIODS * self._period)
        self._evidence.command(Command(self._seq, stamp, v, seq, stamp))
        self._seq += 1

    def _acts(self, limit: float, fresh: bool = False) -> bool:
        """Return whether commands, `fresh` ones from 0 on, are echoed within a time [s]."""
        seen = self._evidence
        if fresh:
            self._seq = 0
            seen.commands.clear()
        first = self._seq + 5

        def echoed() -> bool:
            newest = seen.states[-1] if seen.states else None
            return (newest is not None and newest.echo_seq >= first
                    and seen.commands.get(newest.echo_seq) == newest.echo_stamp)

        self.spin_until(time.monotonic() + limit, echoed)
        return echoed()

    def _wait(self, span: float) -> None:
        """Receive for a time [s], longer where the machine stands still meanwhile."""
        states = self._evidence.states
        end, before = time.monotonic() + span, len(states)
        self.spin_until(end)
        self.spin_until(end + RECOVERY, lambda: len(states) - before >= 0.8 * span / self._period)
        self._check_states(before, RECOVERY + span)

    def _check_states(self, before: int, span: float) -> None:
        """Raise LoopError where there are no more states than `before`, after a time [s]."""
        if len(self._evidence.states) == before and not self.stopping:
            raise LoopError(f'no state for {span:g} s: it stopped publishing')
