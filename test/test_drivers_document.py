# SPDX-License-Identifier: Apache-2.0
"""docs/drivers.md as a new user follows it: its file, its commands, its example."""

from __future__ import annotations

import ast
import os
from pathlib import Path
import re
import runpy
import sys
import types
import venv

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.drivers.mock import FAULTS, REFUSALS

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
    for name in (*FAULTS, *REFUSALS):
        assert f'`{name}' in part, name


@pytest.fixture
def installed(tmp_path):
    """Return a folder of programs with `dz`, as pip would write it, in an environment of its own.

    Only its site-packages knows where dz_ros is, and what else this Python has.
    """
    home = tmp_path / 'environment'
    venv.create(home, with_pip=False)
    (site,) = home.glob('lib/python*/site-packages')
    (site / 'here.pth').write_text('\n'.join([str(ROOT), *filter(None, sys.path)]),
                                   encoding='utf-8')
    (home / 'bin' / 'script').write_text(
        'import sys\nfrom dz_ros.cli.main import main\nsys.exit(main())\n', encoding='utf-8')
    program = home / 'bin' / 'dz'
    program.write_text(f'#!/bin/sh\nexec "{home}/bin/python" "{home}/bin/script" "$@"\n',
                       encoding='utf-8')
    program.chmod(0o755)
    return home / 'bin'


@pytest.fixture
def folder(tmp_path):
    """Return a folder with the document's file and nothing else."""
    made = tmp_path / 'of the user'
    made.mkdir()
    (made / 'my_valve.py').write_text(blocks('python')[0], encoding='utf-8')
    return made


@pytest.mark.ros
@pytest.mark.usefixtures('ros_domain')
def test_its_commands_work_one_after_the_other_as_typed_in_that_folder(folder, installed,
                                                                       processes):
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    commands = [line for block in blocks('(?:sh|console)') for line in block.splitlines()]
    assert [command.split()[0] for command in commands] == ['dz'] * 2 + ['export'] + ['dz'] * 4
    script = '\n'.join(f'{command}\necho "exit $?"' for command in commands)
    done = processes('sh', '-c', script, cwd=folder, PYTHONPATH=None,
                     PATH=f'{installed}{os.pathsep}{os.environ["PATH"]}')
    done.wait(900.0)
    codes = [int(code) for code in re.findall(r'^exit (\d+)$', done.output, re.M)]
    checked = next(i for i, command in enumerate(commands) if 'driver check' in command)
    assert codes[checked] in (0, 1), done.output    # a busy machine may be late, no fault here
    assert not any(codes[:checked] + codes[checked + 1:]), done.output
    assert 'killed and started again' in done.output
    for name in ('declaration', 'opens', 'safe command', 'stop and reset', 'restart'):
        assert re.search(rf'^ok +{name} ', done.output, re.M), done.output
    assert (folder / 'runs' / 'valve').is_dir()


def test_without_the_path_it_prints_what_to_do(folder, installed, processes):
    done = processes(installed / 'dz', 'driver', 'check', 'my_valve:Valve', '--yes', cwd=folder,
                     PYTHONPATH=None)
    assert done.wait(60.0) == 2
    assert done.output.endswith("No module named 'my_valve'; the folder that holds it must be on "
                                'PYTHONPATH')
    assert '\n' not in done.output


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
            if line.strip() and not line.startswith('#') and number not in left_out]
    assert len(code) <= 66


def test_the_entry_point_of_the_example_leads_to_its_class(monkeypatch):
    given = {}
    monkeypatch.setitem(sys.modules, 'setuptools',
                        types.SimpleNamespace(setup=lambda **keys: given.update(keys)))
    runpy.run_path(str(EXAMPLE / 'setup.py'))
    for _, names in given['data_files']:
        assert all((EXAMPLE / name).is_file() for name in names)
    monkeypatch.syspath_prepend(EXAMPLE)
    (point,) = given['entry_points']['dz_ros.drivers']
    name, _, target = point.partition(' = ')
    driver = Configuration.from_flat({'plant.model': 'first_order',
                                      'driver.name': target}).make_driver()
    assert driver.name == name
    driver.open()
    try:
        driver.command(20.0, 0.0)
    finally:
        driver.close()
    assert driver.applied_command() == 20.0
    for module in [item for item in sys.modules if item.startswith('dz_ros_driver')]:
        del sys.modules[module]
