# SPDX-License-Identifier: Apache-2.0
"""Dead-zones that follow a scheduling variable, and the law that knows it."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.deadzone import dead_zone, DeadZone, residual, Schedule
from dz_ros.core.design.assumptions import check_dead_zone
from dz_ros.core.design.finding import INFO, WARNING
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.loop.controller import Controller
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Reference, State
from dz_ros.core.section_settings import LoopSettings
from dz_ros.errors import ConfigurationError

POINTS = (10.0, 12.0, 16.0, 20.0)
TABLES = {'m_r_table': (0.6, 0.7, 1.0, 1.2), 'm_l_table': (0.5, 0.6, 0.8, 0.9),
          'b_r_table': (0.6, 0.5, 0.4, 0.3), 'b_l_table': (-0.65, -0.5, -0.4, -0.35)}
FALLING = {'loop.schedule_values': [20.0, 14.0], 'loop.schedule_times': [1.0, 3.0],
           'plant.dead_zone.schedule_points': POINTS,
           **{f'plant.dead_zone.{name}': table for name, table in TABLES.items()}}
KNOWN = {'controller.law': 'scheduled', 'controller.table_points': POINTS,
         'controller.psi_0': 20.0,
         **{f'controller.{name.replace("table", "known")}': table
            for name, table in TABLES.items()}}


def followed(t, **values):
    """Return the dead-zone of time t as one without tables, by numpy."""
    psi = np.interp(t, (1.0, 3.0), (20.0, 14.0))
    return DeadZone(*(float(np.interp(psi, POINTS, TABLES[f'{name}_table']))
                      for name in ('m_r', 'm_l', 'b_r', 'b_l')), **values)


@given(st.floats(-3.0, 3.0), st.floats(0.0, 5.0))
def test_follows_its_tables(v, t):
    schedule = Schedule((1.0, 3.0), (20.0, 14.0))
    numbers = DeadZone(schedule_points=POINTS, **TABLES).numbers(schedule)
    now = followed(t)
    w = dead_zone(v, t, numbers)
    assert w == pytest.approx(now(v), abs=1e-12)
    slope = now.m_r if v >= 0.0 else now.m_l
    assert residual(v, w, t, numbers) == pytest.approx(w - slope * v, abs=1e-12)


@given(st.floats(-3.0, 3.0), st.floats(0.0, 5.0))
def test_drift_comes_on_top(v, t):
    zone = DeadZone(schedule_points=POINTS, b_r_drift=(0.1, 2.0), **TABLES)
    b_r = followed(t).b_r + 0.1 * math.sin(2.0 * t)
    w = dead_zone(v, t, zone.numbers(Schedule((1.0, 3.0), (20.0, 14.0))))
    if v > 0.0:
        assert w == pytest.approx(max(0.0, followed(t).m_r * (v - b_r)), abs=1e-12)


def test_a_constant_variable_makes_a_constant_dead_zone():
    zone = DeadZone(schedule_points=POINTS, **TABLES)
    numbers = zone.numbers(Schedule((0.0,), (14.0,)))
    assert numbers[0] == 0.0
    assert numbers[1:5] == pytest.approx((0.85, 0.7, 0.45, -0.45))
    assert zone.constants == DeadZone().constants


@given(st.floats(0.0, 20.0), st.floats(0.1, 1.9), st.floats(0.1, 10.0))
def test_slope_begins_at_its_edge_and_reaches_the_mean(u, edge, span):
    zone = DeadZone(m_r=2.0, m_l=0.5, b_r=0.5, b_l=-0.6, edge_slope=edge, edge_span=span)
    mean = edge + (1.0 - edge) * min(u / span, 1.0)
    assert zone(0.5 + u) == pytest.approx(2.0 * u * mean, abs=1e-9)
    assert zone(-0.6 - u) == pytest.approx(-0.5 * u * mean, abs=1e-9)
    least, largest = zone.slopes()
    assert least * u - 1e-9 <= zone(0.5 + u) <= largest * u + 1e-9


@pytest.mark.parametrize(('values', 'key'), [
    ({'schedule_points': [1.0, 1.0]}, 'schedule_points'),
    ({'schedule_points': [1.0, 2.0], 'b_r_table': [0.1]}, 'b_r_table'),
    ({'schedule_points': [1.0], 'm_r_table': [0.0]}, 'm_r_table'),
    ({'schedule_points': [1.0], 'b_l_table': [0.1]}, 'b_l_table'),
    ({'schedule_points': [1.0, 2.0], 'b_r_table': [0.5, 0.1], 'b_r_drift': [0.2, 1.0]},
     'b_r_drift'),
    ({'edge_slope': 0.0}, 'edge_slope'), ({'edge_span': 0.0}, 'edge_span')])
def test_refuses_tables_that_are_none(values, key):
    with pytest.raises(ConfigurationError) as caught:
        schema.build(DeadZone, values, 'plant.dead_zone.')
    assert caught.value.key == f'plant.dead_zone.{key}'


@pytest.mark.parametrize(('values', 'key'), [
    ({'schedule_values': [1.0, 2.0]}, 'schedule_times'),
    ({'schedule_times': [1.0]}, 'schedule_times'),
    ({'schedule_values': [1.0, 2.0], 'schedule_times': [2.0, 2.0]}, 'schedule_times')])
def test_refuses_a_schedule_that_is_none(values, key):
    with pytest.raises(ConfigurationError) as caught:
        schema.build(LoopSettings, values, 'loop.')
    assert caught.value.key == f'loop.{key}'


def test_refuses_tables_without_what_they_follow():
    with pytest.raises(ConfigurationError, match=r'loop\.schedule_values'):
        Configuration.from_flat({key: value for key, value in FALLING.items()
                                 if key.startswith('plant')})


def test_bounds_are_compared_with_the_whole_range():
    c = Configuration.from_flat({**FALLING, 'controller.m_bounds': [0.65, 1.25]})
    words = {item.rule: item.words for item in check_dead_zone(c) if item.level == INFO}
    assert 'where m is one constant, not here' in words['(A4)']
    narrow = c.replace(**{'controller.b_r_bounds': [0.1, 0.44]})   # 0.45 at 14 V
    assert {item.rule: item.level for item in check_dead_zone(narrow)}['(A4)'] == WARNING
    enough = narrow.replace(**{'loop.schedule_values': [20.0, 15.0]})
    assert {item.rule: item.level for item in check_dead_zone(enough)}['(A4)'] == INFO


def test_a_law_that_divides_by_the_slope_is_checked_for_the_rest():
    c = Configuration.from_flat({**FALLING, 'controller.m_bounds': [0.99, 1.01]})
    assert {item.rule: item.level for item in check_dead_zone(c)}['(A4)'] == WARNING
    knows = Configuration.from_flat({**FALLING, **KNOWN, 'controller.m_bounds': [0.99, 1.01]})
    assert {item.rule: item.level for item in check_dead_zone(knows)}['(A4)'] == INFO


def test_knowing_nothing_it_is_the_law_in_front_of_which_it_stands():
    own = simulate(Configuration.from_flat({'controller.law': 'robust_eso', 'loop.duration': 3.0}))
    same = simulate(Configuration.from_flat({'controller.law': 'scheduled', 'loop.duration': 3.0}))
    assert same.v == pytest.approx(own.v, abs=1e-9)


@pytest.mark.slow
def test_knowing_the_tables_it_is_more_accurate():
    flat = {**FALLING, 'loop.duration': 8.0, 'plant.x0': [0.0, 2.5]}
    errors = []
    for law in ({'controller.law': 'robust_eso'}, KNOWN):
        run = simulate_fast(Configuration.from_flat({**flat, **law}))
        late = run.t > 4.0
        errors.append(np.abs(run.x[late, 0] - run.x_d[late, 0]).max())
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize('values', [[17.0], [20.0, 14.0]])
def test_python_compiled_and_the_controller_agree_bit_for_bit(values):
    c = Configuration.from_flat({**FALLING, **KNOWN, 'loop.duration': 4.0,
                                 'loop.timing': 'lockstep', 'loop.schedule_values': values,
                                 'loop.schedule_times': [1.0, 3.0] if len(values) > 1 else []})
    slow, fast = simulate(c), simulate_fast(c)
    for name in ('x', 'v', 'truth', 'terms'):
        assert np.array_equal(getattr(slow, name), getattr(fast, name))
    controller, device = Controller(c), c.make_driver()
    for k in range(len(slow.t)):
        stamp = k * c.loop.period
        state = State(k, stamp, device.measure())
        controller.set_reference(Reference(k, stamp, tuple(slow.x_d[k].tolist())))
        command, terms = controller.respond(state)
        assert command.v == slow.v[k]
        assert list(terms.signals) == slow.terms[k, -len(terms.signals):].tolist()
        device.command(command.v, stamp)
        truth = device.advance((k + 1) * c.loop.period, k)
        assert (truth.w, truth.d, truth.disturbance) == tuple(slow.truth[k])


@pytest.mark.parametrize(('values', 'key'), [
    ({'table_points': []}, 'table_points'), ({'table_points': [2.0, 1.0]}, 'table_points'),
    ({'table_points': [1.0, 2.0]}, 'm_r_known')])
def test_refuses_knowledge_that_does_not_fit(values, key):
    with pytest.raises(ConfigurationError) as caught:
        Configuration.from_flat({'controller.law': 'scheduled', **{
            f'controller.{name}': value for name, value in values.items()}})
    assert caught.value.key == f'controller.{key}'


def test_a_measured_variable_takes_the_place_of_the_configured_one():
    c = Configuration.from_flat({**FALLING, **KNOWN, 'loop.schedule_topic': 'battery/voltage'})
    controller, device = Controller(c), c.make_driver()
    place = c.law.schedule_place

    def step(k):
        controller.set_reference(Reference(k, k * c.loop.period, (0.0, 0.0, 0.0)))
        controller.respond(State(k, k * c.loop.period, (0.1, 0.0)))
        return controller.memory[place]

    assert step(0) == 20.0
    controller.follow(11.0)
    assert step(1) == 11.0
    device.follow(10.0)
    device.command(2.0, 0.0)
    assert device.advance(c.loop.period, 0).w == pytest.approx(0.6 * (2.0 - 0.6))
    device.configure(c)             # other parameters, the same measurement
    assert device.advance(2.0 * c.loop.period, 1).w == pytest.approx(0.6 * (2.0 - 0.6))


@pytest.mark.parametrize('changes', [
    {'loop.timing': 'lockstep'}, {'loop.schedule_values': [], 'loop.schedule_times': []},
    {'loop.schedule_topic': 'no topic'}, {'loop.schedule_topic': '1/x'}])
def test_refuses_a_topic_where_there_can_be_none(changes):
    with pytest.raises(ConfigurationError) as caught:
        schema.build(LoopSettings, {
            key.partition('.')[2]: value for key, value in {
                'loop.schedule_values': [20.0], 'loop.schedule_topic': 'volts', **changes}.items()
        }, 'loop.')
    assert caught.value.key == 'loop.schedule_topic'
