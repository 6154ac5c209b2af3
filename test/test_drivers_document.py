"""docs/drivers.md as a new user follows it: its file, its commands, its example."""

from __future__ import annotations

import ast
import os
from pathlib import Path
import re
import runpy
import shlex
import sys
import types

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.mock import FAULTS, WHEN

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / 'docs' / 'drivers.md').read_text(encoding='utf-8')
EXAMPLE = ROOT / 'examples' / 'dz_ros_driver'


def blocks(language):
    return re.findall(rf'^```{language}\n(.*?)^```', TEXT, re.M | re.S)


@pytest.fixture
def valve(tmp_path, monkeypatch):
    """The document's file in a folder of its own, which is on the path."""
    (tmp_path / 'my_valve.py').write_text(blocks('python')[0], encoding='utf-8')
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop('my_valve', None)


def test_the_file_of_the_document_is_a_driver(valve):
    configuration = Configuration.from_flat({
        'plant.model': 'first_order', 'driver.name': 'my_valve:Valve', 'driver.leak': 0.5})
    driver = configuration.make_driver()
    driver.open()
    driver.command(10.0, 0.0)
    driver.advance(0.005, 0)
    assert driver.measure() == (pytest.approx(0.05 * 10.0 * 0.005),)
    assert driver.parameters.leak == 0.5


def test_the_faults_of_the_mock_are_the_document_s():
    part = TEXT[TEXT.index('The mock'):TEXT.index('## The conformance kit')]
    for name in (*FAULTS, *WHEN):
        assert f'`{name}' in part, name


@pytest.mark.ros
@pytest.mark.usefixtures('ros_domain')
def test_its_commands_work_one_after_the_other(valve, processes):
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    path = os.pathsep.join([str(ROOT), str(valve)])
    commands = [line for block in blocks('(?:sh|console)') for line in block.splitlines()]
    assert len(commands) == 6
    for command in commands:
        words = shlex.split(command)
        assert words[0] == 'dz'
        done = processes('-m', 'dz_ros', *words[1:], cwd=valve, PYTHONPATH=path)
        code = done.wait(300.0)
        if words[1:3] == ['driver', 'check']:   # a busy machine may be late, that is no fault here
            assert code in (0, 1), done.output
            assert 'killed and started again' in done.output
            for name in ('declaration', 'opens', 'safe command', 'stop and reset', 'restart'):
                assert re.search(rf'^ok +{name} ', done.output, re.M), done.output
        else:
            assert code == 0, done.output
    assert (valve / 'runs' / 'valve').is_dir()


def test_the_node_of_the_example_is_short_and_imports_nothing_of_ours():
    source = (EXAMPLE / 'dz_ros_driver' / 'driver_node.py').read_text(encoding='utf-8')
    assert not re.search(r'^(from|import) dz_ros\b', source, re.M)
    tree, left_out = ast.parse(source), set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(
                node):
            node = node.body[0]
        elif not isinstance(node, (ast.Import, ast.ImportFrom)):
            continue
        left_out |= set(range(node.lineno, node.end_lineno + 1))
    code = [line for number, line in enumerate(source.splitlines(), 1)
            if line.strip() and number not in left_out]
    assert len(code) <= 60


def test_the_entry_point_of_the_example_leads_to_its_class(monkeypatch):
    told = {}
    monkeypatch.setitem(sys.modules, 'setuptools',
                        types.SimpleNamespace(setup=lambda **keys: told.update(keys)))
    runpy.run_path(str(EXAMPLE / 'setup.py'))
    for _, names in told['data_files']:
        assert all((EXAMPLE / name).is_file() for name in names)
    monkeypatch.syspath_prepend(EXAMPLE)
    (point,) = told['entry_points']['dz_ros.drivers']
    name, _, target = point.partition(' = ')
    driver = Configuration.from_flat({'plant.model': 'first_order',
                                      'driver.name': target}).make_driver()
    assert driver.name == name
    driver.open()
    try:
        driver.command(20.0, 0.0)
    finally:
        driver.close()
    assert driver.in_force() == 20.0
    for module in [item for item in sys.modules if item.startswith('dz_ros_driver')]:
        del sys.modules[module]
