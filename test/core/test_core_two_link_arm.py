# SPDX-License-Identifier: Apache-2.0
"""The arm against its energies: positions of the links, differentiated numerically."""

import numpy as np
import pytest
from scipy import integrate

from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.plants.coupled import coupled_regressors, CoupledPlant, regressor_count
from dz_ros.core.plants.servo import Servo
from dz_ros.core.plants.two_link_arm import TwoLinkArm, TwoLinkArmParameters
from dz_ros.errors import ConfigurationError

UNUSUAL = {'mass_1': 1.7, 'mass_2': 0.9, 'length_1': 0.8, 'centre_1': 0.3, 'centre_2': 0.45,
           'inertia_1': 0.2, 'inertia_2': 0.07, 'gravity': 3.7, 'friction_1': 0.3,
           'friction_2': 0.6, 'torque_constant': 1.4}
STEP = 1e-5


def arm(axis=0, **changed):
    return TwoLinkArm(TwoLinkArmParameters(axis=axis, **{**UNUSUAL, **changed}))


def centres(p, q):
    """Centres of mass of both links [m], shape (2, 2)."""
    joint = p.length_1 * np.array([np.cos(q[0]), np.sin(q[0])])
    return np.array([p.centre_1 / p.length_1 * joint, joint + p.centre_2 * np.array(
        [np.cos(q[0] + q[1]), np.sin(q[0] + q[1])])])


def slope(function, q):
    """Central differences by each angle, the last index."""
    return np.stack([(function(q + STEP * e) - function(q - STEP * e)) / (2.0 * STEP)
                     for e in np.eye(2)], axis=-1)


def inertia(p, q):
    """M(q) of the kinetic energy ½ Σ M_k |c_k'|² + I_k ω_k²."""
    moved = slope(lambda at: centres(p, at), q)
    turned = np.array([[1.0, 0.0], [1.0, 1.0]])
    return sum(mass * moved[k].T @ moved[k] + about * np.outer(turned[k], turned[k])
               for k, (mass, about) in enumerate(((p.mass_1, p.inertia_1),
                                                  (p.mass_2, p.inertia_2))))


def potential(p, q):
    return p.gravity * np.array([p.mass_1, p.mass_2]) @ centres(p, q)[:, 1]


def coriolis(p, q, speed):
    """C(q, q') of Christoffel's symbols; differences of differences, hence the wider step."""
    wide = 1e-3
    gradient = np.stack([(inertia(p, q + wide * e) - inertia(p, q - wide * e)) / (2.0 * wide)
                         for e in np.eye(2)], axis=-1)
    return 0.5 * (gradient @ speed + np.einsum('ikj,k->ij', gradient, speed)
                  - np.einsum('jki,k->ij', gradient, speed))


def parts(plant, x):
    """g, M, C + F of the structure with the true weights."""
    rows = [0.0] * (2 * 7 * 5)
    TwoLinkArm.structure(list(x), plant.machine_constants, rows)
    summed = np.einsum('ikc,k->ic', np.reshape(rows, (2, 7, 5)), plant.weights)
    return summed[:, 0], summed[:, 1:3], summed[:, 3:]


def motion(plant, x, w):
    out = [0.0, 0.0]
    TwoLinkArm.dynamics(0.0, list(x), list(w), plant.machine_constants, out)
    return np.array(out)


@pytest.fixture(params=range(8))
def x(request):
    """Angles and speeds q_1, q_1', q_2, q_2'."""
    return np.random.default_rng(request.param).uniform(-2.0, 2.0, 4)


def test_structure_is_that_of_the_energies(x):
    plant, p = arm(), arm().parameters
    gravity, mass, force = parts(plant, x)
    q, speed = x[::2], x[1::2]
    np.testing.assert_allclose(mass, inertia(p, q), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(gravity, slope(lambda at: potential(p, at), q), rtol=1e-7,
                               atol=1e-7)
    np.testing.assert_allclose(force - np.diag([p.friction_1, p.friction_2]),
                               coriolis(p, q, speed), atol=2e-5)


def test_rate_of_the_inertia_less_twice_c_is_skew_symmetric(x):
    plant = arm(friction_1=0.0, friction_2=0.0)
    speed = x[1::2]

    def mass(time):
        moved = x.copy()
        moved[::2] += time * speed
        return parts(plant, moved)[1]

    rate = (mass(STEP) - mass(-STEP)) / (2.0 * STEP)
    skew = rate - 2.0 * parts(plant, x)[2]
    np.testing.assert_allclose(skew, -skew.T, atol=1e-8)
    assert np.abs(skew).max() > 1e-3


def test_motion_satisfies_the_structure_with_the_true_weights(x):
    """Σ_k m_k Y_k(q, q', q', q'') = K_t w, with q'' by finite differences of a solved motion."""
    plant = arm()
    w = np.random.default_rng(3).uniform(-5.0, 5.0, 2)

    def right(_, z):
        rates = motion(plant, z, w)
        return [z[1], rates[0], z[3], rates[1]]

    times = np.array([0.0, 1e-3, 2e-3])
    solved = integrate.solve_ivp(right, (0.0, 2e-3), x, t_eval=times, rtol=1e-12, atol=1e-13).y
    rates = (solved[1::2, 2] - solved[1::2, 0]) / 2e-3
    gravity, mass, force = parts(plant, solved[:, 1])
    np.testing.assert_allclose(mass @ rates + force @ solved[1::2, 1] + gravity,
                               plant.parameters.torque_constant * w, atol=1e-3)


def test_energy_is_kept_without_friction_and_torque():
    plant = arm(friction_1=0.0, friction_2=0.0)
    p = plant.parameters

    def right(_, z):
        rates = motion(plant, z, (0.0, 0.0))
        return [z[1], rates[0], z[3], rates[1]]

    def energy(z):
        return 0.5 * z[1::2] @ inertia(p, z[::2]) @ z[1::2] + potential(p, z[::2])

    begin = np.array([0.4, 1.0, -0.7, 2.0])
    end = integrate.solve_ivp(right, (0.0, 3.0), begin, rtol=1e-11, atol=1e-12).y[:, -1]
    assert energy(end) == pytest.approx(energy(begin), abs=1e-7)
    assert np.abs(end - begin).max() > 0.1


def test_friction_takes_energy_away(x):
    p = arm().parameters
    power = x[1::2] @ (motion_force := parts(arm(), x)[2]
                       - parts(arm(friction_1=0.0, friction_2=0.0), x)[2]) @ x[1::2]
    assert motion_force.shape == (2, 2)
    assert power == pytest.approx(p.friction_1 * x[1] ** 2 + p.friction_2 * x[3] ** 2)


def test_a_law_of_one_axis_gets_this_axis_first(x):
    rows = [0.0] * (2 * 7 * 5)
    TwoLinkArm.structure(list(x), arm().machine_constants, rows)
    full = np.reshape(rows, (2, 7, 5))
    first = np.reshape(coupled_regressors(arm(0), [*x[:2], *x[2:]]), (7, 5))
    second = np.reshape(coupled_regressors(arm(1), [*x[2:], *x[:2]]), (7, 5))
    np.testing.assert_array_equal(first, full[0])
    np.testing.assert_array_equal(second, full[1][:, [0, 2, 1, 4, 3]])


def test_a_plant_of_one_axis_gives_its_regressors():
    servo = Servo()
    y = [0.0, 0.0]
    Servo.regressors((0.3, 0.5), servo.constants, y)
    assert coupled_regressors(servo, [0.3, 0.5, 9.0, 9.0]) == y
    assert regressor_count(servo, True) == 2
    assert (regressor_count(arm(), True), regressor_count(arm(), False)) == (7, 2)


@pytest.mark.parametrize('axis', [0, 1])
def test_view_is_the_joint_with_the_other_one_held(axis):
    """At a right angle and level, held at rest by the other motor; one axis of the structure."""
    plant = arm(axis)
    at = np.array([0.0, 0.0, np.pi / 2.0, 0.0])
    at[2 * axis + 1] = 0.8
    gravity, mass, force = parts(plant, at)
    y = [0.0, 0.0]
    TwoLinkArm.regressors(at[2 * axis:2 * axis + 2].tolist(), plant.constants, y)
    w, k = 0.7, plant.parameters.torque_constant
    alone = (k * w - force[axis, axis] * 0.8 - gravity[axis]) / mass[axis, axis]
    assert plant.b * w - np.dot(plant.a, y) == pytest.approx(alone)


def test_machine_needs_both_axes():
    with pytest.raises(ConfigurationError, match='must have 2 axes'):
        Configuration.from_flat({'plant.model': 'two_link_arm', 'loop.axes': ['one']})
    assert issubclass(TwoLinkArm, CoupledPlant)


def test_simulation_follows_the_motion_solved_by_scipy():
    """The loop offline without command: the arm falls."""
    c = Configuration.from_flat({
        'plant.model': 'two_link_arm', 'loop.axes': ['shoulder', 'elbow'], 'loop.duration': 0.5,
        'controller.law': 'pd', 'controller.k_d': 1e-9, 'axes.elbow.plant.x0': [0.5, 0.0]})
    runs = simulate_axes(c)
    plant = c.plant

    def right(_, z):
        rates = motion(plant, z, (0.0, 0.0))
        return [z[1], rates[0], z[3], rates[1]]

    solved = integrate.solve_ivp(right, (0.0, 0.5), [0.0, 0.0, 0.5, 0.0], rtol=1e-11,
                                 atol=1e-12).y[:, -1]
    got = np.concatenate([runs['shoulder'].x[-1], runs['elbow'].x[-1]])
    np.testing.assert_allclose(got, solved, atol=1e-6)
