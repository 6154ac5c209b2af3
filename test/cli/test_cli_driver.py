# SPDX-License-Identifier: Apache-2.0
"""dz driver list: what is installed, and what keeps one from loading or opening."""

from dataclasses import dataclass
import json
import sys
from types import SimpleNamespace

import pytest

from dz_ros.cli.driver.check import line
from dz_ros.cli.driver.list import describe
from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.driven import DRIVERS
from dz_ros.drivers.conformance.result import Result
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import UnknownNameError
from dz_ros.nodes.joint_driver import Joint


def test_every_driver_is_listed_with_what_it_is(capsys):
    assert main(['driver', 'list']) == 0
    text = capsys.readouterr().out
    for name in DRIVERS.builtin:
        assert name in text
    assert "any order, units the plant's, simulated; dz_ros.drivers.mock:Mock" in text
    assert 'driver.script driver.measures driver.limit' in text
    assert 'step of the command: its own, or driver.command_resolution' in text
    assert 'step of the position: driver.resolution' in text


def test_as_json_it_is_all_there(capsys):
    assert main(['driver', 'list', '--json']) == 0
    rows = {row['name']: row for row in json.loads(capsys.readouterr().out)}
    assert rows['simulated']['simulated'] is True
    assert rows['mock']['parameters'][0] == 'driver.script'
    assert all(row['error'] or row['summary'] for row in rows.values())


def test_one_that_cannot_load_reports_why():
    row = describe('x', UnknownNameError('driver.name', 'x', 'cannot be loaded: no such file'))
    assert row['error'] == "driver.name = 'x': cannot be loaded: no such file"


def only(monkeypatch, **classes):
    """Have these drivers installed and no others."""
    monkeypatch.setitem(sys.modules, 'some_drivers', SimpleNamespace(**classes))
    monkeypatch.setattr('dz_ros.cli.driver.list.DRIVERS', type(DRIVERS)(
        DRIVERS.kind, DRIVERS.key, 'none', DRIVERS.base,
        {name: f'some_drivers:{name}' for name in classes}))


@dataclass
class Thawed:
    pass


@pytest.mark.parametrize('parameters', [None, 7, SimpleNamespace, Thawed])
def test_one_whose_parameters_are_none_ends_no_list(monkeypatch, capsys, parameters):
    class Bad(SimulatedActuator):
        name, Parameters = 'bad', parameters

    only(monkeypatch, bad=Bad, good=SimulatedActuator)
    assert main(['driver', 'list']) == 0
    text = capsys.readouterr().out
    assert 'Parameters must be a frozen dataclass of dz_ros.core.schema.parameter fields' in text
    assert SimulatedActuator.summary in text
    with pytest.raises(UnknownNameError, match='Parameters must be a frozen dataclass') as caught:
        Configuration.from_flat({'driver.name': 'some_drivers:bad'})
    assert '\n' not in str(caught.value)


def test_one_that_cannot_be_read_ends_no_list(monkeypatch, capsys):
    class Bad(SimulatedActuator):
        name, requires = 'bad', None

    only(monkeypatch, bad=Bad, good=SimulatedActuator)
    assert main(['driver', 'list']) == 0
    text = capsys.readouterr().out
    assert 'cannot be read: TypeError' in text
    assert SimulatedActuator.summary in text


def test_the_bridge_to_ros2_control_names_what_it_needs(monkeypatch, capsys):
    monkeypatch.setattr('dz_ros.cli.driver.list.is_there', lambda module: 'msgs' not in module)
    assert main(['driver', 'list']) == 0
    text = capsys.readouterr().out
    assert 'cannot be opened here: sensor_msgs, std_msgs is not installed' in text
    assert describe('joint', DRIVERS.load('joint'))['missing'] == ['sensor_msgs', 'std_msgs']
    assert Joint.requires[0] == 'rclpy'


def test_a_library_that_is_missing_is_named(monkeypatch, capsys):
    class Needs(SimulatedActuator):
        name, requires = 'needs', ('math', 'no_such_library', 'no_such.library')
        command_unit = 'A'

    assert describe('needs', Needs)['missing'] == ['no_such_library', 'no_such.library']
    assert describe('needs', Needs)['units'] == 'of its own'
    only(monkeypatch, needs=Needs)
    assert main(['driver', 'list']) == 0
    assert 'cannot be opened here: no_such_library, no_such.library is not installed' in (
        capsys.readouterr().out)


@pytest.mark.parametrize(('passed', 'mark'), [(True, 'ok'), (False, 'FAILED'), (None, 'unseen')])
def test_a_result_is_a_line_with_figure_and_limit(passed, mark):
    text = line(Result('rate', passed, '199 Hz', '200 Hz', '' if passed else 'slow'))
    assert text.split()[:2] == [mark, 'rate']
    assert '199 Hz; must be: 200 Hz' in text
    assert ('(slow)' in text) is (not passed)
