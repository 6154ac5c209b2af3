# SPDX-License-Identifier: Apache-2.0
"""The switches on the paper's law: off bit for bit, each alone, all together."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.boundary_layer import automatic_epsilon
from dz_ros.core.laws.extended import Extended, ExtendedGains
from dz_ros.core.laws.wang2004 import Wang2004, Wang2004Gains
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Status
from dz_ros.core.signals import STATUS
from dz_ros.errors import ConfigurationError

PERIOD = 0.005
SWITCHES = ('projection', 'late_gradient', 'anti_windup', 'integral', 'automatic_epsilon',
            'dead_zone_feed_forward')
MOTION = st.floats(-1e3, 1e3)


def make(order=2, count=2, period=PERIOD, **values):
    return Extended(schema.build(ExtendedGains, values, 'controller.'), order, count, period)


def configuration(law='extended', **values):
    return Configuration.from_flat({
        'controller.law': law, **{key.replace('__', '.'): value for key, value in values.items()}})


def step(law, memory, x_d, x, y, dt=PERIOD):
    """Return v, memory after, status, signals by name."""
    new_memory = [math.nan] * len(memory)
    terms = [0.0] * STATUS + [math.nan] * (1 + len(law.signal_names))
    v = law.kernel(law.constants, memory, x_d, x, y, dt, new_memory, terms)
    return v, new_memory, Status(int(terms[STATUS])), dict(
        zip(law.signal_names, terms[STATUS + 1:], strict=True))


def test_every_switch_is_off():
    gains = ExtendedGains()
    assert not any(getattr(gains, name) for name in SWITCHES)


@settings(max_examples=2 * settings.default.max_examples, deadline=None)
@given(order=st.integers(1, 4), count=st.integers(0, 3), data=st.data(),
       dt=st.sampled_from([0.0, 0.0025, 0.005, 0.01]))
def test_off_is_the_paper_s_kernel_bit_for_bit(order, count, data, dt):
    def numbers(size):
        return data.draw(st.lists(MOTION, min_size=size, max_size=size))

    paper = Wang2004(Wang2004Gains(), order, count, PERIOD)
    law = make(order, count)
    estimates = numbers(count + 1)
    x_d, x, y = numbers(order + 1), numbers(order), numbers(count)
    expected = [math.nan] * (count + 1)
    buffer = [0.0] * STATUS + [math.nan] * (count + 2)
    v = paper.kernel(paper.constants, estimates, x_d, x, y, dt, expected, buffer)
    rest = numbers(4 + count)                      # whatever it remembers otherwise
    found, after, status, signals = step(law, [*estimates, *rest], x_d, x, y, dt)
    assert found == v
    assert after[:count + 1] == expected
    assert list(signals.values())[:count + 1] == buffer[STATUS + 1:]
    assert status == Status.ADAPTING


@pytest.mark.parametrize('values', [
    {}, {'plant.model': 'zhang_feng1997', 'loop.delay': 1},
    {'plant.model': 'servo', 'plant.noise': [0.001]},
    {'plant.model': 'first_order', 'controller.theta_0': [0.5]},
    {'plant.model': 'valve_actuator'}])
def test_off_is_the_paper_s_run_bit_for_bit(values):
    values = {'loop.duration': 3.0, **values}
    paper = simulate(Configuration.from_flat({**values, 'controller.law': 'wang2004'}))
    found = simulate(Configuration.from_flat({**values, 'controller.law': 'extended'}))
    assert (found.v == paper.v).all()
    assert (found.x == paper.x).all()
    assert (found.column('phi') == paper.column('phi')).all()


@pytest.mark.parametrize('chosen', [1 << i for i in range(6)] + [63])
def test_each_alone_and_all_together_stay_near_the_reference(chosen):
    """Alone or together the loop follows; the integral makes the error much smaller."""
    values = {f'controller.{name}': True for i, name in enumerate(SWITCHES) if chosen >> i & 1}
    if values.get('controller.anti_windup'):
        values['controller.v_max'] = 12.0
    found = simulate(configuration(loop__duration=30.0, **values))
    tail = found.t > 20.0
    error = np.abs(found.x[:, 0] - found.x_d[:, 0])[tail].max()
    assert error < 0.02
    if values.get('controller.integral') and len(values) == 1:
        assert error < 0.0015                      # 0.0084 without


def test_projection_is_the_clipped_euler_step():
    law = make(projection=True, theta_max=[0.86], phi_min=0.84, gamma=20.0, eta=20.0)
    free = make(gamma=20.0, eta=20.0)
    for sign in (1.0, -1.0):
        arguments = (law.initial_memory(), (0.0, 0.0, 3.0), (0.0, sign), (2.0, -0.5))
        _, after, _, _ = step(law, *arguments)
        _, plain, _, _ = step(free, *arguments)
        assert after[:3] == [min(max(plain[0], 0.1), 0.86), min(max(plain[1], 0.1), 0.86),
                             min(max(plain[2], 0.84), 2.5)]
    assert plain[0] > 0.86


def test_late_gradient_uses_the_sample_before():
    law = make(late_gradient=True, gamma=3.0, eta=2.0)
    memory = law.initial_memory()
    _, memory, _, first = step(law, memory, (0.0, 0.0, 1.5), (0.1, 0.4), (2.0, -1.0))
    assert (first['theta1'], first['theta2'], first['phi']) == (0.85, 0.85, 0.85)
    assert memory[:3] == [0.85, 0.85, 0.85]        # no Euler step after v
    u_before = 1.5 - 1.0 * 0.4
    s = 0.3 + 0.2
    n = 1.0 + 0.008 * (3.0 * 5.0 + 2.0 * u_before ** 2) / 10.0
    move = 0.008 * (s - 0.02) / n
    _, memory, _, second = step(law, memory, (0.0, 0.0, -9.0), (0.2, 0.3), (7.0, 7.0), 0.008)
    assert second['theta1'] == pytest.approx(0.85 - 3.0 * 2.0 * move, rel=1e-12)
    assert second['theta2'] == pytest.approx(0.85 + 3.0 * 1.0 * move, rel=1e-12)
    assert second['phi'] == pytest.approx(0.85 - 2.0 * u_before * move, rel=1e-12)


@pytest.mark.parametrize('late', [False, True])
def test_anti_windup_freezes_while_v_pushes_against_s(late):
    law = make(anti_windup=True, v_max=4.0, integral=True, late_gradient=late)
    moving = make(integral=True, late_gradient=late)
    memory = list(law.initial_memory())
    if late:
        memory = step(law, memory, (0.0, 0.0, 0.0), (0.0, 1.0), (1.0, 1.0))[1]
    # s > 0 and v far below −v_max: pushing against s
    v, after, status, _ = step(law, memory, (0.0, 0.0, 0.0), (0.0, 1.0), (1.0, 1.0))
    assert v < -4.0
    assert status == Status.SATURATED
    assert after[:4] == memory[:4]
    free = step(moving, memory, (0.0, 0.0, 0.0), (0.0, 1.0), (1.0, 1.0))[1]
    assert free[:4] != memory[:4]
    # beyond the limit but pushing with s: adaptation goes on
    if not late:
        v, after, status, _ = step(law, memory, (0.0, 0.0, 90.0), (0.0, 0.5), (1.0, 1.0))
        assert v > 4.0
        assert status == Status.ADAPTING
        assert after[:3] != memory[:3]


def test_integral_grows_only_inside_the_layer_and_not_beyond_its_authority():
    law = make(integral=True, rho_i=0.3)
    rate = (10.0 + 2.5 / 0.02) ** 2 / 16.0
    memory = law.initial_memory()
    v0, memory, _, _ = step(law, memory, (0.0, 0.0, 0.0), (0.0, 0.01), (0.0, 0.0))
    assert memory[3] == pytest.approx(PERIOD * rate * 0.01)
    v1, held, _, _ = step(law, memory, (0.0, 0.0, 0.0), (0.0, 0.021), (0.0, 0.0))
    assert held[3] == memory[3]                    # outside: stands still, but acts
    plain, *_ = step(make(), law.initial_memory(), (0.0, 0.0, 0.0), (0.0, 0.021), (0.0, 0.0))
    assert v1 == pytest.approx(plain - memory[3])
    for _ in range(50):
        memory = step(law, memory, (0.0, 0.0, 0.0), (0.0, 0.015), (0.0, 0.0))[1]
    assert memory[3] == 0.3
    assert v0 == pytest.approx(-135.0 * 0.01 + 0.85 * -0.01)


def test_feed_forward_is_the_break_point_of_v_s_side():
    law, plain = make(dead_zone_feed_forward=True), make()
    for s in np.linspace(-0.03, 0.03, 25):
        arguments = (law.initial_memory(), (0.0, 0.0, 0.0), (0.0, float(s)), (0.0, 0.0))
        v_d, *_ = step(plain, *arguments)
        v, *_ = step(law, *arguments)
        share = 1.0 / (1.0 + math.exp(-2.0 * v_d / 0.1))
        assert v == pytest.approx(v_d + 0.35 * share - 0.4 * (1.0 - share), abs=1e-12)


def test_automatic_epsilon_follows_the_rate_and_survives_b_2_with_a_delay():
    law = make(automatic_epsilon=True)
    expected = 2.5 / (0.5 * 1.0 / (1.25 * 0.005) - 10.0 - 0.85)
    assert law.constants[2] == pytest.approx(expected)
    assert law.design.epsilon == pytest.approx(0.03615, abs=1e-5)
    # designed for a delay of 1 a loop with b = 2 and a full sample of delay is calm, for 0 not
    for delay, calm in ((1, True), (0, False)):
        found = simulate(configuration(controller__automatic_epsilon=True, plant__b=2.0,
                                       controller__design_delay=delay, loop__delay=1,
                                       loop__duration=10.0))
        variation = np.abs(np.diff(found.v[found.t > 5.0])).sum() / 5.0
        assert bool(variation < 10.0) is calm


def test_automatic_epsilon_names_the_rate_or_gain_that_would_do():
    with pytest.raises(ConfigurationError) as caught:
        make(automatic_epsilon=True, period=0.05)
    words = str(caught.value)
    assert '20 Hz' in words
    assert '27.1' in words                         # (10 + 0.85) 1.25 / 0.5
    automatic_epsilon(2.5, 10.0, 0.85, 1.25, 1.0 / 27.2, 1, 0.5)
    with pytest.raises(ConfigurationError):
        automatic_epsilon(2.5, 10.0, 0.85, 1.25, 1.0 / 27.1, 1, 0.5)
    assert '7.15' in words                         # 0.5/(1.25 0.05) − 0.85
    automatic_epsilon(2.5, 7.14, 0.85, 1.25, 0.05, 1, 0.5)


@pytest.mark.parametrize(('values', 'key'), [
    ({'anti_windup': True}, 'v_max'), ({'projection': True, 'phi_0': 9.0}, 'phi_0'),
    ({'projection': True, 'theta_0': [0.5, 9.0]}, 'theta_0'), ({'theta_max': [0.01]}, 'theta_min'),
    ({'e0': 0.0}, 'e0')])
def test_refuses_gains_that_do_not_fit(values, key):
    with pytest.raises(ConfigurationError) as caught:
        make(**values)
    assert caught.value.key == f'controller.{key}'
