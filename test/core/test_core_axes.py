# SPDX-License-Identifier: Apache-2.0
"""Loops of several axes: configuration, offline loop, plants and laws that couple axes.

Over 300 lines: configuration, loop and coupling of axes share the plants and laws defined here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
import pytest

from dz_ros.core.axes_keys import AXIS_SECTIONS, is_machines
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, from_runs
from dz_ros.core.design.rules import check
from dz_ros.core.laws.pd import Pd
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants.coupled import CoupledParameters, CoupledPlant
from dz_ros.core.plants.servo import Servo
from dz_ros.core.schema import parameter
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import ConfigurationError, DivergedError
from dz_ros.files.configurations import (
    flat_parameters,
    format_parameters,
    load_configuration,
)

NAMES = ('base', 'shoulder', 'elbow', 'roll', 'pitch', 'yaw')
THREE = {'loop.axes': ['surge', 'sway', 'yaw'], 'loop.duration': 0.5, 'loop.seed': 7,
         'plant.noise': [0.001, 0.01], 'plant.x0': [0.1, 0.0],
         'axes.sway.plant.dead_zone.b_r': 0.2, 'axes.yaw.controller.lambda': 2.0,
         'axes.yaw.safety.command_limit': 3.0, 'axes.surge.trajectory.amplitude': 1.5}


@pytest.fixture(scope='module')
def three():
    return Configuration.from_flat(THREE)


def test_the_shipped_configuration_has_its_axes():
    c = load_configuration('six_axes')
    assert c.axis_names == NAMES
    assert c.loop.axes == NAMES
    assert [item.loop.axes for item in c.each] == [()] * 6
    assert c.axis('yaw').law.gains.gamma == 1.0
    assert c.axis('elbow').dead_zone.m_r == 1.1
    assert c.axis('pitch').trajectory.name == 'sinusoid'
    assert not c.set_aside


def test_sections_are_the_default_and_axes_override_them(three):
    assert three.axis('sway').dead_zone.b_r == 0.2
    assert three.axis('surge').dead_zone.b_r == 0.5
    assert [item.law.gains.lambda_ for item in three.each] == [1.0, 1.0, 2.0]
    assert [item.safety.command_limit for item in three.each] == [0.0, 0.0, 3.0]
    changed = Configuration.from_changed(THREE, {'controller.lambda': 4.0,
                                                 'axes.sway.controller.lambda': 5.0})
    assert [item.law.gains.lambda_ for item in changed.each] == [4.0, 5.0, 2.0]


def test_no_two_axes_have_the_same_noise(three):
    assert [item.loop.seed for item in three.each] == [7, 8, 9]


def test_flat_keys_and_files_give_the_same_configuration_again(three, tmp_path):
    flat = three.to_flat()
    assert Configuration.from_flat(flat).to_flat() == flat
    assert Configuration.from_untrusted(flat).to_flat('controller') == three.to_flat('controller')
    file = tmp_path / 'written.yaml'
    file.write_text(format_parameters(three), encoding='utf-8')
    assert load_configuration(file).to_flat() == flat
    assert set(three.fields()) == set(flat)
    for name, own in zip(three.axis_names, three.each, strict=True):
        assert Configuration.from_flat(own.to_flat()).to_flat() == own.to_flat()
        assert all(flat[f'axes.{name}.{key}'] == value for key, value in own.to_flat(
            *AXIS_SECTIONS).items() if not is_machines(key))


def test_an_empty_list_of_an_axis_is_not_that_of_the_first(tmp_path):
    c = Configuration.from_flat({'loop.axes': ['a', 'b'], 'axes.a.plant.x0': [3.0, 0.0]})
    file = tmp_path / 'written.yaml'
    file.write_text(format_parameters(c), encoding='utf-8')
    assert load_configuration(file).to_flat() == c.to_flat()
    assert load_configuration(file).axis('b').x0 == c.axis('b').plant.default_x0


def test_replace_changes_one_axis_or_all(three):
    found = three.replace(**{'controller.lambda': 3.0, 'axes.sway.controller.lambda': 6.0,
                             'loop.seed': 20})
    assert [item.law.gains.lambda_ for item in found.each] == [3.0, 6.0, 3.0]
    assert [item.loop.seed for item in found.each] == [20, 21, 22]
    assert found.axis_names == three.axis_names
    assert found.axis('sway').dead_zone.b_r == 0.2
    assert three.replace(**{'loop.axes': ['surge', 'yaw', 'sway']}).axis_names == (
        'surge', 'yaw', 'sway')


@pytest.mark.parametrize(('changed', 'wanted'), [
    ({'axes.yaw.controller.lamda': 2.0}, 'axes.yaw.controller.lamda = 2.0: unknown key'),
    ({'axes.yaw.controller.lambda': -2.0}, 'axes.yaw.controller.lambda = -2.0: must be'),
    ({'axes.jaw.controller.lambda': 2.0}, 'loop.axes names surge, sway, yaw, not jaw'),
    ({'axes.yaw.loop.rate': 100.0}, 'loop.rate is one for all axes'),
    ({'axes.yaw.process.priority': 1}, 'process.priority is one for all axes'),
    ({'axes.yaw.safety.state_hold': 3}, 'safety.state_hold is one for all axes'),
    ({'axes.yaw': 3}, 'must be axes.NAME.SECTION.KEY'),
    ({'axes..controller.lambda': 3}, 'must be axes.NAME.SECTION.KEY'),
    ({'axes.yaw.contoller.lambda': 3}, 'unknown section contoller; an axis has its own plant, '
     'controller, trajectory, driver, safety; did you mean controller?'),
    ({'axes.yaw.controller.law': 'pid'}, 'two loops'),
    ({'axes.yaw.plant.model': 'first_order', 'axes.yaw.plant.x0': [0.0],
      'axes.yaw.plant.noise': [0.0]}, 'two loops'),
    ({'axes.yaw.plant.model': 'first_order'}, 'two loops'),
    ({'axes.yaw.plant.x0': [0.1]}, 'axes.yaw.plant.x0 = [0.1]: must have 2 numbers'),
    ({'axes.yaw.plant.model': 'first_order', 'plant.x0': [0.2, 0.0]},
     'plant.x0 = [0.2, 0.0]: must have 1 number, one for each state (axis yaw)'),
    ({'loop.axes': ['yaw', 'yaw', 'sway', 'surge']}, 'names yaw twice'),
    ({'loop.axes': ['surge', 'sway', 'yaw', '1x']}, 'must be a name of letters'),
    ({'loop.axes': []}, 'loop.axes names no axes'),
])
def test_what_an_axis_cannot_have_is_refused_in_one_line(changed, wanted):
    for change in (lambda: Configuration.from_changed(THREE, changed),
                   lambda: Configuration.from_flat(THREE).replace(**changed)):
        with pytest.raises(ConfigurationError) as refused:
            change()
        assert wanted in str(refused.value)
        assert '\n' not in str(refused.value)


def test_an_axis_that_is_not_there_is_named(three):
    with pytest.raises(ConfigurationError, match='must be one of surge, sway, yaw'):
        three.axis('heave')
    with pytest.raises(ConfigurationError, match='one axis, without a name'):
        Configuration.from_flat({}).axis('yaw')
    with pytest.raises(ConfigurationError, match='names no axes, not yaw'):
        Configuration.from_flat({}).replace(**{'axes.yaw.controller.lambda': 2.0})


def test_a_loop_of_one_axis_gets_axes_by_their_names():
    c = Configuration.from_flat({}).replace(**{'loop.axes': ['a', 'b'],
                                               'axes.b.controller.lambda': 2.0})
    assert [item.law.gains.lambda_ for item in c.each] == [1.0, 2.0]
    with pytest.raises(ConfigurationError, match='must be one axis'):
        c.require_one()


def test_waypoints_of_an_axis_are_read_from_its_file(tmp_path):
    (tmp_path / 'way.csv').write_text('0,0\n1,1\n2,0\n', encoding='ascii')
    file = tmp_path / 'c.yaml'
    file.write_text('loop: {axes: [a, b]}\naxes: {b: {trajectory: {kind: waypoints, '
                    'file: way.csv}}}\n', encoding='ascii')
    flat = flat_parameters(file)
    assert flat['axes.b.trajectory.positions'] == [0.0, 1.0, 0.0]
    assert load_configuration(file).axis('b').trajectory.name == 'waypoints'
    (tmp_path / 'way.csv').unlink()
    with pytest.raises(ConfigurationError, match=r'^axes\.b\.trajectory\.file = .*: no such file'):
        load_configuration(file)


def test_each_axis_offline_is_the_loop_of_that_axis_alone(three):
    runs = simulate_axes(three)
    assert list(runs) == ['surge', 'sway', 'yaw']
    for name, run in runs.items():
        alone = simulate(Configuration.from_flat(three.axis(name).to_flat()))
        for part in ('x', 'x_measured', 'x_d', 'v', 'v_applied', 'truth', 'terms'):
            assert getattr(run, part).tobytes() == getattr(alone, part).tobytes(), (name, part)
    assert not np.array_equal(runs['surge'].x_measured, runs['sway'].x_measured)


def test_one_axis_offline_is_what_it_was():
    c = Configuration.from_flat({'loop.duration': 0.2})
    runs = simulate_axes(c)
    assert list(runs) == ['']
    data, alone = from_runs(runs, c), from_run(simulate(c))
    assert data.axes == ()
    assert data.configuration == alone.configuration
    for name, channel in alone.channels.items():
        assert data.channels[name].values.tobytes() == channel.values.tobytes()


def test_what_is_done_for_one_axis_refuses_several(three):
    for do in (simulate, check):
        with pytest.raises(ConfigurationError, match='must be one axis'):
            do(three)


def test_channels_of_all_axes_hold_those_of_each(three):
    runs = simulate_axes(three)
    data = from_runs(runs, three, 5)
    assert data.axes == three.axis_names
    for name, run in runs.items():
        alone = from_run(run, 5)
        for topic, channel in data.channels.items():
            found = channel.axis(name)
            assert found.labels == alone.channels[topic].labels
            assert found.values.tobytes() == alone.channels[topic].values.tobytes()
            assert (channel['seq'] == found['seq']).all()


@dataclass(frozen=True)
class SpringsParameters(CoupledParameters):
    """Two masses with a spring between them."""

    stiffness: float = parameter(3.0, 'N/m', 'of the spring', minimum=0.0)


class Springs(CoupledPlant):
    """x_i'' = w_i − 0.5 x_i' − k (x_i − x_j)."""

    name = 'springs'
    summary = 'two masses and a spring'
    order = 2
    regressor_count = 1
    state_units = ('m', 'm/s')
    actuator_unit = 'N'
    default_x0 = (0.1, 0.0)
    axes = 2
    Parameters = SpringsParameters

    @property
    def a(self):
        return (0.5,)

    @property
    def b(self):
        return 1.0

    @property
    def machine_constants(self):
        return (self.parameters.stiffness,)

    @staticmethod
    def regressors(x, p, y):
        y[0] = x[1]

    @staticmethod
    def dynamics(t, x, w, p, out):
        out[0] = w[0] - 0.5 * x[1] - p[0] * (x[0] - x[2])
        out[1] = w[1] - 0.5 * x[3] - p[0] * (x[2] - x[0])


class Both(Pd):
    """A PD law that subtracts a tenth of the other axis' error."""

    name = 'both'
    summary = 'PD of two axes'
    coupled = True

    @staticmethod
    def kernel(c, memory, x_d, x, y, dt, new_memory, terms):
        n = len(x) // 2
        own = Pd.kernel(c, memory[:len(new_memory)], x_d[:n + 1], x[:n], y, dt, new_memory, terms)
        return own - 0.1 * (x[n] - x_d[n + 1])


SPRINGS = {'loop.axes': ['left', 'right'], 'loop.duration': 1.0,
           'plant.model': f'{__name__}:Springs', 'controller.law': 'pd',
           'axes.right.plant.x0': [-0.3, 0.0], 'plant.command_limit': 4.0,
           'axes.right.plant.dead_zone.b_r': 0.2}


def test_a_coupled_plant_moves_its_axes_together():
    c = Configuration.from_flat(SPRINGS)
    assert [item.plant.axis for item in c.each] == [0, 1]
    runs = simulate_axes(c)
    left, right = runs['left'], runs['right']
    # The reference: the same equations in one step of RK4 at a time, written out.
    x = np.array([0.1, 0.0, -0.3, 0.0])

    def slope(x, w):
        return np.array([x[1], w[0] - 0.5 * x[1] - 3.0 * (x[0] - x[2]),
                         x[3], w[1] - 0.5 * x[3] - 3.0 * (x[2] - x[0])])

    h = 0.005 / 4
    for k in range(200):
        assert np.allclose((*left.x[k], *right.x[k]), x, rtol=0, atol=1e-12)
        w = np.array([left.truth[k, 0], right.truth[k, 0]])
        for _ in range(4):
            k1 = slope(x, w)
            k2 = slope(x + h / 2 * k1, w)
            k3 = slope(x + h / 2 * k2, w)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + h * k3, w))
    spring = 3.0 * (left.x[:, 0] - right.x[:, 0])
    assert np.allclose(left.truth[:, 2], spring, rtol=0, atol=1e-12)
    assert np.allclose(right.truth[:, 2], -spring, rtol=0, atol=1e-12)
    assert not np.allclose(left.x, simulate(c.axis('left')).x)


def test_without_coupling_it_is_two_scalar_loops():
    c = Configuration.from_flat({**SPRINGS, 'plant.stiffness': 0.0})
    for name, run in simulate_axes(c).items():
        alone = simulate(c.axis(name))
        assert np.allclose(run.x, alone.x, rtol=0, atol=1e-12)
        assert np.allclose(run.v, alone.v, rtol=0, atol=1e-9)


def test_a_law_that_knows_all_axes_gets_own_numbers_first():
    c = Configuration.from_flat({'loop.axes': ['a', 'b'], 'loop.duration': 0.5,
                                 'axes.b.plant.x0': [1.0, 0.0],
                                 'controller.law': f'{__name__}:Both'})
    runs = simulate_axes(c)
    error = {name: run.x[:, 0] - run.x_d[:, 0] for name, run in runs.items()}
    for name, other in (('a', 'b'), ('b', 'a')):
        run, law = runs[name], c.axis(name).law
        for k in (0, 57, 99):
            own = Pd.kernel(law.constants, (), run.x_d[k], run.x_measured[k], (), 0.005, [],
                            [0.0] * run.terms.shape[1])
            assert run.v[k] == own - 0.1 * float(error[other][k])
        assert math.isfinite(run.x[-1, 0])


@pytest.mark.parametrize(('c', 'where', 'samples'), [
    # A command that is no number cannot be rounded; it acts three samples late.
    (lambda: Configuration.from_flat({
        **SPRINGS, 'plant.command_limit': 0.0, 'loop.delay': 3,
        'axes.right.plant.x0': [1e308, 0.0], 'axes.right.plant.command_resolution': 0.1}),
     'axis right', 3),
    # An angle that is no number has no cosine; the vehicle moves as one.
    (lambda: load_configuration('rov_planar', ['axes.yaw.plant.x0=[0.0, 1.0e+200]']),
     'axes surge, sway, yaw', 1)], ids=['axis', 'plant'])
def test_coupled_axes_that_diverge_are_named_with_the_first_sample_that_fails(c, where, samples):
    c = c()
    period = c.loop.period
    with pytest.raises(DivergedError, match=rf'^{where}: the loop diverged') as caught:
        simulate_axes(c)
    assert caught.value.t == pytest.approx(samples * period)
    assert caught.value.where == where
    with pytest.raises(DivergedError):
        simulate_axes(c.replace(**{'loop.duration': samples * period}))
    if samples > 1:
        simulate_axes(c.replace(**{'loop.duration': (samples - 1) * period}))


@pytest.mark.parametrize(('changed', 'wanted'), [
    ({'loop.axes': ['left', 'right', 'middle']}, 'must have 2 axes'),
    ({'axes.right.plant.stiffness': 1.0},
     'axes.right.plant.stiffness = 1.0: must be the same for all axes, 3.0 as of axis left'),
    ({'axes.right.plant.model': 'servo'}, 'must be the same for all axes'),
    ({'axes.right.plant.substeps': 2}, 'axes.right.plant.substeps = 2: must be 4'),
    ({'axes.right.driver.name': 'mock'}, "axes.right.driver.name = 'mock': must be the same"),
    ({'axes.right.plant.axis': 0}, 'axes.right.plant.axis = 0: is the place of the axis'),
    ({'plant.axis': 1}, 'plant.axis = 1: is the place of the axis'),
    ({'axes.right.controller.law': f'{__name__}:Both'}, 'must be the law of all'),
])
def test_what_does_not_go_with_coupled_axes_is_refused(changed, wanted):
    with pytest.raises(ConfigurationError, match=wanted):
        Configuration.from_changed(SPRINGS, changed)
    with pytest.raises(ConfigurationError, match=wanted):
        Configuration.from_flat(SPRINGS).replace(**changed)


def test_axes_that_only_their_law_couples_are_simulated_in_the_same_steps():
    keys = {'loop.axes': ['a', 'b'], 'controller.law': f'{__name__}:Both'}
    assert Configuration.from_flat({**keys, 'plant.substeps': 2}).axis('b').loop.axes == ()
    with pytest.raises(ConfigurationError, match=r'axes\.b\.plant\.substeps = 2: must be 4'):
        Configuration.from_flat({**keys, 'axes.b.plant.substeps': 2})


def test_the_place_of_an_axis_follows_from_their_order():
    c = Configuration.from_flat(SPRINGS).replace(**{'plant.axis': 0, 'axes.right.plant.axis': 1})
    assert [item.plant.axis for item in c.each] == [0, 1]
    swapped = c.replace(**{'loop.axes': ['right', 'left']})
    assert [(name, item.plant.axis) for name, item in swapped.axes] == [('right', 0), ('left', 1)]


def test_drivers_of_one_class_are_made_together_beside_others():
    made = []

    class Bus(SimulatedActuator):
        """Notes which axes are made together."""

        name = 'bus'

        @classmethod
        def for_axes(cls, each):
            made.append([item.loop.seed for item in each])
            return super().for_axes(each)

    class Other(Bus):
        """Another device."""

        name = 'other'

    c = Configuration.from_flat({'loop.axes': ['a', 'b', 'c']})
    c = replace(c, axes=tuple((name, replace(item, driver_class=chosen)) for (name, item), chosen
                              in zip(c.axes, (Bus, Other, Bus), strict=True)))
    assert [type(item) for item in c.make_drivers()] == [Bus, Other, Bus]
    assert made == [[0, 2], [1]]


def test_the_view_of_one_axis_is_a_plant_of_its_own():
    view = Configuration.from_flat(SPRINGS).axis('right')
    assert isinstance(view.plant, CoupledPlant)
    assert view.plant.axis == 1
    again = Configuration.from_flat(view.to_flat())
    assert again.plant.axis == 1
    assert not issubclass(Servo, CoupledPlant)
