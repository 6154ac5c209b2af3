# SPDX-License-Identifier: Apache-2.0
"""The estimator of dead-zone and plant: integrals, least squares, bounds that hold the truth."""

import dataclasses
from pathlib import Path
import sys

import numpy as np
import pytest

from dz_ros.core import dataset
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import ERROR, worst
from dz_ros.core.design.rules import check
from dz_ros.core.loop.offline import simulate
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import RecordingError
from dz_ros.files.configurations import flat_parameters
from dz_ros.identification.estimation.bounds import parameter_bound, tolerance_factor
from dz_ros.identification.estimation.least_squares import hats, solve
from dz_ros.identification.estimation.pipeline import identify, identify_log
from dz_ros.identification.estimation.stretches import Cutter, Stack, Stretch
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.identification.experiment.session import run_session
from dz_ros.identification.proposal import known_bounds, propose
from dz_ros.identification.samples import from_run, motion_speed, to_run

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.seeded_devices import identified  # noqa: E402

pytestmark = pytest.mark.slow


def moved(flat, limits, repeats=4):
    c = Configuration.from_flat({**flat, 'loop.timing': 'lockstep'})
    experiment = Experiment(limits, Plan(repeats=repeats), c.plant.order, c.loop.period)
    return c, run_session(c, experiment, lambda seq: seq, lambda: ''), experiment.moving


SERVO = {'plant.model': 'servo', 'plant.dead_zone.m_l': 0.8, 'plant.inertia': 1.25}
SURGE = {'plant.model': 'first_order', 'plant.dead_zone.b_r': 8.0, 'plant.dead_zone.b_l': -7.0}
VALVE = {'plant.model': 'valve_actuator', 'plant.dead_zone.b_l': -0.4}


@pytest.mark.parametrize(('flat', 'limits'), [
    (SERVO, Limits(1.5, 1.0, 4.0)), (SURGE, Limits(0.5, 0.0, 40.0)),
    (VALVE, Limits(0.2, 0.1, 5.0))], ids=['order 2', 'order 1', 'order 3'])
def test_without_noise_and_drift_the_truth_is_found(flat, limits):
    c, samples, margin = moved(flat, limits)
    found = identify(samples, c, margin)
    zone, b = c.dead_zone, c.plant.b
    truth = (zone.b_r, zone.b_l, b * zone.m_r, b * zone.m_l)
    assert [item.value for item in found.bounds.values()] == pytest.approx(truth, rel=5e-3)
    assert found.a[:c.plant.regressor_count].tolist() == pytest.approx(c.plant.a, rel=1e-2)
    assert found.delay == 0


@pytest.mark.parametrize('delay', [1, 3])
def test_the_delay_is_found(delay):
    c, samples, margin = moved({**SERVO, 'loop.delay': delay, 'plant.noise': [1e-3, 1e-2]},
                               Limits(1.5, 1.0, 4.0))
    found = identify(samples, c, margin)
    assert found.delay == delay
    if delay == 1:
        proposal, notes = propose(c.replace(**{'loop.delay': 0}), found)
        assert proposal.after.loop.delay == delay
        assert any('loop.delay = 1' in note for note in notes)
        assert not any('loop.delay' in note for note in propose(c, found)[1])


class PositionOnly(SimulatedActuator):
    """Measures no velocity."""

    @property
    def measured(self):
        return 1

    def measure(self):
        return super().measure()[:1]


def test_a_driver_without_velocity_will_do():
    c, samples, margin = moved({**SERVO, 'plant.noise': [1e-4, 0.0],
                                'driver.name': f'{__name__}:PositionOnly'}, Limits(1.5, 1.0, 4.0))
    assert samples.measured == 1
    found = identify(samples, c, margin)
    truth = (0.5, -0.6, 0.8, 0.64)
    for item, value in zip(found.bounds.values(), truth, strict=True):
        assert item.value == pytest.approx(value, rel=0.05)


@pytest.mark.parametrize(('kind', 'count'), [('servo', 3), ('servo, no drift', 1),
                                             ('first_order', 1)])
def test_bounds_hold_the_truth_and_are_not_much_wider_than_the_drift(kind, count):
    devices = [identified(kind, 1000 + seed) for seed in range(count)]
    covered = np.array([item.covered for item in devices])
    assert covered.all()        # benchmarks/identify.py: all four in 100 of 100
    if 'no drift' in kind:
        assert all((item.drift == 0.0).all() for item in devices)
        return
    ratio = np.array([item.width / item.drift for item in devices])
    assert np.median(ratio) < 2.5
    assert ratio.max() < 3.5


# The pieces.

@pytest.mark.parametrize('times', [1, 2])
def test_a_stack_integrates_each_stretch_and_frees_it_of_constants(times):
    draw = np.random.default_rng(times)
    period = 0.01
    lengths = (30, 47)
    found = [Stretch(draw.normal(size=n), draw.normal(size=(n, 2)), draw.normal(size=n), 0,
                     0, (0, n - 1)) for n in lengths]
    stack = Stack(found, period, times)
    got = stack.integral(stack.v[:, np.newaxis])[:, 0]
    for item, (begin, end) in zip(found, stack.edges, strict=True):
        # Held from sample to sample, so integrated exactly on a grid a hundred times finer.
        fine = np.repeat(item.v, 100) * period / 100
        once = np.concatenate([[0.0], np.cumsum(fine)])
        wanted = once[:-1:100]
        if times == 2:
            within = 0.5 * (once[1:] + once[:-1]) * period / 100
            wanted = np.concatenate([[0.0], np.cumsum(within)])[:-1:100]
        basis = np.vander(np.arange(end - begin), times)
        wanted = wanted - basis @ np.linalg.lstsq(basis, wanted, rcond=None)[0]
        assert got[begin:end] == pytest.approx(wanted, abs=1e-12)


def test_hats_add_up_and_are_one_at_their_nodes():
    nodes = np.array([1.0, 2.5, 4.0])
    assert hats(nodes, nodes) == pytest.approx(np.eye(3))
    assert hats(np.linspace(0, 5, 40), nodes).sum(axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize(('count', 'content', 'factor'), [
    # ISO 16269-6 and Howe 1969, two-sided, confidence 0.95
    (10, 0.95, 3.379), (10, 0.9, 2.839), (20, 0.95, 2.752), (12, 0.9, 2.655)])
def test_tolerance_factor_is_the_tabulated_one(count, content, factor):
    assert tolerance_factor(count, content, 0.95) == pytest.approx(factor, rel=3e-3)


def test_bounds_of_values_that_agree_are_not_without_width():
    bound = parameter_bound('b_r', np.full(5, 0.5) - 1e-6, 0.0, 0.0)
    assert (bound.low, bound.high) == pytest.approx((0.4995, 0.5005), rel=1e-5)


@pytest.mark.parametrize(('name', 'sign'), [('b_r', -1.0), ('b_l', 1.0)])
def test_a_break_point_on_the_wrong_side_is_refused(name, sign):
    values = sign * np.array([0.50, 0.51, 0.49, 0.50, 0.52])
    with pytest.raises(RecordingError, match=rf'{name} seems to be -?0\.504, on the wrong side'):
        parameter_bound(name, values, 0.001, 0.001)
    right = parameter_bound(name, -values, 0.001, 0.001)
    assert right.low < right.high


def test_what_the_motion_does_not_show_is_reported():
    c, samples, margin = moved(SERVO, Limits(1.5, 1.0, 4.0))
    right = dataclasses.replace(samples, v=np.abs(samples.v))
    with pytest.raises(RecordingError, match='one sign only'):
        identify(right, c, margin)
    with pytest.raises(RecordingError, match='nothing to identify: 0 stretches'):
        identify(samples, c, 10.0)
    same = dataclasses.replace(samples, v=2.0 * np.sign(samples.v))
    with pytest.raises(RecordingError, match='does not distinguish'):
        identify(same, c, margin)
    once = dataclasses.replace(samples, repeat=np.where(samples.repeat < 1, samples.repeat, -1))
    with pytest.raises(RecordingError, match='1 repeats show motion'):
        identify(once, c, margin)
    found = Cutter(samples, c).moving(margin)
    assert solve(Stack(found, c.loop.period, 1)).residual < 1e-2


# From runs, and to configurations.

def test_an_experiment_written_as_a_run_reports_the_same():
    c, samples, margin = moved({**SERVO, 'plant.noise': [1e-3, 1e-2]}, Limits(1.5, 1.0, 4.0))
    again = from_run(to_run(samples, c, 10 ** 18), c)
    assert np.array_equal(again.x, samples.x)
    assert again.v == pytest.approx(samples.v, abs=1e-9)
    assert np.array_equal(again.repeat, samples.repeat)
    assert motion_speed(again) == pytest.approx(margin, rel=1.0)
    one, two = (identify(item, c, margin) for item in (samples, again))
    for name, bound in one.bounds.items():
        assert two.bounds[name].low == pytest.approx(bound.low, rel=1e-6)


@pytest.mark.parametrize(('flat', 'limits'), [
    ({**SERVO, 'plant.noise': [1e-3, 1e-2], 'controller.law': 'pd', 'loop.duration': 10.0},
     Limits(1.5, 1.0, 4.0)),
    ({**flat_parameters('first_order', []), 'plant.noise': [1e-3], 'plant.x0': [0.0]},
     Limits(0.5, 0.0, 40.0))], ids=['order 2', 'order 1'])
def test_the_proposed_configuration_keeps_the_design_rules_and_runs(flat, limits):
    c, samples, margin = moved(flat, limits)
    found = identify(samples, c, margin)
    bounds = known_bounds(c, found)
    proposal, notes = propose(c, found)
    after = proposal.after
    for key, value in bounds.items():
        assert after.to_flat()[key] == value
    findings = check(after)
    assert worst(findings) != ERROR
    assert not [item for item in findings if item.rule in ('chatter', '(A4)', 'projection')
                and item.level != 'info']
    known = after.controller_settings
    rho = max(known.m_bounds[1] * known.b_r_bounds[1], -known.m_bounds[1] * known.b_l_bounds[0])
    assert after.law.gains.k_star >= rho / known.m_bounds[0]
    assert after.law.name == ('robust' if c.law.name == 'pd' else c.law.name)
    assert bool(notes) == (c.law.name == 'pd')
    # It runs with the device as it really is, not only with the one that was found.
    truth = {key: value for key, value in c.to_flat().items() if key.startswith('plant.')}
    real = simulate(after.replace(**truth))
    half = len(real.t) // 2
    error = np.abs(real.x[half:, 0] - real.x_d[half:, 0]).max()
    assert error < 0.05 * np.abs(real.x_d[:, 0]).max()


def test_a_command_that_changes_in_every_block_leaves_the_picture_without_points():
    pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    from dz_ros.identification.characteristic_plot import draw, points

    c = Configuration.from_flat({
        **flat_parameters('servo'), 'plant.x0': [0.0, 0.0], 'plant.noise': [0.0005, 0.005],
        'trajectory.kind': 'sinusoid'})
    _, found = identify_log(dataset.from_run(simulate(c)), c)
    assert not len(points(found, c)[0])
    assert draw(found, c).figure.axes
