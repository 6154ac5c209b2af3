# SPDX-License-Identifier: Apache-2.0
"""`coupled_eso`: its kernel of one axis against the law of all axes written with matrices."""

from math import comb

import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.axes import Rows
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws.coupled_eso import CoupledEso
from dz_ros.core.loop.controllers import controller_of
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.plants.two_link_arm import TwoLinkArm
from dz_ros.core.records import Reference, State
from dz_ros.core.signals import STATUS
from dz_ros.errors import ConfigurationError

PERIOD = 0.005
AXES, COUNT = 3, 4
INERTIA = np.array([[2.0, 0.3, -0.2], [0.3, 1.2, 0.4], [-0.2, 0.4, 0.8]])


def make(axis, order=2, inertia=INERTIA, count=COUNT, **values):
    given = {'inertia': np.ravel(inertia).tolist(), 'axis': axis, **values}
    return CoupledEso(schema.build(CoupledEso.Gains, given, 'controller.'), order, count, PERIOD)


class Together:
    """The law of all axes in one step; it predicts at the end of a sample."""

    def __init__(self, order, inertia, count, gains):
        axes = len(inertia)
        self.n, self.inertia, self.g = order, inertia, gains
        self.theta = np.tile(gains['theta_0'], (axes, 1))
        self.observed = np.zeros((3, axes))         # ŝ, σ̂, σ̂'
        self.q = [np.zeros(axes)] * 3
        self.eta = None
        self.last = np.zeros((axes, count))
        self.v = np.zeros(axes)

    def step(self, x_d, x, y, dt):
        """Return v; x_d (axes, n + 1), x (axes, n), y (axes, r, 1 + 2 axes) all axes in order."""
        n, g = self.n, self.g
        lam, a = g['lambda'], g['start_rate']
        weights = np.array([comb(n - 1, i) * lam ** (n - 1 - i) for i in range(n)])
        shifted = np.concatenate([[0.0], weights[:-1]])
        first = self.eta is None
        eta = (x - x_d[:, :n] if a > 0.0 else np.zeros_like(x)) if first else self.eta
        top = -sum(comb(n, i) * a ** (n - i) * eta[:, i] for i in range(n))
        error = x - x_d[:, :n] - eta
        s, u = error @ weights, x_d[:, n] + top - error @ shifted
        axes = len(s)
        big = (y[:, :, 0] + y[:, :, 1:1 + axes] @ u + y[:, :, 1 + axes:] @ (x[:, -1] - s))
        layer = g['k_star'] / (g['kappa'] * np.diag(self.inertia))
        theta, observed = self.theta.copy(), self.observed.copy()
        if dt > 0.0:
            if not first:
                s_a = s - np.clip(s, -1.5 * layer, 1.5 * layer)
                norm = 1.0 + dt * g['gamma'] * (self.last ** 2).sum(1) / (
                    g['k_d'] * np.diag(self.inertia))
                moved = np.clip(theta - (dt * g['gamma'] * s_a / norm)[:, None] * self.last,
                                np.array(g['theta_min']), np.array(g['theta_max']))
                limit = g['v_max']
                held = (limit > 0.0) & (np.abs(self.v) >= limit) & (self.v * s < 0.0)
                theta = np.where(held[:, None], theta, moved)
            else:
                observed[0] = s
            z = np.exp(-g['observer_rate'] * dt)
            rest = s - observed[0]
            observed += np.outer([1.0 - z ** 3, 1.5 * (1.0 - z) ** 2 * (1.0 + z) / dt,
                                  (1.0 - z) ** 3 / dt ** 2], rest)
        slot = np.clip(self.inertia @ observed[1], -g['rho_1'], g['rho_1'])
        far = np.abs(s) > layer
        share = np.clip((np.abs(s) / layer - 1.0) / 0.5, 0.0, 1.0)
        most = g['rho_1'] + (g['rho_0'] - g['rho_1']) * share
        slot = np.where(far & (slot * s < 0.0), np.clip(slot, -most, most), slot)
        forward = (big * theta).sum(1)
        v = (forward - g['k_d'] * np.diag(self.inertia) * s
             - np.clip(g['kappa'] * self.inertia @ s, -g['k_star'], g['k_star']) - slot)
        if g['v_max'] > 0.0:
            v = np.clip(v, -g['v_max'], g['v_max'])
        if dt > 0.0:
            self.q = [np.linalg.solve(self.inertia, v - forward), *self.q[:2]]
            acts = self.q[g['design_delay']]
            observed[0] += PERIOD * (acts + observed[1]) + 0.5 * PERIOD ** 2 * observed[2]
            observed[1] += PERIOD * observed[2]
            self.theta, self.observed, self.last, self.v = theta, observed, big, v
            self.eta = self.shift(eta, a)
        return v, theta

    def shift(self, eta, a):
        """Return η one sample on, by the exponential of its companion matrix."""
        n = self.n
        companion = np.eye(n, k=1)
        companion[-1] = [-comb(n, i) * a ** (n - i) for i in range(n)]
        term = total = np.eye(n)
        for i in range(1, 25):
            term = term @ companion * PERIOD / i
            total = total + term
        return eta @ total.T


def own_first(rows, axis):
    return np.concatenate([np.ravel(rows[axis])] + [
        np.ravel(row) for i, row in enumerate(rows) if i != axis]).tolist()


@pytest.mark.parametrize('order', [1, 2, 3])
@pytest.mark.parametrize('values', [
    {}, {'design_delay': 0}, {'design_delay': 2, 'start_rate': 0.0}, {'v_max': 20.0}])
def test_kernels_of_all_axes_are_the_law_written_with_matrices(order, values):
    gains = {'lambda': 6.0, 'kappa': 40.0, 'k_d': 4.0, 'k_star': 3.0, 'gamma': 2.0,
             'theta_0': [1.0, 0.5, 2.0, 0.3], 'theta_min': [0.2] * 4, 'theta_max': [2.5] * 4,
             'start_rate': 1.5, 'observer_rate': 35.0, 'design_delay': 1, 'rho_0': 1.0,
             'rho_1': 30.0, 'v_max': 0.0, **values}
    laws = [make(axis, order, **gains) for axis in range(AXES)]
    laws[0].check_axes(dict(zip('abcdef', laws, strict=False)))
    memory = [law.initial_memory() for law in laws]
    together = Together(order, INERTIA, COUNT, gains)
    random = np.random.default_rng(4)
    saturated = froze = 0
    for k in range(120):
        dt = [PERIOD, PERIOD, 0.0075, 0.0][random.integers(4)] if k > 3 else PERIOD
        x_d = random.normal(size=(AXES, order + 1))
        x = x_d[:, :order] + random.choice([0.02, 0.5]) * random.normal(size=(AXES, order))
        y = random.normal(size=(AXES, COUNT, 1 + 2 * AXES))
        expected, theta = together.step(x_d, x, y, dt)
        after = []
        for axis, law in enumerate(laws):
            order_of = [axis, *(i for i in range(AXES) if i != axis)]
            columns = [0, *(1 + i for i in order_of), *(1 + AXES + i for i in order_of)]
            new = [0.0] * len(memory[axis])
            terms = [0.0] * (STATUS + 1 + len(law.signal_names))
            v = law.kernel(law.constants, own_first(memory, axis), own_first(x_d, axis),
                           own_first(x, axis), y[axis][:, columns].ravel().tolist(), dt, new,
                           terms)
            assert v == pytest.approx(expected[axis], rel=1e-9, abs=1e-9)
            np.testing.assert_allclose(terms[STATUS + 1:STATUS + 1 + COUNT], theta[axis],
                                       rtol=1e-9)
            assert law.memory_from_signals(terms[STATUS + 1:]) == tuple(memory[axis])
            assert sum(terms[3:STATUS]) == pytest.approx(v)
            froze += int(terms[STATUS]) != 0
            saturated += gains['v_max'] > 0.0 and abs(v) >= gains['v_max']
            after.append(tuple(new) if dt > 0.0 else memory[axis])
            if dt == 0.0:
                assert new == list(memory[axis])
        memory = after
    assert (saturated > 10) == (froze > 3) == (gains['v_max'] > 0.0)


def arm(**changed):
    weights = TwoLinkArm().weights
    cosine = np.cos(1.0)
    coupling = weights[2] + weights[1] * cosine
    return Configuration.from_flat({
        'plant.model': 'two_link_arm', 'controller.law': 'coupled_eso',
        'loop.axes': ['shoulder', 'elbow'], 'loop.duration': 6.0,
        'controller.inertia': [weights[0] + 2.0 * weights[1] * cosine, coupling, coupling,
                               weights[2]],
        'controller.theta_0': [0.8 * item for item in weights],
        'controller.theta_min': [0.1 * item for item in weights],
        'controller.theta_max': [3.0 * item for item in weights],
        'trajectory.kind': 'sinusoid', 'trajectory.amplitude': 0.5,
        'axes.elbow.trajectory.offset': 0.9, 'axes.elbow.plant.x0': [0.9, 0.0], **changed})


def test_two_joints_follow_behind_their_dead_zones():
    runs = simulate_axes(arm())
    for run in runs.values():
        late = run.t > 5.0
        shift = run.column('eta0')[late]
        assert np.abs(run.x[late, 0] - run.x_d[late, 0] - shift).max() < 0.002


def test_each_axis_reports_its_own_estimates():
    runs = simulate_axes(arm(**{'axes.elbow.controller.gamma': 0.0, 'loop.duration': 1.0,
                                'controller.start_rate': 0.0, 'controller.k_star': 0.5}))
    first, second = (run.column('theta1') for run in runs.values())
    assert np.ptp(first) > 0.0
    assert np.ptp(second) == 0.0


def test_an_axis_alone_has_its_own_inertia_as_feed_forward():
    law = make(1, count=2)
    memory, new = law.initial_memory(), [0.0] * len(law.initial_memory())
    terms = [0.0] * (STATUS + 1 + len(law.signal_names))
    v = law.kernel(law.constants, memory, (0.0, 0.0, 3.0), (0.0, 0.0), (2.0, 4.0), PERIOD, new,
                   terms)
    assert v == pytest.approx(INERTIA[1, 1] * 3.0 + 0.85 * 6.0)
    v = law.kernel(law.constants, memory, (0.0, 0.0, 3.0), (0.0, 0.0), (2.0,), PERIOD, new, terms)
    assert v == pytest.approx(INERTIA[1, 1] * 3.0)


@pytest.mark.parametrize(('changed', 'key'), [
    ({'controller.inertia': [1.0, 0.0, 0.0]}, 'controller.inertia'),
    ({'controller.inertia': [1.0, 2.0, 2.0, 1.0]}, 'controller.inertia'),
    ({'controller.inertia': [1.0, 0.1, 0.2, 1.0]}, 'controller.inertia'),
    ({'controller.inertia': [1.0]}, 'controller.inertia'),
    ({'axes.elbow.controller.lambda': 3.0}, 'controller.lambda'),
    ({'axes.elbow.controller.observer_rate': 30.0}, 'controller.observer_rate'),
    ({'controller.theta_0': [1.0, 2.0]}, 'controller.theta_0'),
    ({'controller.theta_max': [0.1]}, 'controller.theta_0')])
def test_gains_that_do_not_go_together_are_refused(changed, key):
    with pytest.raises(ConfigurationError) as caught:
        arm(**changed)
    assert caught.value.key.endswith(key)
    assert '\n' not in str(caught.value)


def test_take_over_keeps_the_estimates_only():
    law = make(0)
    memory = tuple(range(1, 1 + len(law.initial_memory())))
    taken = law.take_over(memory)
    assert taken[:COUNT] == memory[:COUNT]
    assert set(taken[COUNT:]) == {0.0}
    assert len(taken) == len(memory)


def test_controllers_of_the_nodes_give_the_commands_of_the_offline_loop():
    """Bit for bit: the same references and states, answered one by one."""
    c = arm(**{'loop.duration': 0.5, 'plant.noise': [1e-4, 1e-3], 'loop.delay': 1})
    runs = list(simulate_axes(c).values())
    controllers = controller_of(c)
    for k in range(len(runs[0].t)):
        stamp = k * c.loop.period
        controllers.set_reference(Rows(Reference(k, stamp, tuple(run.x_d[k])) for run in runs))
        commands, terms = controllers.respond(Rows(
            State(k, stamp, tuple(run.x_measured[k])) for run in runs))
        for run, command, row in zip(runs, commands, terms, strict=True):
            assert command.v == run.v[k]
            assert row.values == tuple(run.terms[k, :STATUS])
            assert row.signals == tuple(run.terms[k, STATUS + 1:])
