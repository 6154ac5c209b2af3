# SPDX-License-Identifier: Apache-2.0
"""`dz list`: one line for each thing a configuration can choose."""

import importlib.metadata

import pytest

from dz_ros.cli.main import main
from dz_ros.core import registry
from dz_ros.core.laws import LAWS
from dz_ros.core.plants import PLANTS
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.files.configurations import shipped_configurations


@pytest.mark.parametrize(('kind', 'things'), [('plants', PLANTS), ('laws', LAWS),
                                              ('trajectories', TRAJECTORIES)])
def test_one_line_a_thing(kind, things, capsys):
    assert main(['list', kind]) == 0
    lines = capsys.readouterr().out.splitlines()
    found = {line.split()[0]: line.split(maxsplit=1)[1] for line in lines}
    for name, cls in things.builtin.items():
        assert found[name] == cls.summary
    assert len(lines) == len(things.all())


def test_part_of_a_name_shortens_the_list(capsys):
    assert main(['list', 'keys', 'lambda']) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        'controller.lambda']
    assert main(['list', 'laws', 'robst']) == 2
    assert 'no name in laws has it; did you mean robust?' in capsys.readouterr().err


def test_configurations_report_what_they_are(capsys):
    assert main(['list', 'configurations']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(shipped_configurations())
    for line in lines:
        assert len(line.split(maxsplit=1)) == 2, line


def test_what_another_package_brings_is_listed_even_if_it_is_broken(monkeypatch, capsys):
    points = [importlib.metadata.EntryPoint('good', 'dz_ros.core.laws.pd:Pd', 'dz_ros.laws'),
              importlib.metadata.EntryPoint('broken', 'no.such.module:Law', 'dz_ros.laws')]
    monkeypatch.setattr(registry, 'entry_points', lambda group: [
        point for point in points if point.group == group])
    assert main(['list', 'laws']) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert 'PD baseline' in lines['good']
    assert '(not usable)' in lines['broken']
    assert 'no.such.module' in lines['broken'] or "'no'" in lines['broken']
