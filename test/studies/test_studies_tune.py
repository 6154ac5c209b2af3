# SPDX-License-Identifier: Apache-2.0
"""Proposed gains obey the rules they are made from, and hold what they promise in simulation."""

import json

import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.design.boundary_layer import chatter_limit
from dz_ros.core.design.command_steps import limit_cycle_bound
from dz_ros.core.design.finding import ERROR, INFO
from dz_ros.core.design.linear_loop import largest_beta
from dz_ros.core.design.rules import check
from dz_ros.core.design.stability import lost_from_start
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.tune import feels_velocity, proposal_at, tune

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def plain_processes():
    """Loops are compiled: a search runs some dozens of each kind."""


def tuned(name='wang2004', *overrides, **settings):
    return tune(load_configuration(name, ['loop.duration=8', *overrides]), **settings)


def test_the_paper_s_k_star_comes_out_of_its_bounds():
    found = tuned()
    gains = found.after.law.gains
    assert gains.k_star == pytest.approx(2.5, abs=1e-3)
    assert gains.k_d == 10.0
    steep = gains.k_d + gains.k_star / gains.epsilon + gains.lambda_ * gains.phi_0
    assert steep * 1.25 * 0.005 == pytest.approx(0.5 * chatter_limit(1), rel=0.01)


@pytest.mark.parametrize(('name', 'overrides'), [
    ('wang2004', ()), ('robust', ()), ('pendulum', ()), ('first_order', ()),
    ('wang2004', ('loop.delay=2', 'controller.epsilon=0.01')),
    ('robust', ('controller.b_bounds=[0.5, 2.0]',))])
def test_no_rule_finds_an_error_and_the_loop_is_calm(name, overrides):
    found = tuned(name, *overrides)
    assert all(item.level != ERROR for item in check(found.after))
    assert all(not row['lost'] for key, row in found.rows.items() if key.startswith('after'))
    assert set(found.reasons) <= set(found.after.to_flat())


EXTENDED = ('controller.law=extended', 'controller.projection=true')
WIDE = ('controller.theta_max=[400]', 'controller.phi_max=60')
LAWS = {
    'paper': ('controller.law=wang2004',),
    'robust': ('controller.law=robust',),
    'robust, steep': ('controller.law=robust', 'controller.margin=1.0', 'loop.delay=2',
                      'controller.m_bounds=[1.0, 1.0]'),
    'integral': (*EXTENDED, 'controller.integral=true', 'controller.anti_windup=true',
                 'controller.v_max=40', 'controller.integral_divisor=16.0'),
    'quick integral': (*EXTENDED, 'controller.integral=true', 'controller.integral_divisor=1.0'),
    'automatic': (*EXTENDED, 'controller.automatic_epsilon=true', 'controller.integral=true',
                  'controller.integral_divisor=2.0'),
    'guessed': (*EXTENDED, 'controller.dead_zone_feed_forward=true', 'controller.b_r_guess=1.5'),
}


@pytest.mark.parametrize(('plant', 'law'), [
    *(('wang2004', law) for law in LAWS), *(('zhang_feng1997', law) for law in LAWS),
    ('servo', 'robust'), ('servo', 'integral'), ('first_order', 'robust'),
    ('first_order', 'integral')])
def test_whatever_is_proposed_may_start(law, plant):
    """The controller's own rules, the run from x(0) included, find no error in any proposal."""
    box = WIDE if plant == 'first_order' else ()
    found = tuned(plant, *LAWS[law], *box)
    assert [(item.rule, item.words) for item in check(
        found.after, lost=lost_from_start(found.after)) if item.level == ERROR] == []
    assert all(not row['lost'] for key, row in found.rows.items() if key.startswith('after'))


def test_k_star_covers_the_integral_and_what_a_guess_leaves():
    plain, integral = (tuned('wang2004', 'controller.law=extended', f'controller.integral={on}')
                       for on in ('false', 'true'))
    assert integral.after.law.gains.k_star - plain.after.law.gains.k_star == pytest.approx(1.47)
    assert 'of the integral' in integral.reasons['controller.k_star']
    bad = tuned('wang2004', *LAWS['guessed']).after.law.gains
    assert bad.k_star > plain.after.law.gains.k_star


@pytest.mark.parametrize(('name', 'feels'), [
    ('robust', False), ('zhang_feng1997', True), ('servo', True), ('first_order', False)])
def test_a_steep_slope_has_no_outer_gain_where_regressors_hang_on_velocities(name, feels):
    steep = load_configuration(name, ['controller.law=robust', 'controller.lambda=10', *WIDE])
    assert feels_velocity(steep) is feels
    gentle = steep.replace(**{'controller.lambda': 1.0})
    for c, outer in ((steep, not feels), (gentle, True)):
        gains = tune_at(c).law.gains
        assert gains.k_2 == (2.0 * gains.k_d if outer else 0.0)


@pytest.mark.parametrize(('law', 'slope'), [('robust', 10.0), ('robust', 1.0)])
def test_reason_of_the_outer_gain_is_the_true_one(law, slope):
    found = tuned('servo', f'controller.law={law}', f'controller.lambda={slope}')
    gains, why = found.after.law.gains, found.reasons['controller.k_2']
    assert (gains.lambda_ >= 8.0) is (gains.k_2 == 0.0)
    assert ('velocities' in why) is (gains.k_2 == 0.0)
    assert gains.k_2 > 0.0 or 'lowered' not in why


def tune_at(c):
    """Return what is proposed at the configured λ itself."""
    changes = {'controller.k_2': 2.0 * c.law.gains.k_d}
    return proposal_at(c, changes, c.law.gains.lambda_)


def test_a_slope_without_a_layer_is_not_the_end():
    """At 50 Hz and k_d = 5 no automatic ε is wide enough for the steeper slopes tried."""
    words = ('controller.law=extended', 'controller.projection=true', 'loop.rate=50',
             'controller.automatic_epsilon=true', 'controller.k_d=5')
    assert tuned('wang2004', *words).after.law.gains.lambda_ > 0.0
    steep = ('wang2004', 'loop.rate=50', 'controller.k_d=1', 'controller.lambda=40')
    with pytest.raises(ConfigurationError):
        proposal_at(load_configuration(*steep[:1], [*steep[1:]]), {
            'controller.k_d': 1.0, 'controller.phi_0': 0.85, 'controller.k_star': 2.5,
            'controller.epsilon': 0.0}, 40.0)
    assert tuned(*steep).after.law.gains.lambda_ < 40.0


def test_a_limit_the_user_knows_is_kept():
    assert tuned('robust', 'controller.v_max=25').after.law.gains.v_max == 25.0
    known = tuned('robust', 'controller.v_max=25', 'plant.command_limit=20')
    assert known.after.law.gains.v_max == 20.0


def test_more_delay_means_a_wider_layer_and_ends_the_chatter():
    found = tuned('wang2004', 'loop.delay=2')
    assert found.after.law.gains.epsilon > 0.02
    before, after = (found.rows[f'{name}, delay 2'] for name in ('before', 'after'))
    assert after['v_variation'] < 0.2 * before['v_variation']


def test_a_disturbance_that_the_effort_cannot_hold_is_named():
    with pytest.raises(ConfigurationError, match=r'--disturbance = 1000\.0: needs \|v\| = .* by '
                       r'the least b m = .*, --effort = 12'):
        tuned(effort=12.0, disturbance=1000.0)
    with pytest.raises(ConfigurationError, match=r'--effort = 3$'):     # the actuator's limit
        tuned('wang2004', 'plant.command_limit=3', effort=12.0, disturbance=1000.0)


def test_effort_is_kept():
    found = tuned(effort=12.0)
    assert abs(simulate(found.after).v).max() <= 12.0
    assert found.after.law.gains.lambda_ < 1.0
    with pytest.raises(ConfigurationError, match='least peak'):
        tuned(effort=0.01)


def test_projection_contains_the_true_parameters():
    found = tuned('robust', 'controller.b_bounds=[0.5, 2.0]')
    gains = found.after.law.gains
    for b, m in ((0.5, 0.85), (2.0, 1.25)):
        assert gains.phi_min < 1.0 / (b * m) < gains.phi_max
        assert gains.theta_min[0] < 1.0 / (b * m) < gains.theta_max[0]
    assert gains.rho_0 == pytest.approx(gains.k_star - 0.875 / 0.85)


def test_projection_lets_a_constant_force_have_either_sign_up_to_the_friction():
    gains = tune(load_configuration('axis', ['plant.constant_force=0.0'])).after.law.gains
    assert gains.theta_min[2] == -gains.theta_max[2] == -gains.theta_max[1]


def test_a_law_without_a_robust_gain_is_refused():
    with pytest.raises(ConfigurationError, match='has no k'):
        tune(Configuration.from_flat({'controller.law': 'pid'}))


def test_the_command_line_writes_what_it_proposes(tmp_path, capsys):
    out = tmp_path / 'tuned.yaml'
    words = ['tune', 'wang2004', '--duration', '6', '--set', 'loop.delay=1']
    assert main([*words, '--out', str(out)]) == 0
    text = capsys.readouterr().out
    assert 'controller.epsilon = 0.0' in text
    assert 'after, delay 1' in text
    assert main([*words, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    written = load_configuration(out).to_flat()
    assert all(written[key] == value for key, value in found['proposed'].items())
    assert main([*words, '--out', str(out)]) == 2
    assert main(['tune', 'wang2004', '--effort', '-1']) == 2
    assert capsys.readouterr().err.count('\n') == 2


def test_gains_with_an_observer_follow_their_own_rules():
    found = tuned('robust_eso', 'controller.b_bounds=[0.8, 1.6]')
    gains = found.after.law.gains
    gain = 0.375 * chatter_limit(1) / (1.6 * 1.25 * 0.005)
    assert gains.layer_gain == pytest.approx(gain)
    assert gains.lambda_ == pytest.approx(gain * 1.2 / 6.0)
    assert gains.observer_rate == pytest.approx(0.83 * gain * 1.2)
    assert gains.k_2 == pytest.approx(2.0 * gain / 3.0)
    assert gains.rho_0 == pytest.approx(0.3 * gains.k_star)
    assert all(item.level != ERROR for item in check(found.after))
    assert not found.rows['after, delay 1']['lost']


@pytest.mark.parametrize('delay', [0, 2, 3])
def test_a_device_has_a_sample_of_delay_to_spare(delay):
    """1.05 b_max m_max is calm a sample later than it runs; K0 is as large as that allows."""
    found = tuned('joint', f'loop.delay={delay}')
    gains, late = found.after.law.gains, max(delay, 1)
    largest = largest_beta(found.after.law.layer_model(), 0.005, late + 1)
    simulated = tuned('servo', f'loop.delay={delay}').after.law.gains
    assert gains.design_delay == simulated.design_delay == min(late, 2)
    assert largest >= 1.05 * 1.1 * 1.25
    if delay == 2:       # the rule of simulated plants has it anyway
        assert gains.layer_gain == pytest.approx(simulated.layer_gain)
    else:
        assert largest == pytest.approx(1.05 * 1.1 * 1.25, rel=0.02)
        assert gains.layer_gain < 0.95 * simulated.layer_gain
        assert f'calm at delay {late + 1} too' in found.reasons['controller.layer_gain']


@pytest.mark.parametrize(('limit', 'level'), [(float('inf'), None), (9.0, 'warning'),
                                              (7.0, 'error')])
def test_the_rule_on_lambda_is_asked_of_robust_eso(monkeypatch, limit, level):
    asked = []

    def answer(c, highest):
        asked.append((c.law.gains.lambda_, highest))
        return limit

    monkeypatch.setattr('dz_ros.studies.tune.lambda_limit', answer)
    found = tuned('joint')
    slope = found.after.law.gains.lambda_
    assert asked == [(slope, pytest.approx(1.25 * slope))]
    assert [item.level for item in found.findings if item.rule == 'λ'] == (
        [] if level is None else [level])


@pytest.mark.parametrize('name', ['joint', 'serial', 'cia402', 'cia402_axes'])
def test_device_configurations_have_the_gains_that_are_proposed_for_them(name):
    given = load_configuration(name, ['loop.duration=8'])
    one = given.axis(given.axis_names[0]) if given.axis_names else given
    found = tune(one)
    keys = [key for key in found.reasons if key.partition('.')[2] not in (
        'theta_0', 'phi_0', 'theta_min', 'theta_max', 'phi_min', 'phi_max')]
    assert len(keys) == 12
    before, after = one.to_flat(), found.after.to_flat()
    assert {key: before[key] for key in keys} == pytest.approx(
        {key: after[key] for key in keys}, rel=6e-3)
    words = [item.words for c in (one, found.after) for item in check(c) if item.level != INFO]
    assert words == []


def test_noise_asks_for_the_quiet_set_and_effort_for_a_slow_start():
    assert 'quiet' in tuned('robust_eso', 'plant.noise=[0.001, 0.01]').reasons[
        'controller.layer_gain']
    found = tuned('robust_eso', effort=6.0)
    assert found.after.law.gains.start_rate < found.after.law.gains.lambda_ / 5.0
    with pytest.raises(ConfigurationError, match='no start keeps within it'):
        tuned('robust_eso', effort=0.5)


@pytest.mark.parametrize('law', ['wang2004', 'robust', 'robust_eso'])
def test_k_star_covers_a_command_in_steps_and_the_limit_cycle_is_stated(law):
    step = 0.4
    settings = ('controller.override_checks=true', f'controller.law={law}', 'loop.duration=6.0')
    smooth, rough = (tuned('robust_eso', *settings, f'plant.command_resolution={q}')
                     for q in (0.0, step))
    m_min, m_max = smooth.after.controller_settings.m_bounds
    more = rough.after.law.gains.k_star - smooth.after.law.gains.k_star
    share = 0.5 * step * m_max / m_min
    assert more == pytest.approx(share / 0.7 if law == 'robust_eso' else share)
    assert f'of which {share:.4g} for v in steps' in rough.reasons['controller.k_star']
    assert 'steps' not in smooth.reasons['controller.k_star']
    stated = {item.rule: item for item in rough.findings}['command steps']
    assert stated.numbers['s'] == limit_cycle_bound(rough.after, step, 2)[-1]
    assert 'command steps' not in {item.rule for item in smooth.findings}
    # what the steps add in simulation stays within it
    assert rough.rows['after, delay 0']['error_max'] <= (
        smooth.rows['after, delay 0']['error_max'] + stated.numbers['x0'])


def test_an_encoder_sets_the_gain():
    fine, coarse = (tuned('robust_eso', 'driver.measured=1', f'plant.resolution={q}', effort=60.0)
                    for q in (1e-5, 1e-3))
    assert coarse.after.law.gains.layer_gain < 0.6 * fine.after.law.gains.layer_gain
    assert 'by rule' in coarse.reasons['driver.observer']
    assert not coarse.rows['after, delay 0']['lost']


def test_a_law_of_all_axes_is_refused_in_one_line():
    c = load_configuration('two_link_arm')
    with pytest.raises(ConfigurationError, match='is a law of all axes') as caught:
        tune(c.axis('elbow'))
    assert '\n' not in str(caught.value)
