# SPDX-License-Identifier: Apache-2.0
"""Plants and their integration against equations of motion written again, and solved by scipy."""

from itertools import pairwise
import math

import numpy as np
import pytest
from scipy import integrate, signal

from dz_ros.core import schema
from dz_ros.core.deadzone import DeadZone
from dz_ros.core.loop.integration import make_advance
from dz_ros.core.plants import PLANTS

PERIOD = 0.005


def wang2004(p, t, x, w):
    return (p.a1 * (1.0 - np.exp(-x[0])) / (1.0 + np.exp(-x[0]))
            - p.a2 * (x[0] ** 2 + 2.0 * x[0]) * np.sin(x[0])
            - 0.5 * p.a3 * x[0] * np.sin(3.0 * t) + p.b * w)


def zhang_feng1997(p, t, x, w):
    return (p.a1 * (1.0 - np.exp(-x[0])) / (1.0 + np.exp(-x[0]))
            - p.a2 * (x[1] ** 2 + 2.0 * x[0]) * np.sin(x[1])
            - 0.5 * p.a3 * x[0] * np.sin(3.0 * t) + p.b * w)


def first_order(p, t, x, w):
    drag = p.linear_drag * x[0] + p.quadratic_drag * x[0] ** 2 * np.sign(x[0])
    return (w - drag - p.wave_force * np.sin(p.wave_frequency * t)) / (p.mass + p.added_mass)


def servo(p, t, x, w):
    friction = p.viscous_friction * x[1] + p.coulomb_friction * np.tanh(x[1] / p.smoothing_speed)
    cogging = p.cogging_torque * np.sin(p.cogging_periods * x[0])
    return (p.torque_constant * w - friction - cogging) / p.inertia


def axis(p, t, x, w):
    friction = p.viscous_friction * x[1] + p.coulomb_friction * np.tanh(x[1] / p.smoothing_speed)
    return (p.force_constant * w - friction - p.constant_force) / p.mass


def thruster(p, t, x, w):
    drag = p.linear_drag * x[1] + p.quadratic_drag * x[1] ** 2 * np.sign(x[1])
    push = p.thrusters * np.cos(p.angle) * p.slope * w
    return (push - drag - p.wave_force * np.sin(p.wave_frequency * t)) / (p.mass + p.added_mass)


def pendulum(p, t, x, w):
    arm = p.length * np.array([np.sin(x[0]), np.cos(x[0])])  # from the pivot to the mass
    pivot = p.pivot_acceleration * np.sin(p.pivot_frequency * t)
    force = -p.bob_mass * np.array([pivot, p.gravity])  # on the mass, in the frame of the pivot
    turning = arm[1] * force[0] - arm[0] * force[1]  # clockwise, towards growing angle
    friction = p.damping * p.length ** 2 * x[1]
    return (w + turning - friction) / (p.bob_mass * p.length ** 2)


def valve_actuator(p, t, x, w):
    poles = np.polymul([1.0, p.spring_corner], [
        1.0, 2.0 * p.damping_ratio * p.natural_frequency, p.natural_frequency ** 2])
    return p.velocity_gain * p.natural_frequency ** 2 * w - poles[:0:-1] @ x


def two_link_arm(p, t, x, w):
    """The view of its first joint, the elbow held at a right angle."""
    elbow = p.mass_2 * (p.length_1 ** 2 + p.centre_2 ** 2) + p.inertia_2
    weight = (p.mass_1 * p.centre_1 + p.mass_2 * p.length_1) * p.gravity
    return (p.torque_constant * w - weight * np.cos(x[0]) - p.friction_1 * x[1]) / (
        p.mass_1 * p.centre_1 ** 2 + p.inertia_1 + elbow)


def rov_planar(p, t, x, w):
    """The view of its surge, straight ahead."""
    drag = p.linear_drag_surge + p.quadratic_drag_surge * np.abs(x[1])
    return (w - drag * x[1]) / (p.mass + p.added_mass_surge)


EQUATIONS = {item.__name__: item for item in (
    wang2004, zhang_feng1997, first_order, servo, pendulum, valve_actuator, axis,
    thruster, two_link_arm,
    rov_planar)}
# Scale of command and dead-zone, of the state, and parameters away from their defaults.
SCALES = {
    'wang2004': (4.0, (2.0, 3.0), {'a1': 1.3, 'a2': 0.7, 'a3': 1.6, 'b': 0.5}),
    'zhang_feng1997': (4.0, (2.0, 3.0), {'a1': 1.3, 'a2': 0.7, 'a3': 1.6, 'b': 0.5}),
    'first_order': (40.0, (0.5,), {'mass': 11.0, 'linear_drag': 20.0, 'wave_frequency': 2.0}),
    'servo': (8.0, (1.0, 0.2), {'inertia': 0.7, 'viscous_friction': 0.6, 'coulomb_friction': 0.8,
                                'torque_constant': 1.4, 'smoothing_speed': 0.05}),
    'axis': (8.0, (0.1, 0.5), {'mass': 90.0, 'constant_force': -3.0, 'coulomb_friction': 15.0,
                               'smoothing_speed': 0.2}),
    'thruster': (100.0, (0.5, 0.5), {'mass': 11.0, 'linear_drag': 20.0, 'wave_frequency': 2.0,
                                     'angle': 0.5, 'slope': 0.1}),
    'pendulum': (1.0, (0.5, 1.0), {'bob_mass': 0.2, 'length': 0.8, 'damping': 0.3,
                                   'pivot_acceleration': 2.0}),
    'two_link_arm': (40.0, (0.5, 1.0), {'mass_2': 1.4, 'gravity': 5.0, 'torque_constant': 1.3}),
    'rov_planar': (60.0, (0.5, 0.5), {'mass': 11.0, 'linear_drag_surge': 20.0}),
    'valve_actuator': (5.0, (0.1, 0.1, 1.0), {'natural_frequency': 25.0, 'damping_ratio': 0.15,
                                              'spring_corner': 1.0}),
}
plants = pytest.mark.parametrize('name', EQUATIONS)


def make(name, **values):
    plant = PLANTS.load(name)
    return plant(schema.build(plant.Parameters, values, 'plant.'))


def integrate_held(plant, zone, x0, commands, substeps):
    """Return the state after each held command, by the integrator under test."""
    advance = make_advance(plant.regressors, plant.disturbance)
    n = plant.order
    x, y = list(x0), [0.0] * plant.regressor_count
    work = [[0.0] * n for _ in range(4)]
    states = []
    for k, v in enumerate(commands):
        advance(x, v, k * PERIOD, PERIOD / substeps, substeps, plant.constants, zone.constants, y,
                *work)
        states.append(list(x))
    return np.array(states)


def experiment(name, values):
    """Return plant, dead-zone, initial state and a random sequence of commands."""
    size, state, changed = SCALES[name]
    generator = np.random.default_rng(7)
    zone = DeadZone(1.2, 0.8, 0.1 * size, -0.15 * size, b_r_drift=(0.05 * size, 3.0),
                    m_l_drift=(0.2, 5.0))
    commands = size * np.repeat(generator.uniform(-1.0, 1.0, 20), 5)
    return make(name, **(changed if values else {})), zone, np.array(state), commands


def test_every_builtin_plant_is_tried():
    assert set(EQUATIONS) == set(PLANTS.builtin) == set(SCALES)


@plants
@pytest.mark.parametrize('changed', [False, True])
def test_against_scipy(name, changed):
    plant, zone, x0, commands = experiment(name, changed)
    equation, p = EQUATIONS[name], plant.parameters

    def w(v, t):
        m_l = 0.8 + 0.2 * np.sin(5.0 * t)
        b_r = zone.b_r + zone.b_r_drift[0] * np.sin(3.0 * t)
        beyond = v - np.clip(v, zone.b_l, b_r)
        return (1.2 if beyond > 0.0 else m_l) * beyond

    found = integrate_held(plant, zone, x0, commands, 40)
    state = x0
    for k, v in enumerate(commands):
        solution = integrate.solve_ivp(
            lambda t, x, v=v: np.append(x[1:], equation(p, t, x, w(v, t))),
            (k * PERIOD, (k + 1) * PERIOD), state, 'DOP853', rtol=1e-12, atol=1e-13)
        state = solution.y[:, -1]
        assert found[k] == pytest.approx(state, rel=1e-9, abs=1e-9)
    assert np.abs(found[-1] - x0).max() > 0.01  # it did move


@plants
def test_half_the_step_is_a_sixteenth_of_the_error(name):
    plant, _, x0, commands = experiment(name, True)
    zone = DeadZone(b_r=0.05, b_l=-0.05)
    exact = integrate_held(plant, zone, x0, commands, 64)
    errors = [np.abs(integrate_held(plant, zone, x0, commands, substeps) - exact).max()
              for substeps in (2, 4, 8)]
    for coarse, fine in pairwise(errors):
        assert 12.0 < coarse / fine < 21.0


def test_valve_actuator_has_merritt_s_transfer_function():
    plant = make('valve_actuator', spring_corner=1.5)
    p = plant.parameters
    first = signal.TransferFunction([p.velocity_gain * 20.0 ** 2], np.polymul(
        [1.0, 1.5], [1.0, 2.0 * 0.2 * 20.0, 20.0 ** 2]))
    t = np.arange(1, 401) * PERIOD
    _, expected = signal.step(first, T=np.concatenate(([0.0], t)))
    found = integrate_held(plant, DeadZone(b_r=0.0, b_l=0.0), [0.0] * 3, [1.0] * 400, 4)
    assert found[:, 0] == pytest.approx(expected[1:], abs=1e-8)


def test_valve_actuator_without_spring_runs_at_its_velocity_gain():
    found = integrate_held(make('valve_actuator', spring_corner=0.0), DeadZone(b_r=0.5),
                           [0.0] * 3, [3.0] * 1000, 4)
    assert found[-1, 1] == pytest.approx(0.02 * 2.5, rel=1e-6)


def test_first_order_settles_where_drag_equals_thrust():
    found = integrate_held(make('first_order', wave_force=0.0), DeadZone(b_r=8.0), [0.0],
                           [50.0] * 2000, 4)
    speed = found[-1, 0]
    assert 13.7 * speed + 141.0 * speed * abs(speed) == pytest.approx(42.0)


def test_servo_sticks_below_the_breakaway_current():
    plant = make('servo', cogging_torque=0.0)
    stuck = integrate_held(plant, DeadZone(b_r=0.5), [0.0, 0.0], [1.4] * 400, 8)
    moving = integrate_held(plant, DeadZone(b_r=0.5), [0.0, 0.0], [1.7] * 400, 8)
    assert 0.0 < stuck[-1, 1] < 0.02
    assert moving[-1, 1] > 0.2


def test_pendulum_falls_from_the_upright_and_keeps_its_energy_without_friction():
    plant = make('pendulum', damping=0.0, pivot_acceleration=0.0)
    found = integrate_held(plant, DeadZone(), [0.01, 0.0], [0.0] * 800, 8)
    energy = 0.5 * found[:, 1] ** 2 + 9.81 * np.cos(found[:, 0])
    assert found[:, 0].max() > math.pi - 0.1
    assert energy == pytest.approx(9.81 * math.cos(0.01), abs=1e-7)


@plants
def test_shapes_units_and_defaults_fit_together(name):
    plant = make(name)
    n, r = plant.order, plant.regressor_count
    assert len(plant.state_units) == len(plant.default_x0) == n
    assert len(plant.a) == r
    assert plant.b > 0.0
    assert plant.constants == (plant.b, *plant.a, *plant.extra)
    assert all(type(number) is float for number in plant.constants)
    assert plant.name == name
    assert plant.summary
    assert plant.actuator_unit
    assert all(item.spec.description and item.spec.unit for item in schema.fields(
        plant.Parameters))


@plants
def test_regressors_do_not_use_what_is_unknown(name):
    """Y(x) is the controller's: other a_i, b and disturbance must not change it."""
    plant = make(name)
    known = {'servo': 1}.get(name, 0)  # entries of `extra` that are known constants
    other = [3.0 * number + 1.0 for number in plant.constants]
    start = 1 + plant.regressor_count
    other[start:start + known] = plant.extra[:known]
    for x in np.random.default_rng(1).normal(size=(20, plant.order)):
        mine, theirs = [0.0] * plant.regressor_count, [0.0] * plant.regressor_count
        plant.regressors(list(x), plant.constants, mine)
        plant.regressors(list(x), other, theirs)
        assert mine == theirs


@plants
def test_normal_form_is_linear_in_the_unknown(name):
    """x^(n) + Σ a_i Y_i + disturbance = b w, with the plant's own a, b, Y, at random states."""
    plant = make(name, **SCALES[name][2])
    generator = np.random.default_rng(2)
    for _ in range(50):
        x = generator.normal(size=plant.order)
        t, w = generator.uniform(0.0, 10.0), generator.normal()
        y = [0.0] * plant.regressor_count
        plant.regressors(list(x), plant.constants, y)
        highest = (plant.b * w - np.dot(plant.a, y)
                   - plant.disturbance(t, list(x), plant.constants))
        assert highest == pytest.approx(EQUATIONS[name](plant.parameters, t, x, w), abs=1e-9)
