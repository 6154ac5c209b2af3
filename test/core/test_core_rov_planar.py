# SPDX-License-Identifier: Apache-2.0
"""The vehicle in the plane and its allocation against matrices written out again."""

import numpy as np
import pytest
from scipy import integrate

from dz_ros.core.plants.allocation import allocate, pseudo_inverse, vectored
from dz_ros.core.plants.rov_planar import FULL, RovPlanar, RovPlanarParameters
from dz_ros.core.plants.thruster import SLOPE, thrust

STEP = 1e-6
UNUSUAL = {'mass': 11.0, 'added_mass_sway': 12.0, 'linear_drag_sway': 4.0, 'linear_drag_yaw': 0.7,
           'voltage': 13.0, 'angle': 0.6, 'lever': 0.25, 'wave_force': 3.0}


def rov(axis=0, **changed):
    return RovPlanar(RovPlanarParameters(axis=axis, **{**UNUSUAL, **changed}))


@pytest.fixture(params=range(6))
def x(request):
    """Displacements and speeds of surge, sway, yaw."""
    return np.random.default_rng(request.param).uniform(-1.5, 1.5, 6)


def rotation(psi):
    return np.array([[np.cos(psi), -np.sin(psi), 0.0], [np.sin(psi), np.cos(psi), 0.0],
                     [0.0, 0.0, 1.0]])


def body(plant, nu):
    """M, C(ν) by the skew-symmetric choice, D(ν)."""
    m = np.array(plant.weights)
    u, v, _ = nu
    coriolis = np.array([[0.0, 0.0, -m[1] * v], [0.0, 0.0, m[0] * u],
                         [m[1] * v, -m[0] * u, 0.0]])
    return np.diag(m[:3]), coriolis, np.diag(m[3:6] + m[6:] * np.abs(nu))


def parts(plant, x):
    """g, M, C of the structure with the true weights."""
    rows = [0.0] * (3 * 9 * 7)
    RovPlanar.structure(list(x), plant.machine_constants, rows)
    summed = np.einsum('ikc,k->ic', np.reshape(rows, (3, 9, 7)), plant.weights)
    return summed[:, 0], summed[:, 1:4], summed[:, 4:]


def motion(plant, t, x, w):
    out = [0.0] * 3
    RovPlanar.dynamics(t, list(x), list(w), plant.machine_constants, out)
    return np.array(out)


def pushed(plant, psi, w):
    """Force and moment in the frame at rest that the thrusters give for a demand."""
    p = plant.parameters
    matrix = vectored(p.angle, p.lever)
    wanted = np.linalg.lstsq(matrix, rotation(psi).T @ w, rcond=None)[0]
    wanted = wanted / max(1.0, np.abs(wanted).max() / (FULL * SLOPE))
    return rotation(psi) @ matrix @ [thrust(item / SLOPE, p.voltage) for item in wanted]


def test_motion_is_that_of_the_body_s_equations(x):
    plant, t = rov(), 0.7
    w = np.random.default_rng(9).uniform(-60.0, 60.0, 3)
    turn = rotation(x[4])
    nu = turn.T @ x[1::2]
    mass, coriolis, drag = body(plant, nu)
    p = plant.parameters
    wave = np.array([p.wave_force * np.sin(p.wave_frequency * t), 0.0, 0.0])
    force = turn.T @ (pushed(plant, x[4], w) + wave)
    faster = np.linalg.solve(mass, force - (coriolis + drag) @ nu)
    rate = (rotation(x[4] + STEP) - rotation(x[4] - STEP)) / (2.0 * STEP) * x[5]
    np.testing.assert_allclose(motion(plant, t, x, w), turn @ faster + rate @ nu, rtol=1e-7,
                               atol=1e-8)


def test_motion_satisfies_the_structure_with_the_true_weights(x):
    """Without waves: Σ_k m_k Y_k = force, with accelerations by finite differences."""
    plant = rov(wave_force=0.0)
    w = np.random.default_rng(4).uniform(-40.0, 40.0, 3)

    def right(_, z):
        rates = motion(plant, 0.0, z, w)
        return [z[1], rates[0], z[3], rates[1], z[5], rates[2]]

    span = 1e-4
    solved = integrate.solve_ivp(right, (0.0, 2.0 * span), x, t_eval=[0.0, span, 2.0 * span],
                                 rtol=1e-12, atol=1e-13).y
    rates = (solved[1::2, 2] - solved[1::2, 0]) / (2.0 * span)
    at = solved[:, 1]
    gravity, mass, forces = parts(plant, at)
    force = pushed(plant, at[4], w)
    np.testing.assert_allclose(mass @ rates + forces @ at[1::2] + gravity, force, rtol=1e-4,
                               atol=2e-3)


def test_rate_of_the_inertia_less_twice_c_is_skew_symmetric(x):
    plant = rov(linear_drag_surge=0.0, linear_drag_sway=0.0, linear_drag_yaw=0.0,
                quadratic_drag_surge=0.0, quadratic_drag_sway=0.0, quadratic_drag_yaw=0.0)

    def mass(time):
        moved = x.copy()
        moved[::2] += time * x[1::2]
        return parts(plant, moved)[1]

    skew = (mass(STEP) - mass(-STEP)) / (2.0 * STEP) - 2.0 * parts(plant, x)[2]
    np.testing.assert_allclose(skew, -skew.T, atol=1e-6)
    assert np.abs(skew).max() > 1e-2


def test_structure_with_other_speeds_is_that_of_the_body(x):
    """With v and a that are not those of the motion."""
    plant = rov()
    v, a = np.random.default_rng(2).normal(size=(2, 3))
    turn = rotation(x[4])
    nu = turn.T @ x[1::2]
    mass, coriolis, drag = body(plant, nu)
    rate = (rotation(x[4] + STEP) - rotation(x[4] - STEP)) / (2.0 * STEP) * x[5]
    expected = turn @ (mass @ (turn.T @ a + rate.T @ v) + (coriolis + drag) @ turn.T @ v)
    gravity, inertia, forces = parts(plant, x)
    np.testing.assert_allclose(gravity + inertia @ a + forces @ v, expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_view_is_the_axis_alone(axis):
    plant = rov(axis, wave_force=0.0)
    at = np.zeros(6)
    at[2 * axis + 1] = 0.6
    w = np.zeros(3)
    y = [0.0, 0.0]
    RovPlanar.regressors(at[2 * axis:2 * axis + 2].tolist(), plant.constants, y)
    assert motion(plant, 0.0, at, w)[axis] == pytest.approx(-np.dot(plant.a, y))
    assert plant.b * parts(plant, at)[1][axis, axis] == pytest.approx(1.0)


def test_units_are_those_of_the_axis():
    assert rov(0).state_units == rov(1).state_units == ('m', 'm/s')
    assert (rov(2).state_units, rov(2).actuator_unit) == (('rad', 'rad/s'), 'N m')


def test_pseudo_inverse_gives_the_wanted_force_with_the_least_effort():
    matrix = vectored(0.7, 0.2)
    inverse = pseudo_inverse(matrix)
    np.testing.assert_allclose(matrix @ inverse, np.eye(3), atol=1e-12)
    wanted = np.array([20.0, -8.0, 1.5])
    found = [0.0] * 4
    assert allocate(inverse.ravel().tolist(), 0, wanted.tolist(), 1e9, found) == 1.0
    np.testing.assert_allclose(matrix @ found, wanted, atol=1e-9)
    idle = np.array([1.0, 1.0, -1.0, -1.0])      # in the null space of B
    np.testing.assert_allclose(matrix @ idle, 0.0, atol=1e-12)
    for other in (0.1, -0.1):
        assert np.linalg.norm(found) < np.linalg.norm(np.add(found, other * idle))


@pytest.mark.parametrize('size', [1.0, 3.0, 100.0])
def test_saturation_scales_all_thrusters_so_that_the_direction_stays(size):
    matrix = vectored(0.7, 0.2)
    wanted = size * np.array([20.0, -8.0, 1.5])
    found = [0.0] * 4
    share = allocate([7.0, *pseudo_inverse(matrix).ravel().tolist()], 1, wanted.tolist(), 15.0,
                     found)
    assert np.abs(found).max() <= 15.0 * (1.0 + 1e-12)
    np.testing.assert_allclose(matrix @ found, share * wanted, atol=1e-9)
    assert (share < 1.0) == (size > 1.0)


def test_small_forces_move_nothing_and_both_sides_differ():
    plant = rov(wave_force=0.0)
    assert motion(plant, 0.0, np.zeros(6), (8.0, 0.0, 0.0)).tolist() == [0.0, 0.0, 0.0]
    forwards = motion(plant, 0.0, np.zeros(6), (60.0, 0.0, 0.0))[0]
    backwards = motion(plant, 0.0, np.zeros(6), (-60.0, 0.0, 0.0))[0]
    assert forwards > -backwards > 0.0
