# SPDX-License-Identifier: Apache-2.0
"""The closed loop: reference runs, the figures of its steady state, delay, limits, noise, rate."""

from pathlib import Path

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import measurement_noise, simulate
from dz_ros.core.signals import STATUS

DATA = Path(__file__).parents[1] / 'data'


def run(**keys):
    """Return the loop of the paper's example with keys changed; `__` stands for a dot."""
    return simulate(Configuration.from_flat({key.replace('__', '.'): value
                                             for key, value in keys.items()}))


def last_ten_seconds(found):
    return found.t >= found.t[-1] - 10.0


def error(found):
    return found.x[:, 0] - found.x_d[:, 0]


@pytest.fixture(scope='module')
def steady():
    return run(loop__duration=60.0)


@pytest.mark.parametrize(('file', 'substeps'), [
    ('wang2004_lambda1_rk4.csv', 1),
    ('wang2004_lambda1_exact.csv', 10),
    ('wang2004_lambda1_exact.csv', 16),
])
def test_every_sample_of_the_reference_run(file, substeps):
    with (DATA / file).open(encoding='utf-8') as lines:
        names = [line for line in (next(lines), next(lines)) if not line.startswith('#')]
        columns = names[0].strip().split(',')
        expected = np.loadtxt(lines, delimiter=',')
    assert expected.shape == (4001, len(columns))
    found = run(plant__substeps=substeps)
    assert len(found.t) == 4001
    pairs = {'t': (found.t, 1e-12), 'x': (found.x[:, 0], 1e-10), 'xdot': (found.x[:, 1], 1e-10),
             'v': (found.v, 1e-8), 's': (found.column('s'), 1e-9),
             's_eps': (found.column('s_eps'), 1e-9),
             **{name: (found.column(name), 1e-10) for name in ('theta1', 'theta2', 'phi')}}
    assert set(columns) == {*pairs, 'k'}
    for name, (values, tolerance) in pairs.items():
        assert np.abs(values - expected[:, columns.index(name)]).max() <= tolerance, name


def test_steady_state_of_the_example(steady):
    late = last_ten_seconds(steady)
    found = np.abs(error(steady))
    assert found[late].max() == pytest.approx(0.00843, abs=5e-6)
    assert np.sqrt((found[late] ** 2).mean()) == pytest.approx(0.00652, abs=5e-6)
    assert np.abs(steady.column('s')[late]).max() / 0.02 == pytest.approx(0.66, abs=5e-3)
    assert np.abs(steady.v).max() == pytest.approx(16.7, abs=0.05)
    assert np.abs(np.diff(steady.v[late])).sum() / 10.0 == pytest.approx(5.6, abs=0.1)
    assert steady.t[np.nonzero(found >= 0.05)[0][-1] + 1] == pytest.approx(4.11, abs=5e-3)


def test_what_the_dead_zone_costs(steady):
    without = run(loop__duration=60.0, plant__dead_zone__b_r=0.0, plant__dead_zone__b_l=0.0)
    late = last_ten_seconds(without)
    assert np.abs(error(without)[late]).max() == pytest.approx(0.0053, abs=5e-5)
    assert np.array_equal(without.truth[:, 0], without.v)
    more = steady.v - without.v
    w = steady.truth[:, 0]
    assert np.median(more[late & (w > 0.0)]) == pytest.approx(0.50, abs=0.01)
    assert np.median(more[late & (w < 0.0)]) == pytest.approx(-0.61, abs=0.01)


def test_pd_baseline():
    found = run(controller__law='pd', loop__duration=60.0)
    late = last_ten_seconds(found)
    assert np.abs(error(found)[late]).max() == pytest.approx(0.37, abs=0.005)


@pytest.mark.parametrize(('delay', 'limit'), [(0, 8.25), (1, 6.25), (2, 5.25)])
def test_largest_lambda_before_the_sampled_loop_diverges(delay, limit):
    good = run(controller__lambda=limit - 0.25, loop__delay=delay)
    assert np.abs(good.x[:, 0]).max() < 3.0
    try:
        bad = run(controller__lambda=limit + 0.25, loop__delay=delay)
    except (OverflowError, ValueError):
        return
    assert not (np.abs(bad.x) < 100.0).all()


@pytest.mark.parametrize('delay', [0, 1, 2, 7])
def test_the_actuator_holds_the_command_of_samples_before(delay):
    found = run(loop__delay=delay, loop__duration=2.0)
    assert (found.v_applied[:delay] == 0.0).all()
    assert np.array_equal(found.v_applied[delay:], found.v[:len(found.v) - delay])


def test_a_delay_changes_nothing_before_it_can():
    """With a delay of 3 samples the plant falls freely at first, as if there were no command."""
    late = run(loop__delay=3, loop__duration=0.5)
    free = run(plant__dead_zone__b_r=1e6, plant__dead_zone__b_l=-1e6, loop__duration=0.5)
    assert np.array_equal(late.x[:4], free.x[:4])
    assert not np.array_equal(late.x[4], free.x[4])


def test_chatter_is_where_the_design_rules_put_it():
    def total_variation(epsilon, delay):
        found = run(controller__epsilon=epsilon, loop__delay=delay)
        return np.abs(np.diff(found.v[last_ten_seconds(found)])).sum() / 10.0

    for delay, critical in ((0, 0.0064), (1, 0.0132), (2, 0.0222)):
        assert total_variation(1.1 * critical, delay) < 12.0
        assert total_variation(0.8 * critical, delay) > 60.0


def test_command_limit_clips_what_the_actuator_holds():
    found = run(plant__command_limit=6.0, loop__duration=5.0)
    assert np.abs(found.v).max() > 6.0
    assert np.array_equal(found.v_applied, np.clip(found.v, -6.0, 6.0))
    free, wide = run(loop__duration=5.0), run(plant__command_limit=1e6, loop__duration=5.0)
    assert np.array_equal(free.x, wide.x)


def test_truth_is_what_the_dead_zone_makes_of_the_held_command():
    found = run(loop__delay=1, plant__dead_zone__m_r=1.25, plant__dead_zone__m_l=0.5,
                loop__duration=5.0)
    v = found.v_applied
    slope = np.where(v >= 0.0, 1.25, 0.5)
    beyond = v - np.clip(v, -0.6, 0.5)
    assert found.truth[:, 0] == pytest.approx(np.where(beyond > 0.0, 1.25, 0.5) * beyond)
    assert found.truth[:, 1] == pytest.approx(found.truth[:, 0] - slope * v)
    assert found.truth[:, 2] == pytest.approx(0.5 * found.x[:, 0] * np.sin(3.0 * found.t))


def test_noise_is_that_of_its_seed_and_reaches_the_law_only():
    keys = {'plant__noise': [1e-3, 1e-2], 'loop__duration': 20.0}
    one, again = run(loop__seed=1, **keys), run(loop__seed=1, **keys)
    other = run(loop__seed=2, **keys)
    assert np.array_equal(one.v, again.v)
    assert not np.array_equal(one.v, other.v)
    noise = one.x_measured - one.x
    expected = np.random.default_rng(1).standard_normal((4001, 2)) * [1e-3, 1e-2]
    assert noise == pytest.approx(expected, abs=1e-12)
    assert np.abs(error(one)[last_ten_seconds(one)]).max() < 0.011


def test_one_number_of_noise_is_for_every_state_and_none_is_none():
    one = Configuration.from_flat({'plant.noise': [0.5], 'loop.seed': 3})
    two = Configuration.from_flat({'plant.noise': [0.5, 0.5], 'loop.seed': 3})
    assert np.array_equal(measurement_noise(one, 10), measurement_noise(two, 10))
    assert not measurement_noise(Configuration.from_flat({}), 10).any()


def test_estimates_do_not_depend_on_the_rate():
    """θ̂, φ̂ at 5 s within 1 % of their ranges [0.1, 3], [0.3, 2.5] at 100, 200 and 400 Hz."""
    ends = []
    for rate in (100.0, 200.0, 400.0):
        found = run(loop__rate=rate, loop__duration=5.0)
        assert found.t[-1] == pytest.approx(5.0)
        ends.append([found.column(name)[-1] for name in ('theta1', 'theta2', 'phi')])
    spread = np.ptp(ends, axis=0)
    assert (spread <= 0.01 * np.array([2.9, 2.9, 2.2])).all()


def test_a_run_is_read_only_and_knows_its_columns():
    found = run(loop__duration=0.1)
    assert found.terms.shape == (21, STATUS + 1 + 3)
    for array in (found.t, found.x, found.x_measured, found.x_d, found.v, found.terms):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = 1.0
    with pytest.raises(KeyError, match='theta1'):
        found.column('theta9')


def test_a_drifting_dead_zone_drifts_within_the_sample():
    """Against scipy, over one sample in which the break point passes the command."""
    from scipy import integrate
    keys = {'loop__rate': 1.0, 'loop__duration': 1.0, 'plant__substeps': 1000,
            'plant__dead_zone__b_r': 2.0, 'plant__dead_zone__b_r_drift': [1.5, 4.0],
            'controller__law': 'pd', 'controller__k_d': 0.4, 'plant__x0': [-2.5, 3.5],
            'trajectory__amplitude': 5.0}
    found = run(**keys)
    v = found.v[0]
    assert 0.5 < v < 3.5

    def move(t, x):
        w = max(v - 2.0 - 1.5 * np.sin(4.0 * t), 0.0)
        return [x[1], np.tanh(x[0] / 2.0) - (x[0] ** 2 + 2.0 * x[0]) * np.sin(x[0])
                - 0.5 * x[0] * np.sin(3.0 * t) + w]

    expected = integrate.solve_ivp(move, (0.0, 1.0), [-2.5, 3.5], 'DOP853', rtol=1e-10,
                                   atol=1e-10, max_step=1e-3).y[:, -1]
    assert found.x[1] == pytest.approx(expected, abs=1e-6)
