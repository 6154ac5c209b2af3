"""The controller refuses what the design rules call an error, unless told otherwise."""

import pytest

pytest.importorskip('rclpy', reason='needs rclpy')

from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError
from dz_ros.files import load_configuration, shipped_configurations
from dz_ros.nodes.start_checks import log, refuse_bad_design


class Listener:
    """Stands for a node: keeps what is logged."""

    def __init__(self):
        self.lines = []
        self.told = []

    def get_logger(self):
        return self

    def warning(self, text):
        self.lines.append(text)

    def info(self, text):
        self.told.append(text)


def start(**values):
    node = Listener()
    log(node, refuse_bad_design(Configuration.from_flat(values)))
    return node.lines


def test_a_sound_design_has_nothing_to_warn_of():
    assert start() == []


def test_what_the_design_promises_is_told_in_a_line_a_finding():
    node = Listener()
    log(node, refuse_bad_design(Configuration.from_flat({'plant.noise': [1e-3, 1e-2]})))
    assert len(node.told) == len(set(node.told)) <= 9
    assert not any('\n' in line for line in node.told)
    for part in ('assumptions: holds: (A1), (A2), (A3), (A4), input gain, reference; stated: '
                 'state, structure', 'Ω: where', '|x̃2| <= 0.04 1/s', 'chatter: delay 1',
                 'ε 0.0168',
                 'λ: λ = 1; from this initial state the sampled loop finds its reference',
                 'not covered: the theorem', 'measurement noise'):
        assert sum(part in line for line in node.told) == 1, part


def test_an_assumption_that_is_not_met_has_its_own_line():
    node = Listener()
    log(node, refuse_bad_design(Configuration.from_flat({'plant.dead_zone.b_r': 0.7})))
    assert '(A4)' not in node.told[0]
    assert [line for line in node.lines if 'design rule (A4): violated' in line] == node.lines
    device = Listener()
    log(device, refuse_bad_design(load_configuration('serial')))
    assert 'stated: (A2), (A3), (A4), state, structure, input gain' in device.told[0]


def test_a_slope_with_which_the_loop_is_lost_refuses():
    node = Listener()
    steep = Configuration.from_flat({'controller.lambda': 9.0})
    with pytest.raises(ConfigurationError, match=r'λ = 9; from this .* loop is lost; lower'):
        log(node, refuse_bad_design(steep))
    assert node.told == node.lines == []        # the refusal is all there is to read
    line, = start(**{'controller.lambda': 9.0, 'controller.override_checks': True})
    assert 'λ (overridden error)' in line


def test_gains_set_while_the_loop_runs_wait_for_no_simulation(monkeypatch):
    monkeypatch.setattr('dz_ros.nodes.start_checks.lost_from_start', lambda _: pytest.fail('ran'))
    node = Listener()
    steep = Configuration.from_flat({'controller.lambda': 9.0})
    log(node, refuse_bad_design(steep, starting=False))
    assert node.told == node.lines == []
    with pytest.raises(ConfigurationError, match='does not cover'):
        log(node, refuse_bad_design(Configuration.from_flat({'controller.k_star': 1.0}), False))


@pytest.mark.parametrize('name', shipped_configurations())
def test_shipped_configurations_start(name):
    refuse_bad_design(load_configuration(name))


def test_a_warning_is_logged_with_what_to_change():
    line, = start(**{'controller.k_star': 1.5})
    assert line.startswith('design rule (18): k* = 1.5 covers the dead-zone')
    assert 'raise k*' in line


def test_an_error_refuses_and_says_how_to_override():
    with pytest.raises(ConfigurationError, match=r'k\* = 1 does not cover.*override_checks: true'):
        start(**{'controller.k_star': 1.0})


def test_an_override_starts_and_is_part_of_the_configuration():
    values = {'controller.k_star': 1.0, 'controller.override_checks': True}
    line, = start(**values)
    assert '(overridden error)' in line
    assert Configuration.from_flat(values).to_flat()['controller.override_checks'] is True
