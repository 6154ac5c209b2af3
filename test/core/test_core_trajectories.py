# SPDX-License-Identifier: Apache-2.0
"""Trajectories: derivatives that integrate to one another, and values from other programs."""

import math

from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import interpolate, signal, stats

from dz_ros.core import schema
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.core.trajectories.smooth_step import CONTINUOUS, smooth_step
from dz_ros.core.trajectories.spline import spline
from dz_ros.errors import ConfigurationError

TIMES = (1.0, 2.5, 3.0, 6.0)
POSITIONS = (0.5, -1.0, -0.8, 0.5)
CASES = {
    'sinusoid': ('sinusoid', {'amplitude': 2.0, 'frequency': 1.7, 'phase': 0.3, 'offset': 0.4}),
    'constant': ('constant', {'value': -1.25}),
    'multisine': ('multisine', {'amplitudes': [1.5, -0.3, 0.2], 'frequencies': [0.7, 1.9, 3.1],
                                'phases': [0.1, 0.2, 0.3], 'offset': 0.5}),
    'chirp': ('chirp', {'amplitude': 1.5, 'start_frequency': 0.5, 'end_frequency': 4.0,
                        'duration': 8.0, 'fade': 1.5, 'offset': 0.3}),
    'falling chirp': ('chirp', {'start_frequency': 4.0, 'end_frequency': 0.5, 'duration': 4.0}),
    'point to point': ('point_to_point', {'start': 1.0, 'goal': -2.0, 't_start': 0.7,
                                          'duration': 2.0}),
    'back and forth': ('point_to_point', {'t_start': 0.5, 'duration': 1.5, 'repeat': True,
                                          'dwell': 0.5}),
    'without dwell': ('point_to_point', {'t_start': 0.0, 'duration': 1.5, 'repeat': True,
                                         'dwell': 0.0}),
    'reference model': ('reference_model', {'start': 0.5, 'goal': 2.0, 't_start': 0.6,
                                            'bandwidth': 3.0}),
    'waypoints': ('waypoints', {'times': TIMES, 'positions': POSITIONS}),
    'waypoints again': ('waypoints', {'times': TIMES, 'positions': POSITIONS, 'repeat': True}),
    'two waypoints': ('waypoints', {'times': (0.0, 4.0), 'positions': (0.0, 1.0)}),
}
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


def make(kind, values, order=3):
    trajectory = TRAJECTORIES.load(kind)
    return trajectory(schema.build(trajectory.Parameters, values, 'trajectory.'), order)


def test_every_builtin_trajectory_is_tried():
    assert {kind for kind, _ in CASES.values()} == set(TRAJECTORIES.builtin)


@pytest.mark.parametrize('order', [1, 2, 3, 4])
@pytest.mark.parametrize('case', CASES)
def test_each_derivative_integrates_to_the_one_before(case, order):
    """Holds across every join too, so no derivative below the last jumps."""
    trajectory = make(*CASES[case], order=order)
    edges = np.arange(0.0, 12.0, 0.05)
    width = edges[1] - edges[0]
    at_edges = np.array([trajectory(t) for t in edges])
    inside = np.array([[trajectory(left + 0.5 * width * (1.0 + node)) for node in NODES]
                       for left in edges[:-1]])
    steps = 0.5 * width * np.einsum('j,kji->ki', WEIGHTS, inside)
    scale = np.abs(inside).max(axis=(0, 1)) + 1e-3
    for i in range(order):
        # A join inside an interval costs the quadrature some digits where x_d^(n) has a corner.
        wrong = np.abs(np.diff(at_edges[:, i]) - steps[:, i + 1])
        assert wrong.max() <= (1e-6 if i == order - 1 else 1e-9) * scale[i + 1]


@pytest.mark.parametrize('case', CASES)
def test_the_last_derivative_does_not_jump(case):
    for order in (1, 2, 3):
        trajectory = make(*CASES[case], order=order)
        t = np.arange(0.0, 12.0, 1e-3)
        last = np.array([trajectory(time)[-1] for time in t])
        assert np.abs(np.diff(last)).max() <= 0.02 * (np.abs(last).max() + 1e-12)


@pytest.mark.parametrize('case', [case for case, (kind, _) in CASES.items()
                                  if kind not in ('waypoints', 'reference_model')])
def test_lower_derivatives_do_not_depend_on_how_many_are_asked(case):
    """Except where the curve itself is made for the order of the plant."""
    high, low = make(*CASES[case], order=4), make(*CASES[case], order=2)
    for t in np.linspace(0.0, 12.0, 57):
        assert high(t)[:3] == low(t)


def test_multisine_is_the_sum_of_its_sinusoids():
    trajectory = make(*CASES['multisine'])
    values = CASES['multisine'][1]
    for t in (0.0, 0.37, 5.0, 123.4):
        phasors = [a * np.exp(1j * (w * t + p)) * (1j * w) ** np.arange(4) for a, w, p in zip(
            values['amplitudes'], values['frequencies'], values['phases'], strict=True)]
        expected = np.imag(np.sum(phasors, axis=0)) + np.array([0.5, 0.0, 0.0, 0.0])
        assert trajectory(t) == pytest.approx(expected, abs=1e-12)


def test_multisine_takes_one_phase_and_one_amplitude_for_all():
    short = make('multisine', {'amplitudes': [2.0], 'frequencies': [1.0, 2.0], 'phases': [0.1]})
    long = make('multisine', {'amplitudes': [2.0, 2.0], 'frequencies': [1.0, 2.0],
                              'phases': [0.1, 0.1]})
    assert short(3.3) == long(3.3)


def test_chirp_is_scipy_s_between_the_fades():
    trajectory = make(*CASES['chirp'])
    for t in np.linspace(1.5, 6.5, 40):
        expected = signal.chirp(t, 0.5 / (2.0 * math.pi), 8.0, 4.0 / (2.0 * math.pi), phi=-90.0)
        assert trajectory(t)[0] == pytest.approx(0.3 + 1.5 * expected, abs=1e-12)


def test_chirp_rests_before_and_after():
    trajectory = make(*CASES['chirp'])
    for t in (-1.0, 0.0, 8.0, 1e6):
        assert trajectory(t) == (0.3, 0.0, 0.0, 0.0)


def test_smooth_step_is_the_polynomial_of_its_end_conditions():
    ends = [[0.0] * (CONTINUOUS + 1), [1.0] + [0.0] * CONTINUOUS]
    expected = interpolate.BPoly.from_derivatives([0.0, 1.0], ends)
    for u in np.linspace(0.001, 0.999, 101):
        for derivative in range(CONTINUOUS + 1):
            assert smooth_step(u, derivative) == pytest.approx(
                expected(u, nu=derivative), abs=1e-9)
    speeds = [smooth_step(u, 1) for u in np.linspace(0.0, 1.0, 2001)]
    accelerations = [smooth_step(u, 2) for u in np.linspace(0.0, 1.0, 2001)]
    assert max(speeds) == pytest.approx(2.46, abs=5e-3)
    assert max(accelerations) == pytest.approx(9.37, abs=5e-3)


def test_point_to_point_starts_and_ends_exactly():
    trajectory = make(*CASES['point to point'])
    assert trajectory(0.0) == trajectory(0.7) == (1.0, 0.0, 0.0, 0.0)
    assert trajectory(1.7)[0] == pytest.approx(-0.5)
    assert trajectory(2.7) == trajectory(1e9) == (-2.0, 0.0, 0.0, 0.0)


def test_back_and_forth_is_the_same_way_back():
    trajectory = make(*CASES['back and forth'])
    there = np.array([trajectory(0.5 + t) for t in np.linspace(0.0, 2.0, 41)])
    back = np.array([trajectory(2.5 + t) for t in np.linspace(0.0, 2.0, 41)])
    again = np.array([trajectory(404.5 + t) for t in np.linspace(0.0, 2.0, 41)])
    assert back[:, 0] == pytest.approx(1.0 - there[:, 0], abs=1e-12)
    assert again == pytest.approx(there, abs=1e-8)
    assert trajectory(2.1) == (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize('order', [1, 2, 3, 4])
def test_reference_model_is_the_erlang_distribution(order):
    trajectory = make(*CASES['reference model'], order=order)
    expected = stats.erlang(order + 1, loc=0.6, scale=1.0 / 3.0)
    for t in np.linspace(0.0, 6.0, 61):
        assert trajectory(t)[0] == pytest.approx(0.5 + 1.5 * expected.cdf(t), abs=1e-12)
        assert trajectory(t)[1] == pytest.approx(1.5 * expected.pdf(t), abs=1e-12)
    assert trajectory(1e9) == pytest.approx((2.0,) + (0.0,) * order)


@pytest.mark.parametrize('order', [1, 2, 3, 4])
@pytest.mark.parametrize('count', [2, 3, 4, 30])
def test_waypoints_are_scipy_s_clamped_spline(order, count):
    generator = np.random.default_rng(count)
    times = np.cumsum(generator.uniform(0.3, 3.0, count))
    positions = generator.normal(size=count)
    trajectory = make('waypoints', {'times': times, 'positions': positions}, order)
    rest = ([(i, 0.0) for i in range(1, order + 1)],) * 2
    expected = interpolate.make_interp_spline(times, positions, 2 * order + 1, bc_type=rest)
    inside = np.linspace(times[0], times[-1], 201)[1:-1]
    found = np.array([trajectory(t) for t in inside])
    for i in range(order + 1):
        scale = np.abs(expected(inside, i)).max()
        assert found[:, i] == pytest.approx(expected(inside, i), abs=1e-7 * scale)
    assert trajectory(times[0] - 1.0) == (positions[0],) + (0.0,) * order
    assert trajectory(times[-1]) == (positions[-1],) + (0.0,) * order
    assert [trajectory(t)[0] for t in times] == pytest.approx(positions, abs=1e-9)


@pytest.mark.parametrize('count', [31, 64, 5000])
@pytest.mark.parametrize(('order', 'shortest', 'tolerance'), [
    (1, 3e-4, 1e-9), (2, 0.03, 1e-7), (3, 0.3, 1e-7)])
def test_pieces_of_a_long_spline_fit_together(order, shortest, tolerance, count):
    """At each inner point the derivatives 1 … 2n of both pieces agree, for uneven times too."""
    generator = np.random.default_rng(count)
    lengths = np.exp(generator.uniform(np.log(shortest), np.log(3.0), count - 1))
    times = np.concatenate(([0.0], np.cumsum(lengths)))
    positions = generator.normal(size=count)
    pieces = spline(times, positions, order)
    powers = np.arange(2 * order + 2)
    assert pieces[:, 0] == pytest.approx(positions[:-1], abs=1e-9)
    assert pieces.sum(axis=1) == pytest.approx(positions[1:], abs=1e-9)
    for m in range(1, 2 * order + 1):
        factors = np.array([math.perm(j, m) for j in powers], dtype=float)
        terms = pieces * factors / np.diff(times)[:, None] ** m
        ends, starts = terms.sum(axis=1)[:-1], terms[1:, m]
        scale = np.abs(terms).max(axis=1)
        assert np.all(np.abs(ends - starts) <= tolerance * np.maximum(scale[:-1], scale[1:]))


def test_two_waypoints_of_a_plant_of_order_four_are_point_to_point():
    spline = make(*CASES['two waypoints'], order=4)
    step = make('point_to_point', {'t_start': 0.0, 'duration': 4.0}, 4)
    for t in np.linspace(0.0, 5.0, 21):
        assert spline(t) == pytest.approx(step(t), abs=1e-9)


@settings(max_examples=3 * settings.default.max_examples // 10, deadline=None)
@example([(1.0, 0.0), (0.1015625, 1.0), *[(1.0, 0.0)] * 3, (4.0, 0.0), *[(5.0, 0.0)] * 2], 1)
@given(st.lists(st.tuples(st.floats(0.1, 5.0), st.floats(-10.0, 10.0)), min_size=2, max_size=12),
       st.integers(1, 3))
def test_waypoints_pass_every_point_and_rest_at_the_ends(points, order):
    """|x'| at a distance h from an end is at most h·max |x''| of the end's piece, of length L.

    There x' is a polynomial of degree 2n, so |x''| ≤ 2 (2n)²/L · max |x'| (Markov). The largest
    |x'| at 50 Chebyshev points is at least 0.98 of the true one.
    """
    times = np.cumsum([gap for gap, _ in points])
    positions = [position for _, position in points]
    trajectory = make('waypoints', {'times': times, 'positions': positions}, order)
    assert [trajectory(t)[0] for t in times] == pytest.approx(positions, abs=1e-6)
    points_of_piece = (1.0 - np.cos(np.pi * (np.arange(50) + 0.5) / 50)) / 2
    for end, other in ((times[0], times[1]), (times[-1], times[-2])):
        h = 1e-9 * (other - end)
        top = max(abs(trajectory(end + u * (other - end))[1]) for u in points_of_piece) / 0.98
        rounding = 1e-9 + 1e-12 * top
        assert abs(trajectory(end + h)[1]) <= 1.01 * 1e-9 * 8 * order**2 * top + rounding


def test_many_waypoints_of_a_smooth_curve_reproduce_its_derivatives():
    times = np.linspace(0.0, 20.0, 401)
    trajectory = make('waypoints', {'times': times, 'positions': np.sin(times)}, 3)
    for t in np.linspace(5.0, 15.0, 33):
        assert trajectory(t) == pytest.approx(
            (math.sin(t), math.cos(t), -math.sin(t), -math.cos(t)), abs=1e-6)


@pytest.mark.parametrize(('kind', 'values', 'key', 'reports'), [
    ('multisine', {'frequencies': []}, 'frequencies', 'at least one'),
    ('multisine', {'frequencies': [-1.0, 1.0]}, 'frequencies', '>= 0'),
    ('multisine', {'amplitudes': [1.0, 2.0, 3.0]}, 'amplitudes', '1 or 2'),
    ('multisine', {'phases': [1.0, 2.0, 3.0]}, 'phases', '1 or 2'),
    ('multisine', {'frequencies': [1.0]}, 'amplitudes', '1 number'),
    ('chirp', {'duration': 0.0}, 'duration', '> 0'),
    ('chirp', {'duration': 3.0}, 'fade', 'at most half'),
    ('chirp', {'fade': 0.0}, 'fade', '> 0'),
    ('point_to_point', {'duration': 0.0}, 'duration', '> 0'),
    ('point_to_point', {'dwell': -1.0}, 'dwell', '>= 0'),
    ('point_to_point', {'repeat': 1}, 'repeat', 'true or false'),
    ('reference_model', {'bandwidth': -2.0}, 'bandwidth', '> 0'),
    ('constant', {'value': math.nan}, 'value', 'finite'),
    ('waypoints', {}, 'times', 'at least 2'),
    ('waypoints', {'times': [1.0], 'positions': [1.0]}, 'times', 'at least 2'),
    ('waypoints', {'file': 'curve.csv'}, 'file', 'has not been read'),
    ('waypoints', {'times': [0.0, 1.0], 'positions': [1.0]}, 'positions', '2 numbers'),
    ('waypoints', {'times': [0.0, 1.0, 1.0], 'positions': [1.0] * 3}, 'times', 'increase'),
    ('waypoints', {'times': [-1.0, 1.0], 'positions': [1.0] * 2}, 'times', '>= 0'),
    ('waypoints', {'times': [0.0, 1.0], 'positions': [1.0, 2.0], 'repeat': True}, 'repeat',
     'to be the first'),
])
def test_refuses_with_key_and_what_is_allowed(kind, values, key, reports):
    with pytest.raises(ConfigurationError) as caught:
        make(kind, values)
    assert caught.value.key == f'trajectory.{key}'
    assert reports in str(caught.value)
    assert '\n' not in str(caught.value)


def test_waypoints_without_points_cannot_be_made_directly_either():
    with pytest.raises(ConfigurationError):
        TRAJECTORIES.load('waypoints')()


def test_a_long_list_is_not_printed_whole():
    times = list(range(1000))
    with pytest.raises(ConfigurationError) as caught:
        make('waypoints', {'times': times, 'positions': [0.0] * 999})
    assert len(str(caught.value)) < 200
