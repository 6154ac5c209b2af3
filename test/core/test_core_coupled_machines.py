# SPDX-License-Identifier: Apache-2.0
"""Shipped machines whose plant serves several axes: the whole loop by their configurations."""

import numpy as np
import pytest

from dz_ros.core.axes import Rows
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.controllers import controller_of
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.records import Reference, State
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.report.view import View
from dz_ros.runs.axes import each_axis


def errors(name, *changes):
    """Return the largest |x̃| of each axis over the last 4 s of 10 s."""
    runs = simulate_axes(load_configuration(name, ['loop.duration=10', *changes]))
    return {axis: np.abs(run.x[run.t > 6.0, 0] - run.x_d[run.t > 6.0, 0]).max()
            for axis, run in runs.items()}


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'changes', 'allowed'), [
    ('two_link_arm', (), 0.0015), ('two_link_arm', ('loop.delay=1',), 0.002),
    ('rov_planar', ('loop.delay=1',), 0.0005),
    ('rov_planar', ('plant.voltage=12.0',), 0.001)])
def test_every_axis_follows(name, changes, allowed):
    assert max(errors(name, *changes).values()) < allowed


def test_without_observer_and_layer_the_arm_does_not_follow():
    """The table can fail: what is left of the law leaves the dead-zones to the damping."""
    found = errors('two_link_arm', 'controller.k_star=0.01', 'controller.rho_1=0',
                   'controller.gamma=0')
    assert max(found.values()) > 0.02


def test_the_vehicle_that_turns_couples_its_axes():
    """What yaw does shows in the disturbance of surge [m/s²]."""
    c = load_configuration('rov_planar', ['loop.duration=3'])
    turned = simulate_axes(c)['surge'].truth[:, 2]
    straight = simulate_axes(c.replace(**{'axes.yaw.trajectory.amplitude': 0.0}))['surge']
    assert np.abs(turned - straight.truth[:, 2]).max() > 0.2


def test_a_report_knows_the_true_weights_and_the_layer_of_each_axis():
    c = load_configuration('two_link_arm', ['loop.duration=1', 'plant.torque_constant=2',
                                            'plant.dead_zone.m_r=1.25'])
    run = from_runs(simulate_axes(c), c)
    for name, data in each_axis(run).items():
        setting = View.of(data).setting
        weights = c.axis(name).plant.weights
        for number, weight in enumerate(weights, 1):
            assert setting.true_signals[f'theta{number}'] == pytest.approx(
                (weight / 2.0, weight / 2.5))
        assert 'phi' not in setting.true_signals
        gains = c.axis(name).law.gains
        own = gains.inertia[0 if name == 'shoulder' else 3]
        assert setting.epsilon == pytest.approx(gains.k_star / (gains.kappa * own))


KNOWN = ('controller.table_points=[10.0, 20.0]', 'controller.m_r_known=[1.0, 1.0]',
         'controller.m_l_known=[1.0, 1.0]', 'controller.b_r_known=[3.0, 1.0]',
         'controller.b_l_known=[-3.0, -1.0]', 'controller.psi_0=12.0',
         'loop.schedule_values=[10.0, 20.0]', 'loop.schedule_times=[0.0, 0.4]')


@pytest.mark.parametrize('changes', [
    (), ('controller.error_band=0.01',), ('controller.regressors_at=reference',),
    ('controller.law=scheduled', *KNOWN)])
def test_the_controllers_answer_the_offline_loop_bit_for_bit(changes):
    """What the law sees and keeps is the same on a plant that couples the axes."""
    c = load_configuration('rov_planar', ['loop.duration=0.5', 'loop.timing=lockstep', *changes])
    runs, controllers, period = simulate_axes(c).values(), controller_of(c), c.loop.period
    for k in range(c.loop.samples + 1):
        controllers.set_reference(Rows(
            Reference(k, k * period, tuple(run.x_d[k].tolist())) for run in runs))
        command, _ = controllers.respond(Rows(
            State(k, k * period, tuple(run.x_measured[k].tolist()), k - 1, (k - 1) * period)
            for run in runs))
        assert command.v == tuple(run.v[k] for run in runs)


@pytest.mark.parametrize('change', ['controller.error_band=0.01',
                                    'controller.regressors_at=reference'])
def test_a_law_that_knows_all_axes_sees_them_as_they_are(change):
    with pytest.raises(ConfigurationError, match='takes all axes as they are measured'):
        load_configuration('two_link_arm', [change])
