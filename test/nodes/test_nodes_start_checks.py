# SPDX-License-Identifier: Apache-2.0
"""The controller refuses what the design rules call an error, unless overridden."""

import pytest

pytest.importorskip('rclpy', reason='needs rclpy')

from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.dataset import from_run  # noqa: E402
from dz_ros.core.design.rules import check  # noqa: E402
from dz_ros.core.loop.offline import simulate  # noqa: E402
from dz_ros.errors import ConfigurationError  # noqa: E402
from dz_ros.files.configurations import load_configuration, shipped_configurations  # noqa: E402
from dz_ros.nodes.parts.start_checks import DesignLog, log, refuse_bad_design  # noqa: E402
from dz_ros.report.guarantee import guarantee  # noqa: E402
from dz_ros.report.view import View  # noqa: E402


class Subscriber:
    """Stands for a node: keeps what is logged."""

    def __init__(self):
        self.lines = []
        self.logged = []

    def get_logger(self):
        return self

    def warning(self, text):
        self.lines.append(text)

    def info(self, text):
        self.logged.append(text)


def start(**values):
    node = Subscriber()
    log(node, refuse_bad_design(Configuration.from_flat(values)))
    return node.lines


def test_a_sound_design_has_nothing_to_warn_of():
    assert start() == []


def test_the_start_has_one_line_on_a_sound_design():
    node = Subscriber()
    log(node, refuse_bad_design(Configuration.from_flat({'plant.noise': [1e-3, 1e-2]})))
    assert node.logged == [
        'design rules, assumptions: holds: (A1), (A2), (A3), (A4), input gain, reference; stated: '
        'state, structure; k* = 2.5 covers the dead-zone (rho/m_min = 1.029) and a disturbance of '
        'up to 1.25 1/s²; details: dz check']


def test_an_assumption_that_is_not_met_has_its_own_line():
    node = Subscriber()
    log(node, refuse_bad_design(Configuration.from_flat({'plant.dead_zone.b_r': 0.7})))
    assert '(A4)' not in node.logged[0]
    assert [line for line in node.lines if 'design rule (A4): violated' in line] == node.lines
    device = Subscriber()
    log(device, refuse_bad_design(load_configuration('serial')))
    assert 'stated: (A2), (A3), (A4), state, structure, input gain' in device.logged[0]


def test_a_slope_with_which_the_loop_is_lost_refuses():
    node = Subscriber()
    steep = Configuration.from_flat({'controller.lambda': 9.0})
    with pytest.raises(ConfigurationError, match=r'λ = 9; from this .* loop is lost; lower'):
        log(node, refuse_bad_design(steep))
    assert node.logged == node.lines == []        # the refusal is all there is to read
    line, = start(**{'controller.lambda': 9.0, 'controller.override_checks': True})
    assert 'λ (overridden error)' in line


def test_gains_set_while_the_loop_runs_wait_for_no_simulation(monkeypatch):
    monkeypatch.setattr('dz_ros.nodes.parts.start_checks.lost_from_start',
                        lambda _: pytest.fail('ran'))
    node = Subscriber()
    steep = Configuration.from_flat({'controller.lambda': 9.0})
    log(node, refuse_bad_design(steep, starting=False))
    assert node.logged == node.lines == []
    with pytest.raises(ConfigurationError, match='does not cover'):
        log(node, refuse_bad_design(Configuration.from_flat({'controller.k_star': 1.0}), False))


@pytest.mark.parametrize('name', shipped_configurations())
def test_shipped_configurations_start(name):
    refuse_bad_design(load_configuration(name))


@pytest.mark.parametrize('name', [*shipped_configurations(), *(
    {'controller.law': law} for law in ('adaptive', 'exact_inverse', 'extended', 'pid', 'robust')),
    {'controller.k_star': 1.5}])
def test_check_start_and_report_agree_on_what_k_star_covers(name):
    whole = (load_configuration(name) if isinstance(name, str) else Configuration.from_flat(name))
    for axis, c in whole.axes or (('', whole),):
        found = [item for item in check(c) if item.rule == '(18)']
        of_axis = [text for _, text in refuse_bad_design(c)]
        run = from_run(simulate(c.replace(**{'loop.duration': 0.2})))
        covered = guarantee(View.of(run)).covered
        if c.law.design is None:
            assert not found
            assert not covered
            continue
        words = found[0].words.partition('; along the reference')[0]
        assert len(found) == 1
        assert covered.partition('; this run had')[0].rstrip('.') == words, axis
        assert sum(words in text for text in of_axis) == 1, of_axis
        gain, known = found[0].numbers, c.controller_settings
        room = (gain['k'] - gain['least']) * known.b_bounds[0] * known.m_bounds[0]
        if gain['k'] > 0.0:
            assert f'a disturbance of up to {room:.4g}' in words


def test_a_warning_is_logged_with_what_to_change():
    line, = start(**{'controller.k_star': 1.5})
    assert line.startswith('design rule (18): k* = 1.5 covers the dead-zone')
    assert 'raise k*' in line


def test_an_error_refuses_and_reports_how_to_override():
    with pytest.raises(ConfigurationError, match=r'k\* = 1 does not cover.*override_checks: true'):
        start(**{'controller.k_star': 1.0})


def test_an_override_starts_and_is_part_of_the_configuration():
    values = {'controller.k_star': 1.0, 'controller.override_checks': True}
    line, = start(**values)
    assert '(overridden error)' in line
    assert Configuration.from_flat(values).to_flat()['controller.override_checks'] is True


def test_a_warning_is_reported_once_however_often_parameters_are_set():
    node = Subscriber()
    c = Configuration.from_flat({'controller.k_star': 1.5, 'plant.a3': 1.0})
    design = DesignLog(node)
    design.judge(c)
    design.log()
    warned = list(node.lines)
    assert any('(18)' in line for line in warned)
    for _ in range(3):
        for key, value in (('controller.lambda', 1.1), ('controller.gamma', 0.6)):
            c = c.replace(**{key: value})
            design.judge(c, starting=False)
            design.log()
    assert node.lines == warned
    logged = len(node.logged)
    design.judge(c.replace(**{'controller.k_star': 1.6}), starting=False)
    design.log()        # other numbers of the same warning
    assert node.lines == warned
    assert '1.6' in ''.join(node.logged[logged:])
    for k_star in (2.6, 1.5):       # cured, then back
        design.judge(c.replace(**{'controller.k_star': k_star}), starting=False)
        design.log()
    assert len(node.lines) == len(warned) + 1


def test_a_warning_of_what_is_not_used_is_not_reported():
    node = Subscriber()
    design = DesignLog(node)
    with pytest.raises(ConfigurationError):
        design.judge(Configuration.from_flat({'controller.k_star': 0.1}), starting=False)
    design.log()
    assert node.lines == node.logged == []


def test_the_recommended_configuration_starts_without_a_warning():
    node = Subscriber()
    log(node, refuse_bad_design(load_configuration('robust')))
    assert node.lines == []
    assert len(node.logged) == 1
