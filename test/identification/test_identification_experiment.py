# SPDX-License-Identifier: Apache-2.0
"""The moves: within their limits, whatever the device does, and the safe command at every end.

Over 300 lines: all of it runs one session with devices that differ in a method.
"""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.hosted import HostedDriver
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import DriverError
from dz_ros.identification.experiment.moves import BREACHES, Experiment, TRIES
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.identification.experiment.pulses import Pulses, SignTest
from dz_ros.identification.experiment.session import (
    NotLetGoError,
    run_session,
    StoppedError,
)
from dz_ros.identification.samples import to_run

SERVO = {'plant.model': 'servo', 'plant.noise': [1e-3, 1e-2], 'loop.timing': 'lockstep'}
LIMITS = Limits(1.5, 1.0, 4.0)


class Watched(SimulatedActuator):
    """A simulated actuator that remembers what it was commanded."""

    def __init__(self, parameters, configuration):
        super().__init__(parameters, configuration)
        self.commanded = []

    def command(self, v, t):
        self.commanded.append(v)
        super().command(v, t)

    def safe(self, v, t):
        self.commanded.append(('safe', v))
        super().command(v, t)

    def disable(self):
        self.commanded.append('disabled')

    def close(self):
        self.commanded.append('closed')


def session(flat, limits=LIMITS, plan=None, stopped=lambda: '', driver=Watched,
            wait=lambda seq: seq, kept=None, kind=Experiment, sides=()):
    c = Configuration.from_flat({**SERVO, **flat})
    experiment = kind(limits, plan or Plan(repeats=4), c.plant.order, c.loop.period,
                      c.safety.safe_command, *sides)
    hosted = HostedDriver(c)
    hosted.driver = driver(c.driver_parameters, c)
    try:
        samples = run_session(c, experiment, wait, stopped, hosted, kept)
    except DriverError as error:
        return hosted.driver, experiment, error
    return hosted.driver, experiment, samples


def test_it_moves_both_ways_within_its_limits_and_ends_near_home():
    driver, experiment, samples = session({'plant.x0': [0.7, 0.0]}, plan=Plan(repeats=6))
    x = samples.x[:, 0] - experiment.home
    assert abs(experiment.home - 0.7) < 1e-3
    assert np.abs(x).max() < LIMITS.travel
    assert np.abs(samples.x[:, 1]).max() < LIMITS.speed
    assert np.abs(samples.v).max() <= LIMITS.effort
    assert abs(x[-1]) < 0.25 * LIMITS.travel
    assert not experiment.breaches
    assert {*samples.kinds} - {'return'} == {'rest', 'ramp', 'step', 'coast', 'brake'}
    sides = [math.copysign(1.0, v) for _, v in experiment.breakaway]
    assert sides.count(1.0) == sides.count(-1.0) == 6
    assert samples.v[-5:].tolist() == [0.0] * 5
    assert driver.commanded[-3:] == [('safe', 0.0), 'disabled', 'closed']


def test_the_same_seed_moves_the_same_and_another_does_not():
    one, two, other = (session({}, plan=Plan(repeats=4, seed=seed))[2].v for seed in (1, 1, 2))
    assert np.array_equal(one, two)
    assert len(one) != len(other) or not np.array_equal(one, other)


@settings(max_examples=settings.default.max_examples // 8, deadline=None)
@given(st.floats(0.3, 3.0), st.floats(0.3, 3.0), st.floats(0.5, 8.0), st.floats(0.0, 2.0),
       st.integers(0, 5))
def test_whatever_the_device_is_the_command_is_limited_and_the_last_one_is_safe(
        travel, speed, effort, friction, delay):
    limits = Limits(travel, speed, effort)
    driver, experiment, found = session(
        {'plant.coulomb_friction': friction, 'loop.delay': delay}, limits,
        Plan(repeats=4, ramp=1.0))
    commands = [item for item in driver.commanded if isinstance(item, float)]
    assert max(map(abs, commands)) <= effort
    assert driver.commanded[-3:] == [('safe', 0.0), 'disabled', 'closed']
    if not isinstance(found, Exception):
        assert len(experiment.breaches) <= BREACHES


class Learns(Watched):
    """Knows its limit once it is open, and another one at command 300."""

    first, later = 4.0, 4.0

    @property
    def limit(self):
        if not self.commanded:
            return math.inf
        return self.first if len(self.commanded) < 400 else self.later

    def open(self):
        super().open()
        self.commanded.append('opened')


def test_a_device_that_takes_less_than_it_is_to_do_is_not_moved():
    class Weak(Learns):
        first = 2.5

    driver, _, error = session({}, driver=Weak)
    assert str(error).endswith('takes |v| up to 2.5, effort = 4 is more')
    assert driver.commanded == ['opened', 'closed']


def test_what_is_written_down_is_what_the_device_was_given():
    class Weaker(Learns):
        later = 2.0

    driver, _, found = session({}, Limits(1.5, 1.0, 4.0), driver=Weaker)
    assert not isinstance(found, Exception), found
    commands = [item for item in driver.commanded if isinstance(item, float)]
    assert commands == found.v.tolist()
    assert np.abs(found.v).max() == 2.0


def test_a_limit_that_is_passed_stops_it_and_it_goes_back():
    # A gust at t = 3 s throws it beyond the speed limit.
    driver, experiment, samples = session({'plant.disturbance_pulse': [3.0, 30.0, 0.05]})
    assert len(experiment.breaches) == 1
    assert 'speed' in experiment.breaches[0]
    beyond = np.flatnonzero(np.abs(samples.x[:, 1]) > 1.02 * LIMITS.speed)
    after = samples.v[beyond[-1] + 1:beyond[-1] + 10]
    assert not after.any()
    assert not isinstance(samples, Exception)
    assert driver.commanded[-1] == 'closed'


PULSING = {'kind': Pulses, 'sides': ((2.0, -2.1),)}


def test_a_limit_that_is_passed_in_a_pulse_stops_it_and_it_goes_on():
    _, experiment, samples = session({'plant.disturbance_pulse': [1.2, 40.0, 0.05]}, **PULSING)
    assert not isinstance(samples, Exception), samples
    assert [text.partition(' ')[0] for text in experiment.breaches] == ['speed']
    _, _, calm = session({}, **PULSING)
    assert set(samples.repeat) == set(calm.repeat)
    assert moves(samples, 'pulse') == moves(calm, 'pulse')


def test_a_pulse_that_a_stall_prolongs_is_made_again():
    _, _, calm = session({}, **PULSING)
    pulse = int(np.flatnonzero([kind == 'pulse' for kind in calm.kinds])[20])
    _, experiment, samples = session({'plant.viscous_friction': 0.0}, wait=stalls([pulse], 120),
                                     **PULSING)
    assert not isinstance(samples, Exception), samples
    assert len(experiment.stalls) == 1
    assert experiment.breaches == []        # it was the machine, not the device
    assert moves(samples, 'return') > 0     # yet the limit was passed


def test_a_limit_that_is_passed_in_the_sign_test_ends_it_with_its_name():
    _, _, error = session({'plant.disturbance_pulse': [1.5, 40.0, 0.05]}, kind=SignTest)
    assert isinstance(error, DriverError)
    assert str(error).startswith('speed ')


def test_a_session_without_any_measurement_is_a_run_without_rows():
    kept = []

    class Blind(Watched):
        def measure(self):
            return None

        def absence(self):
            return 'the cable is out'

    _, _, error = session({}, driver=Blind, kept=kept.append)
    assert str(error) == 'no measurement within 10 s: the cable is out'
    found, = kept
    assert len(to_run(found, Configuration.from_flat(SERVO), 0).channels['state']) == 0


def test_it_gives_up_where_limits_are_passed_again_and_again():
    # So light that every ramp is too fast.
    _, _, error = session({'plant.inertia': 1e-3, 'plant.coulomb_friction': 0.05,
                           'plant.viscous_friction': 0.001, 'plant.cogging_torque': 0.0})
    assert isinstance(error, DriverError)
    assert str(error).startswith(f'a limit was passed {BREACHES + 1} times')


def stalls(at, samples):
    """Return a clock that misses samples at some of them."""
    left = list(at)

    def wait(seq):
        return seq + samples if left and seq >= left[0] and left.pop(0) else seq

    return wait


def moves(samples, kind):
    """Return the number of moves of a kind."""
    found = np.array([each == kind for each in samples.kinds])
    return int(np.count_nonzero(np.diff(found.astype(int)) == 1) + found[0])


def test_a_move_in_which_the_machine_stalled_is_made_again():
    _, _, calm = session({})
    ramp = int(np.flatnonzero([kind == 'ramp' for kind in calm.kinds])[-1])
    _, experiment, samples = session({}, wait=stalls([ramp - 20], 60))
    assert experiment.stalls == pytest.approx([0.3])
    assert experiment.breaches == []
    assert moves(samples, 'ramp') == moves(calm, 'ramp') + 1
    _, experiment, samples = session({}, wait=stalls([ramp - 20], 5))       # a few are a hole
    assert experiment.stalls == []
    assert moves(samples, 'ramp') == moves(calm, 'ramp')


@pytest.mark.slow
def test_stalls_without_end_are_not_repeated_without_end():
    _, experiment, samples = session({}, plan=Plan(repeats=1),
                                     wait=stalls(range(300, 10 ** 6), 40))
    assert len(experiment.stalls) > 10
    assert isinstance(samples, DriverError) or moves(samples, 'ramp') <= 4 * TRIES


class Offended(Watched):
    """It has a fault once the host was silent, until reset."""

    resets, silent, last = 0, False, 0.0

    def advance(self, t, seq):
        self.silent |= t - self.last > 0.1
        self.last = t
        super().advance(t, seq)

    def fault(self):
        return 'no command for 0.1 s' if self.silent else ''

    def recover(self):
        self.resets += 1
        self.silent = False


def test_a_device_that_missed_its_host_is_reset_and_the_move_made_again():
    driver, experiment, samples = session({}, driver=Offended, wait=stalls([900], 60))
    assert driver.resets == 1
    assert not isinstance(samples, DriverError)
    assert experiment.stalls == pytest.approx([0.3, 0.05])
    assert ('safe', 0.0) not in driver.commanded[:100]


def test_the_time_that_going_on_takes_is_no_stall():
    late = [60]

    class Loose(Offended):
        def recover(self):
            super().recover()
            late.append(60)     # a reset that takes 0.3 s, after which it is lost again

    def wait(seq):
        return seq + late.pop() if seq >= 900 and late else seq

    driver, _, error = session({}, driver=Loose, wait=wait)
    assert driver.resets == 1
    assert str(error) == 'no command for 0.1 s'


def test_moves_whose_device_is_not_let_go_are_reported_and_kept():
    class Stuck(Watched):
        def disable(self):
            super().disable()
            raise DriverError('the relay is stuck')

    kept = []
    driver, experiment, error = session({}, driver=Stuck, kept=kept.append)
    assert type(error) is NotLetGoError
    assert len(error.samples.v) == len(kept[0].v)
    assert str(error) == 'letting the device go failed: the relay is stuck'
    assert driver.commanded[-2:] == ['disabled', 'closed']
    assert [samples.kinds[-1] for samples in kept] == ['rest']
    assert kept[0].repeat.max() == experiment.plan.repeats - 1


def test_a_fault_without_a_stall_ends_it():
    class Broken(Watched):
        def fault(self):
            return 'overheated' if len(self.commanded) > 900 else ''

    driver, _, error = session({}, driver=Broken)
    assert str(error) == 'overheated'
    assert driver.commanded[-3:] == [('safe', 0.0), 'disabled', 'closed']


@pytest.mark.parametrize(('flat', 'reported'), [
    ({'plant.torque_constant': 1e-3}, 'no motion right up to |v| = 4'),
    ({'plant.noise': [1e-3, 2.0]}, 'hides motion'),
    ({'plant.model': 'wang2004', 'plant.x0': [1.0, 0.0]}, 'does not rest'),
    ({'plant.noise': [0.0, 0.0], 'plant.x0': [0.0, 0.9]}, 'does not rest'),
])
def test_a_device_that_cannot_be_moved_so_is_commanded(flat, reported):
    driver, _, error = session(flat)
    assert isinstance(error, DriverError)
    assert reported in str(error)
    assert driver.commanded[-3:] == [('safe', 0.0), 'disabled', 'closed']


class Reversed(Watched):
    """Its wires are swapped."""

    def command(self, v, t):
        super().command(-v, t)


def test_swapped_wires_are_noticed_on_the_first_ramp():
    driver, _, error = session({}, driver=Reversed)
    assert 'against the command' in str(error)
    assert max(abs(item) for item in driver.commanded if isinstance(item, float)) < 4.0


class Dying(Watched):
    """Its measurement stays away from sample 500 on."""

    def measure(self):
        return super().measure() if len(self.commanded) < 500 else None


def test_a_measurement_that_stays_away_ends_it():
    driver, _, error = session({}, driver=Dying)
    assert str(error) == 'no measurement for 3 samples'
    assert driver.commanded[-3:] == [('safe', 0.0), 'disabled', 'closed']


def test_a_measurement_that_is_missing_once_is_a_hole():
    class Blinking(Watched):
        def measure(self):
            return None if len(self.commanded) in (700, 1100) else super().measure()

    _, _, samples = session({}, driver=Blinking)
    assert np.flatnonzero(np.isnan(samples.x[:, 0])).tolist() == [700, 1100]


def test_the_time_until_the_first_measurement_is_none_of_the_experiment():
    class Slow(Watched):
        def measure(self):
            return super().measure() if len(self.commanded) >= 900 else None

    _, _, samples = session({}, driver=Slow)
    assert samples.seq[0] == 900
    assert np.isfinite(samples.x).all()
    assert samples.repeat.max() == 3


def test_a_stop_gives_the_safe_command_in_the_same_sample():
    asked = []

    def stopped():
        asked.append(0)
        return 'e-stop pressed' if len(asked) == 800 else ''

    driver, _, error = session({}, stopped=stopped)
    assert isinstance(error, StoppedError)
    assert str(error) == 'e-stop pressed'
    assert len([item for item in driver.commanded if isinstance(item, float)]) == 799
    assert driver.commanded[799:] == [('safe', 0.0), 'disabled', 'closed']


@pytest.mark.parametrize('blind', [False, True])
def test_the_recording_of_what_was_stopped_ends_with_the_safe_command(blind):
    asked, kept = [], []

    def stopped():
        asked.append(0)
        return 'e-stop pressed' if len(asked) == 301 else ''

    class Blind(Watched):
        """A device whose measurement is missing in the very sample of the stop."""

        def measure(self):
            found = super().measure()
            return None if blind and len(asked) == 300 else found

    session({}, stopped=stopped, driver=Blind, kept=kept.append)
    run = to_run(kept[0], Configuration.from_flat(SERVO), 10 ** 18)
    command, state = run.channels['command'], run.channels['state']
    assert command['v'][-1] == 0.0 != command['v'][-2]
    assert command['seq'][-1] == 300
    assert state['seq'][-1] == 300 - blind


def test_a_safe_command_of_its_own_is_what_rests():
    driver, _, samples = session({'safety.safe_command': 0.1})
    assert samples.v[0] == 0.1
    assert ('safe', 0.1) in driver.commanded
