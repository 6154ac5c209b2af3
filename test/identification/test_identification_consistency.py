# SPDX-License-Identifier: Apache-2.0
"""Runs that contradict themselves: each contradiction is named, and nothing is made from them.

Over 300 lines: one recorded loop, altered in each way that has to be named.
"""

import contextlib
from dataclasses import replace
import re

import numpy as np
import pytest

from dz_ros.core.dataset import Channel
from dz_ros.core.dataset import from_run as recorded
from dz_ros.core.loop.offline import simulate
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import RecordingError
from dz_ros.files.configurations import load_configuration
from dz_ros.identification.estimation.consistency import check_samples, jumps
from dz_ros.identification.estimation.pipeline import fit_log, identify, identify_log
from dz_ros.identification.samples import from_run, motion_speed

X, V = 2, 3
"""Columns of x and x' in the channel `state`."""
TRUTH = (0.5, -0.6, 1.0, 1.0)


@pytest.fixture(scope='module')
def loop():
    """Return the configuration of a servo on a sinusoid, and a run of it."""
    c = load_configuration('servo', [
        'plant.x0=[0.0, 0.0]', 'plant.noise=[0.0005,0.005]', 'trajectory.kind=sinusoid',
        'loop.duration=30.0'])
    return c, recorded(simulate(c), 10 ** 18)


def changed(run, column, function, channel='state'):
    """Return a run with one column of a channel changed."""
    old = run.channels[channel]
    values = old.values.copy()
    values[:, column] = function(values[:, column])
    return replace(run, channels={**run.channels, channel: replace(old, values=values)})


def without(run, share, channel='state', burst=1):
    """Return a run with a share of a channel's messages lost, this number of in a row."""
    old = run.channels[channel]
    count = len(old)
    keep = np.ones(count, dtype=bool)
    begins = np.random.default_rng(0).permutation(count - burst)
    for begin in begins[:round(share * count / burst)]:
        keep[begin:begin + burst] = False
    return replace(run, channels={**run.channels, channel: Channel(
        old.labels, old.values[keep], old.log_time[keep], old.publish_time[keep])})


def without_end(run, count):
    """Return the first states of a run, this number."""
    old = run.channels['state']
    return replace(run, channels={**run.channels, 'state': Channel(
        old.labels, old.values[:count], old.log_time[:count], old.publish_time[:count])})


def found(c, run):
    return identify_log(run, c)[1]


def test_a_run_that_agrees_with_itself_is_not_refused(loop):
    c, run = loop
    for good in (run, without(run, 0.01), changed(run, V, lambda v: np.round(v, 2)),
                 changed(run, X, lambda x: np.round(x, 2)), changed(run, X, lambda x: x + 0.1)):
        for item, truth in zip(found(c, good).bounds.values(), TRUTH, strict=True):
            assert item.low <= truth <= item.high


@pytest.mark.parametrize('factor', [1.005, 1.019, 0.985])
def test_a_velocity_that_is_a_little_wrong_widens_the_bounds_of_the_slopes(loop, factor):
    c, run = loop
    right, wrong = found(c, run), found(c, changed(run, V, lambda v: factor * v))
    assert right.notes == ()
    assert len(wrong.notes) == 1
    share = float(re.search(r'x1 \[rad/s\] is (\S+) times the rate of x0', wrong.notes[0])[1])
    assert share == pytest.approx(factor, abs=2e-3)
    for name, truth in zip(wrong.bounds, TRUTH, strict=True):
        assert wrong.bounds[name].low <= truth <= wrong.bounds[name].high
    for name in ('b·m_r', 'b·m_l'):
        assert wrong.bounds[name].width > right.bounds[name].width + 1.5 * abs(factor - 1.0)


@pytest.mark.slow
def test_a_position_that_is_mostly_noise_shows_no_factor_of_the_velocity(loop):
    """By chance alone it looks like half of it, or ten times as much, in one log of twenty."""
    c, run = loop
    run = without_end(run, 1100)
    t = 0.005 * np.arange(1100)
    v = 0.02 * np.sin(4.0 * t)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        x = np.cumsum(v) * 0.005 + rng.normal(0.0, 0.005, len(t))
        noisy = changed(changed(run, X, lambda _, x=x: x), V, lambda _, rng=rng:
                        v + rng.normal(0.0, 0.01, len(t)))
        with contextlib.suppress(RecordingError):       # by chance it is refused as well
            assert check_samples(from_run(noisy, c), c).scale < 0.1


def test_steps_that_the_bounds_do_not_count_are_named(loop):
    c, run = loop
    c = c.replace(**{'driver.measured': 1})
    assert found(c, rounded(run, 0.01)).notes == ()
    notes = found(c, rounded(run, 0.03)).notes
    assert len(notes) == 1
    assert re.match(r'x0 \[rad\] is rounded to steps of 0\.03 and moves over \S+ only', notes[0])


@pytest.mark.parametrize('overrides', [(), ('driver.measured=1',)], ids=['velocity', 'position'])
@pytest.mark.parametrize('step', [0.0, 1e-4, 1e-3])
def test_friction_and_dead_zone_are_one_where_no_command_separates_them(overrides, step):
    """Driven all the time, 0.16 V of dead-zone would explain the motion as well as none."""
    made = load_configuration('axis', ['loop.duration=24.0'])
    c = load_configuration('axis', [*overrides, 'loop.duration=24.0'])
    run = recorded(simulate(made), 10 ** 18)
    if step:
        run = changed(run, X, lambda x: np.round(x / step) * step)
    result = found(c, run)
    assert result.friction_counted
    total = made.to_flat()['plant.coulomb_friction'] / made.to_flat()['plant.force_constant']
    near = {'b_r': total, 'b_l': -total, 'b·m_r': made.plant.b, 'b·m_l': made.plant.b}
    for name, truth in near.items():
        item = result.bounds[name]
        assert item.low - 1e-3 * abs(truth) <= truth <= item.high + 1e-3 * abs(truth)
        assert item.width < 0.2 * abs(truth)


def axis_run(*overrides):
    """Return a configuration of the axis, and a run in which it may be another one."""
    made = load_configuration('axis', ['loop.duration=24.0', *overrides])
    return load_configuration('axis', []), recorded(simulate(made), 10 ** 18)


def test_friction_that_the_model_smooths_otherwise_is_no_dead_zone():
    c, run = axis_run('plant.smoothing_speed=0.02')
    result = found(c, run)
    assert result.residual > 3.0 * result.noise
    assert result.friction_counted


def test_few_stretches_of_motion_are_cut_finer_and_into_fewer_parts():
    c, run = axis_run('plant.dead_zone.b_r=0.5', 'plant.dead_zone.b_l=-0.7',
                      'trajectory.frequencies=[0.7, 2.1]')
    result = found(c, run)
    total = c.to_flat()['plant.coulomb_friction'] / c.to_flat()['plant.force_constant']
    edges = (0.5, -0.7) if not result.friction_counted else (0.5 + total, -0.7 - total)
    for item, truth in zip(result.bounds.values(), (*edges, c.plant.b, c.plant.b), strict=True):
        assert item.low - 0.01 * abs(truth) <= truth <= item.high + 0.01 * abs(truth)


@pytest.mark.parametrize(('force', 'offset'), [(-60.0, r'\+1\.7'), (60.0, r'-1\.7')])
def test_a_constant_force_that_friction_does_not_hold_is_named(force, offset):
    c, run = axis_run(f'plant.constant_force={force}', 'controller.theta_max=[9.5, 0.95, 5.0]',
                      'controller.theta_min=[3.3, 0.33, -5.0]')
    with pytest.raises(RecordingError, match=rf'constant force is larger.*--map v=…{offset}'):
        found(c, run)


@pytest.mark.parametrize(('samples', 'seen'), [(8, 8), (14, 10)])
def test_a_long_delay_is_found_or_named(samples, seen):
    c, run = axis_run()
    late = changed(run, 2, lambda v: np.concatenate([v[samples:], np.full(samples, v[-1])]),
                   'command')
    result = found(c, late)
    assert result.delay == seen
    assert any('10 samples late or more' in note for note in result.notes) == (seen == 10)


def test_a_dead_zone_that_commands_cross_is_separate_from_friction(loop):
    c, run = loop
    assert not found(c, run).friction_counted
    assert not found(c.replace(**{'driver.measured': 1}), run).friction_counted


@pytest.mark.parametrize(('column', 'change', 'reported'), [
    (V, lambda v: v * np.nan, r'x1 \[rad/s\] is not a number in any sample; without a measurement '
     r'of it set driver.measured to 1'),
    (V, lambda v: v + np.inf, 'x1 .* is not a number in any sample'),
    (X, lambda x: x * np.nan, r'x0 \[rad\] is not a number in any sample$'),
    (V, lambda v: np.where(np.arange(len(v)) % 10, v, np.nan), 'not a number in 10%'),
    (V, lambda v: v * 60.0 / (2.0 * np.pi), r'9.55 times as large \(rpm in place of rad/s'),
    (V, np.degrees, r'57.3 times as large \(degrees in place of radians'),
    (X, lambda x: 1000.0 * x, r'reverse of thousandths'),
    (V, lambda v: 1.1 * v, '1.1 times as large'),
    (V, lambda v: v + 0.2, r'x1 \[rad/s\] has an offset of 0.2 against the rate of x0'),
    (V, lambda v: v - 0.05, 'an offset of -0.05'),
    (V, np.round, 'x1 .* is rounded to steps of 1 '),
    (V, lambda v: np.round(5.0 * v) / 5.0, 'x1 .* is rounded to steps of 0.2 '),
    (V, lambda v: -v, 'x1 .* is not the rate of x0 .*: it has the other sign'),
    (X, lambda x: -x, 'it has the other sign'),
    (V, lambda v: -2.0 * v, '2 times as large with the other sign'),
    (V, np.abs, 'x1 .* is not the rate of x0'),
    (V, lambda v: np.roll(v, 20), 'it is (95|100) ms late'),
    (V, lambda v: np.full(len(v), 0.3), 'x1 .* is 0.3 in every sample'),
    (V, lambda v: np.random.default_rng(0).normal(size=len(v)), 'x1 .* is not the rate of x0'),
    (X, lambda x: (x + 1.0) % 2.0 - 1.0, 'x1 .* is not the rate of x0'),
], ids=lambda item: item if isinstance(item, str) else None)
def test_states_that_contradict_each_other_are_named(loop, column, change, reported):
    c, run = loop
    with pytest.raises(RecordingError, match=reported) as caught:
        found(c, changed(run, column, change))
    assert '\n' not in str(caught.value)
    with pytest.raises(RecordingError, match=reported):
        fit_log(changed(run, column, change), c)


@pytest.mark.parametrize(('change', 'reported'), [
    (lambda v: -v, 'accelerates against the command'),
    (lambda v: v * np.nan, 'the command is not a number in 100%'),
    (lambda v: np.where(np.arange(len(v)) % 10, v, np.nan), 'the command is not a number in 10%'),
    (lambda v: 0.0 * v, 'the command is 0 in every sample'),
    (np.abs, 'the command has one sign only')], ids=['sign', 'nan', 'some nan', 'none', 'size'])
def test_commands_that_contradict_the_motion_are_named(loop, change, reported):
    c, run = loop
    with pytest.raises(RecordingError, match=reported):
        found(c, changed(run, 2, change, 'command'))


@pytest.mark.parametrize('share', [0.05, 0.2])
def test_lost_messages_are_named(loop, share):
    c, run = loop
    with pytest.raises(RecordingError, match=r'\d+% of the states are lost'):
        found(c, without(run, share))
    with pytest.raises(RecordingError, match=r'\d+% of the commands that acted are lost'):
        found(c, without(run, share, 'command'))


def test_states_lost_together_cost_no_more_than_what_they_would_have_shown(loop):
    c, run = loop
    rest = found(c, without(run, 0.1, burst=50))
    assert re.search('10% of the states are lost', '; '.join(rest.notes))
    for bound, truth in zip(rest.bounds.values(), TRUTH, strict=True):
        assert bound.low <= truth <= bound.high
    with pytest.raises(RecordingError, match='10% of the commands that acted are lost'):
        found(c, without(run, 0.1, 'command', 50))


def test_a_velocity_without_numbers_for_a_while_is_noted(loop):
    c, run = loop

    def bursts(v):
        v = v.copy()
        for begin in range(300, 6000, 600):
            v[begin:begin + 40] = np.nan
        return v

    rest = found(c, changed(run, V, bursts))
    assert 'x1 [rad/s] is not a number in 6.67 % of the samples' in '; '.join(rest.notes)
    for bound, truth in zip(rest.bounds.values(), TRUTH, strict=True):
        assert bound.low <= truth <= bound.high


def wrapped(x):
    x = x + 3.0
    return np.where(x > 3.5, x - 2.0 * np.pi, x)


def spiked(x):
    x = x.copy()
    x[1000] += 1.0
    return x


@pytest.mark.parametrize(('alter', 'size', 'least'), [(wrapped, 2.0 * np.pi, 4), (spiked, 1.0, 2)])
def test_a_position_that_jumps_is_named(loop, alter, size, least):
    c, run = loop
    with pytest.raises(RecordingError, match='is not the rate of') as caught:
        found(c, changed(run, X, alter))
    alone = c.replace(**{'driver.measured': 1})
    notes = '; '.join(found(alone, changed(run, X, alter)).notes)
    for text in (notes, str(caught.value)):
        count, by = re.search(r'x0 \[rad\] jumps (\d+) times, by (\S+) at', text).groups()
        assert int(count) >= least
        assert abs(float(by)) == pytest.approx(size, abs=0.1)
    assert 'jumps' not in '; '.join(found(c, run).notes)


@pytest.mark.parametrize(('values', 'rows'), [
    (np.floor(np.linspace(0.0, 40.0, 4000)), 0),                        # an encoder, slow
    (np.concatenate([np.zeros(2000), np.linspace(0.0, 1.0, 40), np.ones(2000)]), 0),
    (np.sin(np.arange(4000) / 100.0), 0), (np.ones(4000), 0),
    (np.sin(np.arange(4000) / 100.0) + (np.arange(4000) >= 50), 1),
    (0.002 * (np.arange(4000) // 150) + 1e-6 * np.arange(4000), 0),      # sticks and slips
    ((np.arange(4000) * 0.1 + np.pi) % (2.0 * np.pi) - np.pi, 64)], ids=range(7))
def test_jumps_are_no_motion(values, rows):
    noise = np.random.default_rng(1).normal(0.0, 1e-4, len(values))
    seq = np.arange(len(values))
    before = jumps(values, seq).tolist()
    assert len(before) == rows
    if len(np.unique(values)) != 41:
        assert len(jumps(values + noise, seq)) == rows
    seq[50:] += 1       # what happened between is not known
    assert jumps(values, seq).tolist() == [row for row in before if row != 49]


@pytest.mark.parametrize('late', [1, 4, -2])
def test_a_velocity_that_comes_late_is_noted(loop, late):
    c, run = loop
    noted = '; '.join(found(c, changed(run, V, lambda v: np.roll(v, late))).notes)
    number, way = re.search(r'comes ([\d.]+) ms (behind|before) the rate of x0', noted).groups()
    assert float(number) == pytest.approx(5.0 * abs(late), abs=1.0)
    assert way == ('behind' if late > 0 else 'before')
    assert 'comes' not in '; '.join(found(c, run).notes)


def test_a_velocity_in_coarse_steps_does_not_show_a_dead_zone_beside_friction(loop):
    c, run = loop
    fine = found(c, run)
    coarse = found(c, changed(run, V, lambda v: np.round(v / 0.03) * 0.03))
    assert (fine.friction_counted, coarse.friction_counted) == (False, True)
    assert coarse.bounds['b_r'].high > TRUTH[0]
    assert coarse.bounds['b_l'].low < TRUTH[1]


@pytest.mark.parametrize('own', [1.0, 1.018, 0.982])
def test_times_of_the_states_are_their_period(loop, own):
    c, run = loop
    for channel, labels in (('state', ('stamp', 'echo_stamp')), ('command', ('stamp',
                                                                             'echo_stamp'))):
        for place, label in enumerate(run.channels[channel].labels):
            if label in labels:
                run = changed(run, place, lambda t: own * t, channel)
    assert from_run(run, c).period == pytest.approx(0.005 * own, rel=1e-9)
    assert (from_run(run, c).period == c.loop.period) == (own == 1.0)


def test_a_rate_that_is_not_the_run_s_is_named(loop):
    c, run = loop
    with pytest.raises(RecordingError, match=r'5 ms apart, loop\.rate = 100 means 10 ms'):
        found(c.replace(**{'loop.rate': 100.0}), run)


class PositionOnly(SimulatedActuator):
    """Measures no velocity."""

    @property
    def measured(self):
        return 1

    def measure(self):
        return super().measure()[:1]


def test_a_velocity_that_is_not_measured_contradicts_nothing(loop):
    c, run = loop
    c = c.replace(**{'driver.name': f'{__name__}:PositionOnly'})
    for item, truth in zip(found(c, changed(run, V, lambda v: v * np.nan)).bounds.values(), TRUTH,
                           strict=True):
        assert item.value == pytest.approx(truth, rel=0.1)


def rounded(run, step):
    """Return a run whose position is in steps and whose velocity is observed from it."""
    x = np.round(run.channels['state'].values[:, X] / step) * step
    return changed(changed(run, X, lambda _: x), V, lambda _: np.gradient(x, 0.005))


def test_an_observed_velocity_does_not_decide_what_counts_as_motion(loop):
    c, run = loop
    c = c.replace(**{'driver.measured': 1})
    for item, truth in zip(found(c, rounded(run, 0.05)).bounds.values(), TRUTH, strict=True):
        assert item.low <= truth <= item.high


def test_where_bounds_cannot_be_had_a_coarse_position_is_named(loop):
    c, run = loop
    c = c.replace(**{'driver.measured': 1})
    with pytest.raises(RecordingError, match=r'; x0 \[rad\] is rounded to steps of 0\.1 and moves '
                                             r'over 5\.?\d* only: record it with more digits$'):
        found(c, rounded(run, 0.1))


def test_a_driver_s_own_samples_are_checked_as_well(loop):
    c, run = loop
    samples = from_run(run, c)
    x = samples.x.copy()
    x[:, 1] *= 9.55
    with pytest.raises(RecordingError, match='rpm'):
        identify(replace(samples, x=x), c, motion_speed(samples))
