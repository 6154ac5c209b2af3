"""The controller refuses what the design rules call an error, unless told otherwise."""

import pytest

pytest.importorskip('rclpy', reason='needs rclpy')

from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError
from dz_ros.nodes.start_checks import refuse_bad_design


class Listener:
    """Stands for a node: keeps what is logged."""

    def __init__(self):
        self.lines = []

    def get_logger(self):
        return self

    def warning(self, text):
        self.lines.append(text)


def start(**values):
    node = Listener()
    refuse_bad_design(node, Configuration.from_flat(values))
    return node.lines


def test_a_sound_design_is_silent():
    assert start() == []


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
