# SPDX-License-Identifier: Apache-2.0
"""What every law must keep in a closed loop, for any finite input, and in its source."""

import ast
import inspect
import math
import textwrap
import types

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.loop.offline import simulate
from dz_ros.core.records import Status
from dz_ros.core.signals import STATUS, V_DAMPING
from dz_ros.errors import ConfigurationError

PERIOD = 0.005
EVERY_LAW = pytest.mark.parametrize('name', LAWS.builtin)
VARIANTS = [(name, {}) for name in LAWS.builtin] + [
    ('extended', {'projection': True, 'late_gradient': True, 'anti_windup': True, 'v_max': 6.0,
                  'integral': True, 'dead_zone_feed_forward': True, 'automatic_epsilon': True}),
    ('extended', {'projection': True, 'anti_windup': True, 'v_max': 6.0, 'integral': True}),
    ('robust', {'identifier': True, 'v_max': 6.0}),
    ('robust_eso', {'identifier': False, 'v_max': 6.0}),
    ('robust_eso', {'observer': False}),
    ('robust_eso', {'learning_harmonics': 5, 'design_delay': 2}),
    ('robust_eso', {'design_delay': 0}),
    ('ladrc', {'extended_states': 2, 'design_delay': 0})]
EVERY_VARIANT = pytest.mark.parametrize(('name', 'values'), VARIANTS)
NOMINAL = ('ladrc', 'disturbance_observer', 'super_twisting', 'l1')
"""Laws that clip v themselves."""
NUMBER = st.floats(-1e6, 1e6)


def make(name, order=2, count=2, **values):
    law = LAWS.load(name)
    return law(schema.build(law.Gains, values, 'controller.'), order, count, PERIOD)


def step(law, memory, x_d, x, y, dt):
    new_memory = [math.nan] * len(memory)
    terms = [0.0] * STATUS + [math.nan] * (1 + len(law.signal_names))
    v = law.kernel(law.constants, memory, x_d, x, y, dt, new_memory, terms)
    return v, new_memory, terms


@EVERY_VARIANT
@settings(max_examples=settings.default.max_examples // 4, deadline=None)
@given(data=st.data(), order=st.integers(1, 3), count=st.integers(0, 3))
def test_finite_in_finite_out(name, values, data, order, count):
    """Three samples of anything up to a million, from the start."""
    law = make(name, order, count, **values)
    memory = list(law.initial_memory())
    for _ in range(3):
        x_d, x, y = (data.draw(st.lists(NUMBER, min_size=size, max_size=size))
                     for size in (order + 1, order, count))
        dt = data.draw(st.sampled_from([0.0, 0.0025, PERIOD, 0.01]))
        v, memory, terms = step(law, memory, x_d, x, y, dt)
        assert math.isfinite(v)
        assert all(map(math.isfinite, memory))
        assert all(map(math.isfinite, terms))
        assert math.fsum(terms[V_DAMPING:STATUS]) == pytest.approx(v, rel=1e-9, abs=1e-3)
        Status(int(terms[STATUS]))


@EVERY_VARIANT
@pytest.mark.parametrize('plant', ['wang2004', 'first_order', 'servo'])
def test_a_run_can_be_recomputed_from_any_sample_bit_for_bit(name, values, plant):
    """Noise, delay, saturation: each sample's memory, then v, terms and the next memory."""
    if plant == 'first_order' and values.get('automatic_epsilon'):
        values = {**values, 'k_d': 5.0}
    found = simulate(Configuration.from_flat({
        'controller.law': name, 'plant.model': plant, 'plant.noise': [1e-3], 'loop.delay': 1,
        'plant.command_limit': 8.0, 'loop.duration': 2.0, 'loop.seed': 3,
        **{f'controller.{key}': value for key, value in values.items()}}))
    law, plant_constants = found.configuration.law, found.configuration.plant.constants
    y = [0.0] * law.regressor_count
    signals = found.terms[:, STATUS + 1:]
    for k in range(len(found.t)):
        x = found.x_measured[k].tolist()
        found.configuration.plant.regressors(x, plant_constants, y)
        memory = law.memory_from_signals(signals[k].tolist())
        v, after, terms = step(law, memory, found.x_d[k].tolist(), x, y, PERIOD)
        assert v == found.v[k]
        assert terms == found.terms[k].tolist()
        if k + 1 < len(found.t):
            assert tuple(after) == law.memory_from_signals(signals[k + 1].tolist())
    assert law.memory_from_signals(signals[0].tolist()) == law.initial_memory()


@EVERY_VARIANT
@pytest.mark.parametrize('limit', [6.0, 10.0])
def test_saturation_does_not_lose_the_loop(name, values, limit):
    """The actuator clips the transient; afterwards every law follows as well as without."""
    if 'v_max' in values:
        values = {**values, 'v_max': limit}
    flat = {'controller.law': name, 'loop.duration': 20.0,
            **{f'controller.{key}': value for key, value in values.items()}}
    free = simulate(Configuration.from_flat(flat))
    found = simulate(Configuration.from_flat({**flat, 'plant.command_limit': limit}))
    assert np.abs(found.v_applied).max() <= limit
    errors = [np.abs(run.x[:, 0] - run.x_d[:, 0])[run.t >= 15.0].max() for run in (free, found)]
    assert errors[1] < 1.5 * errors[0] + 0.05


def knows_a_limit(name):
    return any(item.name == 'v_max' for item in schema.fields(LAWS.load(name).Gains))


@pytest.mark.parametrize('name', [name for name in LAWS.builtin if knows_a_limit(name)])
def test_laws_that_know_a_limit_report_when_they_freeze(name):
    """Pushing beyond the limit against s: a status bit, estimates and integral stand still."""
    values = {'extended': {'anti_windup': True}, 'robust_eso': {'start_rate': 0.0},
              'scheduled': {'start_rate': 0.0}, 'coupled_eso': {'start_rate': 0.0}}.get(name, {})
    kept = 2 if name == 'coupled_eso' else 4    # its observer, which knows of v, goes on
    law = make(name, v_max=3.0, **values)
    still = ((0.0, 0.0, 0.0), (0.0, 2.0), (1.0, 1.0), PERIOD)
    memory = step(law, law.initial_memory(), *still)[1]
    for _ in range(5):
        v, after, terms = step(law, memory, *still)
        assert v <= -3.0
        assert int(terms[STATUS]) == Status.SATURATED
        assert after[:kept] == memory[:kept]
        memory = after
    # beyond it in the other direction, which helps: they move
    v, after, terms = step(law, memory, (0.0, 0.0, 90.0), (0.0, 0.5), (1.0, 1.0), PERIOD)
    assert v >= 3.0
    v, again, _ = step(law, after, (0.0, 0.0, 90.0), (0.0, 0.5), (1.0, 1.0), PERIOD)
    assert again[:3] != memory[:3]


@EVERY_LAW
@pytest.mark.parametrize('order', [1, 2, 3])
def test_design_is_the_slope_of_the_kernel(name, order):
    """What a law declares to the design rules is what it does about s = 0, far from v = 0."""
    values = {'robust': {'k_2': 0.0}, 'robust_eso': {'k_2': 0.0, 'start_rate': 0.0},
              'scheduled': {'k_2': 0.0, 'start_rate': 0.0}, 'coupled_eso': {'start_rate': 0.0},
              **{key: {'v_clip': 0.0} for key in NOMINAL}}.get(name, {})
    law = make(name, order, 1, **values)
    design = law.design
    assert design is not None
    low = 1e-6
    # an input that keeps v far from the dead-zone, where inverses have their own slope
    push = [0.0] * order + [200.0]

    def v_at(offset):
        x = [0.0] * (order - 1) + [offset]
        return step(law, law.initial_memory(), push, x, (0.0,), 0.0)[0]

    slope = (v_at(-low) - v_at(low)) / (2.0 * low)
    assert slope == pytest.approx(design.gain + design.lead, rel=1e-4)
    assert design.gain > 0.0
    if design.epsilon > 0.0 and design.k > 0.0:
        outside = v_at(2.0 * design.epsilon) - v_at(3.0 * design.epsilon)
        inside = v_at(0.1 * design.epsilon) - v_at(0.2 * design.epsilon)
        assert 10.0 * inside - outside == pytest.approx(design.k, rel=1e-3)


ALLOWED = (ast.arguments, ast.arg, ast.Assign, ast.AugAssign, ast.AnnAssign, ast.For, ast.If,
           ast.IfExp, ast.Return, ast.Expr, ast.Call, ast.Name, ast.Attribute, ast.Subscript,
           ast.Constant, ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.operator,
           ast.unaryop, ast.boolop, ast.cmpop, ast.expr_context, ast.FunctionDef)
"""No containers made, no comprehensions, exceptions, closures, imports: a compiler can take it."""


def check_source(function, seen):
    """Check one function and every function of ours that it calls."""
    if function in seen:
        return
    seen.add(function)
    assert not function.__closure__, function.__name__
    tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    for node in [item for part in (tree.args, *tree.body) for item in ast.walk(part)]:
        assert isinstance(node, ALLOWED), f'{function.__name__}: {ast.dump(node)}'
        assert not isinstance(node, ast.Pow), function.__name__
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            if isinstance(node.func, ast.Attribute):
                assert node.func.value.id == 'math'
            elif name not in ('range', 'len', 'abs', 'min', 'max', 'float', 'int'):
                called = function.__globals__[name]
                assert isinstance(called, types.FunctionType)
                check_source(called, seen)
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        assert value is None or isinstance(value, (int, float, types.FunctionType)) \
            or value is math, f'{function.__name__} uses {name}'


def in_kernels(name):
    functions = set()
    check_source(LAWS.load(name).kernel, functions)
    return functions


@EVERY_LAW
def test_kernel_is_plain_scalar_code(name):
    assert LAWS.load(name).kernel in in_kernels(name)


def test_the_paper_s_equations_are_written_once():
    """All laws built on (14)–(16) call the same two functions."""
    names = {name: {item.__name__ for item in in_kernels(name)} for name in LAWS.builtin}
    for name in ('wang2004', 'extended', 'robust', 'adaptive', 'sliding', 'sliding_integral',
                 'exact_inverse', 'fuzzy', 'neural', 'robust_eso'):
        assert 'control' in names[name], name
    for name in ('extended', 'robust', 'robust_eso'):
        assert {'late_gradient', 'project', 'clip'} <= names[name]


@EVERY_LAW
def test_gains_name_their_origin_and_reject_nonsense(name):
    law = LAWS.load(name)
    for item in schema.fields(law.Gains):
        for nonsense in ('x', None, [[1.0]], math.nan):
            if item.kind == 'str' and nonsense == 'x':
                continue
            with pytest.raises(ConfigurationError) as caught:
                schema.build(law.Gains, {item.name: nonsense}, 'controller.')
            assert caught.value.key == f'controller.{item.name}'
            assert '\n' not in str(caught.value)
