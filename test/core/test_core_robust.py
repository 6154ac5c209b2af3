# SPDX-License-Identifier: Apache-2.0
"""The recommended law: reference run, every step against a program of its own, guard."""

from pathlib import Path

import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws.robust import layer, Robust, RobustGains
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Status
from dz_ros.core.signals import STATUS
from dz_ros.errors import ConfigurationError

DATA = Path(__file__).parents[1] / 'data'
PERIOD = 0.005


def make(order=2, count=2, period=PERIOD, **values):
    return Robust(schema.build(RobustGains, values, 'controller.'), order, count, period)


def run(**values):
    return simulate(Configuration.from_flat({
        'controller.law': 'robust', **{key.replace('__', '.'): value
                                       for key, value in values.items()}}))


def test_is_the_reference_run():
    """Every sample of the reference file, computed by another program."""
    expected = np.loadtxt(DATA / 'robust_lambda1_rk4.csv', delimiter=',', skiprows=2)
    found = run(plant__substeps=1)
    assert len(found.t) == len(expected) == 4001
    assert np.abs(found.t - expected[:, 1]).max() < 1e-9
    assert np.abs(found.x - expected[:, 2:4]).max() < 1e-9
    for name, column in (('theta1', 5), ('theta2', 6), ('phi', 7), ('v_integral', 8), ('s', 9),
                         ('s_eps', 10)):
        assert np.abs(found.column(name) - expected[:, column]).max() < 1e-9, name
    assert np.abs(found.v - expected[:, 4]).max() < 1e-7
    assert (found.column('kappa_f') == 1.0).all()  # the guard never fires
    assert (expected[:, 11] == 1.0).all()


def test_the_layer_follows_from_the_rate():
    gain, epsilon = layer(RobustGains(), PERIOD)
    assert gain == pytest.approx(0.445 / (1.25 * 0.005))
    assert epsilon == pytest.approx(2.5 / (gain - 10.0))
    assert layer(RobustGains(), 0.001)[0] == 120.0   # K_cap
    assert layer(RobustGains(), 0.1)[0] == 15.0      # 1.5 k_d
    # the guard may take K to 1.5 k_d and no further
    assert [round(layer(RobustGains(), PERIOD, 0.7 ** i)[0], 1) for i in range(8)] == [
        71.2, 49.8, 34.9, 24.4, 17.1, 15.0, 15.0, 15.0]


class Program:
    """The law written down again, from its description, with an object's own state."""

    def __init__(self, g, order, count, period):
        self.g, self.period = g, period
        self.weights = np.poly([-g.lambda_] * (order - 1))[::-1] if order > 1 else np.ones(1)
        self.rates = np.concatenate(([0.0], self.weights[:-1]))
        self.estimates = np.append(np.full(count, g.theta_0[0]), g.phi_0)
        self.low = np.append(np.full(count, g.theta_min[0]), g.phi_min)
        self.high = np.append(np.full(count, g.theta_max[0]), g.phi_max)
        self.speeds = np.append(np.full(count, g.gamma), g.eta)
        self.v_i, self.kappa, self.before, self.v_before = 0.0, 1.0, None, 0.0
        self.side = self.since = self.count = 0
        self.guard_steps = self.frozen = self.retreats = self.identified = 0

    def saturated(self, v):
        return self.g.v_max > 0.0 and abs(v) > self.g.v_max

    def __call__(self, x_d, x, y, dt):
        g = self.g
        mu = 2.0 * np.sin(np.pi / (2 * (2 * g.design_delay + 1)))
        gain = max(min(self.kappa * g.margin * mu / (g.beta * self.period), g.gain_cap),
                   1.5 * g.k_d)
        eps = g.k_star / (gain - g.k_d)
        error = x - x_d[:-1]
        s = self.weights @ error
        now = np.append(y, x_d[-1] - self.rates @ error)
        s_a = s - np.clip(s, -1.5 * eps, 1.5 * eps)
        if self.before is not None:
            if self.saturated(self.v_before) and self.v_before * s < 0.0:
                self.frozen += 1
            else:
                n = 1.0 + dt * (self.speeds @ self.before ** 2) / g.k_d
                self.estimates = np.clip(
                    self.estimates - dt * self.speeds * self.before * s_a / n, self.low, self.high)
        self.guard(int(np.sign(s)) if abs(s) >= eps else 0)
        if g.identifier and abs(s) <= eps and not self.saturated(self.v_before) \
                and self.before is not None:
            p = gain * s + self.v_i
            step = dt * (p - np.clip(p, -1.0, 1.0)) / (1.0 + self.before @ self.before)
            moved = np.clip(self.estimates - step * self.before, self.low, self.high)
            self.v_i = np.clip(self.v_i + self.before @ (moved - self.estimates), -g.rho_1,
                               g.rho_1)
            self.estimates = moved
            self.identified += step != 0.0
        w = self.v_i
        if abs(s) > eps and w * s < 0.0:
            limit = g.rho_1 + (g.rho_0 - g.rho_1) * np.clip((abs(s) - eps) / (0.5 * eps), 0, 1)
            w = np.clip(w, -limit, limit)
            self.retreats += w != self.v_i
        v_b = now @ self.estimates - g.k_d * s - g.k_star * np.clip(s / eps, -1.0, 1.0) - w
        if self.before is None:
            self.v_first = max(abs(v_b), g.v_floor)
        limit = max(abs(v_b), self.v_first)
        v = np.clip(v_b - g.k_2 * s_a, -limit, limit)
        if abs(s) <= eps and not self.saturated(v):
            self.v_i = np.clip(self.v_i + dt * gain ** 2 / g.integral_divisor * s, -g.rho_1,
                               g.rho_1)
        self.before, self.v_before = now, v
        return v

    def guard(self, side):
        self.since += 1
        if side == 0:
            return
        if self.since > 0.25 / self.period:
            self.count = 0
        elif side == -self.side:
            self.count += 1
        self.side, self.since = side, 0
        if self.count >= 3:
            self.kappa *= 0.7
            self.count = self.side = 0
            self.guard_steps += 1


def disturbed(order, count, samples, seed):
    """Return references, states that swing through the layer now slowly now fast, regressors."""
    generator = np.random.default_rng(seed)
    t = PERIOD * np.arange(samples)[:, None]
    i = np.arange(order + 1)
    x_d = 1.5 * np.sin(1.3 * t + 0.5 * np.pi * i) * 1.3 ** i
    size = 0.3 * (np.sin(2.0 * t) ** 2 + 0.1)
    shape = np.where(np.sin(1.1 * t) > 0.0, np.sin(120.0 * t + i[:-1]), np.sin(3.0 * t + i[:-1]))
    x = x_d[:, :-1] + size * shape
    y = 2.0 * np.sin(generator.uniform(0.5, 3.0, count) * t + np.arange(count))
    return x_d, x, y


@pytest.mark.parametrize('values', [
    {}, {'v_max': 3.0}, {'identifier': True, 'k_2': 0.0}, {'v_floor': 40.0, 'rho_1': 0.5},
    {'identifier': True, 'v_max': 4.0, 'design_delay': 0, 'lambda': 2.5, 'rho_0': 0.1,
     'rho_1': 0.6, 'theta_max': [0.9], 'phi_min': 0.84, 'gamma': 5.0, 'eta': 5.0}])
@pytest.mark.parametrize(('order', 'count'), [(1, 0), (1, 2), (2, 2), (3, 1), (4, 3)])
def test_is_the_program_of_its_description(values, order, count):
    law = make(order, count, **values)
    program = Program(law.gains, order, count, PERIOD)
    intervals = np.random.default_rng(1).uniform(0.5 * PERIOD, 2.0 * PERIOD, 2000).tolist()
    x_d, x, y = disturbed(order, count, 2000, seed=order)
    memory = list(law.initial_memory())
    terms = [0.0] * (STATUS + 1 + len(law.signal_names))
    names = dict(zip(law.signal_names, range(STATUS + 1, 999), strict=False))
    for k in range(2000):
        new_memory = [0.0] * len(memory)
        v = law.kernel(law.constants, memory, x_d[k].tolist(), x[k].tolist(), y[k].tolist(),
                       intervals[k], new_memory, terms)
        memory = new_memory
        assert v == pytest.approx(program(x_d[k], x[k], y[k], intervals[k]), rel=1e-9, abs=1e-9)
        assert terms[STATUS + 1:STATUS + 2 + count] == pytest.approx(program.estimates, abs=1e-9)
        assert terms[names['v_integral']] == pytest.approx(program.v_i, rel=1e-9, abs=1e-9)
        assert terms[names['kappa_f']] == pytest.approx(program.kappa, rel=1e-12)
    # the inputs exercised what there is to exercise
    assert program.guard_steps > 0
    if 'v_max' in values:
        assert program.frozen > 0
    if values.get('identifier') and count:
        assert program.identified > 0


def guarded(sides, spacing=1, law=None):
    """Return the published numbers after pushing s to the given sides, one every few samples."""
    law = law or make()
    memory = law.initial_memory()
    kappa = []
    for side in sides:
        for k in range(spacing):
            s = 1.0 * side if k == 0 else 0.0
            terms = [0.0] * (STATUS + 1 + len(law.signal_names))
            new_memory = [0.0] * len(memory)
            law.kernel(law.constants, memory, (0.0, 0.0, 0.0), (0.0, s), (0.0, 0.0), PERIOD,
                       new_memory, terms)
            memory = tuple(new_memory)
        kappa.append(terms[STATUS + 1 + law.signal_names.index('kappa_f')])
    return kappa, memory


def test_guard_steps_after_three_changes_of_side_and_latches():
    kappa, _ = guarded([1, -1, 1, -1, 0, 0, 1, 1, 1])
    assert kappa == pytest.approx([1, 1, 1, 0.7, 0.7, 0.7, 0.7, 0.7, 0.7])
    # counting starts again: the next three changes step again
    kappa, _ = guarded([1, -1, 1, -1, 1, -1, 1, -1])
    assert kappa[-1] == pytest.approx(0.49)


def test_guard_ignores_slow_changes_and_staying_on_a_side():
    assert guarded([1, -1] * 6, spacing=51)[0][-1] == 1.0   # 0.255 s apart
    assert guarded([1, -1] * 6, spacing=50)[0][-1] < 1.0    # 0.25 s apart
    assert guarded([1, 1, 1, 1, 1, 1, -1, -1, -1, -1])[0][-1] == 1.0


def test_reset_guard_gives_the_full_gain_back_and_touches_nothing_else():
    law = make()
    _, memory = guarded([1, -1, 1, -1, 1, -1], law=law)
    names = law.memory_names
    at = names.index('kappa_f')
    assert memory[at] == pytest.approx(0.7)
    reset = law.reset_guard(memory)
    assert reset[at:at + 4] == (1.0, 0.0, 0.0, 0.0)
    assert reset[:at] == memory[:at]
    assert reset[at + 4:] == memory[at + 4:]
    assert law.reset_guard(law.initial_memory()) == law.initial_memory()


def variation(found, start, stop):
    """Return the total variation of v per second in [start, stop) seconds."""
    part = (found.t >= start) & (found.t < stop)
    return np.abs(np.diff(found.v[part])).sum() / (stop - start)


def test_guard_ends_the_oscillation_of_a_loop_that_is_later_than_designed():
    """Four samples of delay instead of one: the cycle lasts until the guard has stepped."""
    found = run(loop__delay=4)
    kappa, gain = found.column('kappa_f'), found.column('gain')
    steps = found.t[np.nonzero(np.diff(kappa))]
    assert len(steps) == 2
    assert kappa[-1] == pytest.approx(0.49)
    assert gain[-1] == pytest.approx(0.49 * 71.2)
    assert variation(found, 2.0, steps[-1]) > 50.0
    assert variation(found, 10.0, 20.0) < 8.0
    assert np.abs(found.x - found.x_d[:, :2])[found.t > 10.0, 0].max() < 0.005


def test_outer_gain_uses_no_more_than_the_actuator_gave_already():
    found = run()
    extra = found.column('v_extra') + found.column('v_inner')
    base = found.v - extra
    first = np.abs(base[0])
    assert (np.abs(found.v) <= np.maximum(np.abs(base), first) + 1e-9).all()
    assert np.abs(extra).max() > 1.0                      # it does work in the transient
    assert np.abs(found.v).max() == pytest.approx(16.735, abs=1e-3)


def test_estimates_stay_in_their_box():
    found = run(controller__gamma=50.0, controller__eta=50.0, loop__duration=5.0)
    for name, low, high in (('theta1', 0.1, 3.0), ('theta2', 0.1, 3.0), ('phi', 0.3, 2.5)):
        values = found.column(name)
        assert low <= values.min()
        assert values.max() <= high
    assert found.column('theta2').min() == 0.1            # and reach it


def test_saturation_is_published_and_freezes_the_integral():
    found = run(controller__v_max=4.0, loop__duration=10.0)
    status = found.column('status').astype(int)
    assert set(status) == {0, int(Status.SATURATED)}
    inside = np.abs(found.column('s')) <= found.column('epsilon')
    over = np.abs(found.v) > 4.0
    assert (inside & over).any()
    integral, before = found.column('v_integral'), found.column('v_integral_before')
    assert (integral == before)[inside & over].all()
    assert (status[inside & over] == int(Status.SATURATED)).all()


@pytest.mark.parametrize(('values', 'key'), [
    ({'theta_0': [5.0]}, 'theta_0'), ({'phi_0': 0.2}, 'phi_0'),
    ({'theta_min': [4.0]}, 'theta_min'), ({'phi_max': 0.1}, 'phi_min'),
    ({'theta_min': [0.1, 0.1, 0.1]}, 'theta_min'), ({'k_star': 0.0}, 'k_star'),
    ({'margin': 1.5}, 'margin')])
def test_refuses_gains_that_do_not_fit(values, key):
    with pytest.raises(ConfigurationError) as caught:
        make(**values)
    assert caught.value.key == f'controller.{key}'


def test_estimates_agree_between_rates():
    """100, 200 and 400 Hz: estimates at 5 s within 1 % of their range (one layer for all)."""
    ends = []
    for rate in (100.0, 200.0, 400.0):
        found = run(loop__rate=rate, loop__duration=5.0, controller__gain_cap=35.0)
        ends.append([found.column(name)[-1] for name in ('theta1', 'theta2', 'phi')])
    spread = np.ptp(np.asarray(ends), axis=0)
    assert (spread < 0.01 * np.array([2.9, 2.9, 2.2])).all(), ends
