# SPDX-License-Identifier: Apache-2.0
"""The package as pip, colcon and rosdep see it; what the documents have users type.

Over 300 lines: every file beside the package that a user or an installer meets first.
"""

import ast
import importlib
from importlib import metadata
import os
from pathlib import Path
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ET

import pytest
import yaml

import dz_ros
from dz_ros import version as version_module
from dz_ros.cli import main as cli
from dz_ros.core import schema
from dz_ros.core.configuration import Configuration
from dz_ros.files.configurations import flat_parameters
from dz_ros.nodes.main import NODES

ROOT = Path(dz_ros.__file__).parents[1]
CONFIGURATIONS = sorted((ROOT / 'config').glob('*.yaml'))
DOCUMENTS = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]

IMPORTED = {
    'builtin_interfaces': ('ros-jazzy-rclpy', 'builtin_interfaces'),
    'diagnostic_msgs': ('ros-jazzy-common-interfaces', 'diagnostic_msgs'),
    'lifecycle_msgs': ('ros-jazzy-rclpy', 'lifecycle_msgs'),
    'lz4': ('lz4', 'mcap-ros2-support'),
    'matplotlib': ('matplotlib', 'python3-matplotlib'),
    'mcap': ('mcap', 'mcap-ros2-support'),
    'numpy': ('numpy', 'python3-numpy'),
    'rcl_interfaces': ('ros-jazzy-rclpy', 'rcl_interfaces'),
    'rclpy': ('ros-jazzy-rclpy', 'rclpy'),
    'rosgraph_msgs': ('ros-jazzy-rclpy', 'rosgraph_msgs'),
    'scipy': ('scipy', 'python3-scipy'),
    'sensor_msgs': ('ros-jazzy-common-interfaces', 'sensor_msgs'),
    'std_msgs': ('ros-jazzy-common-interfaces', 'std_msgs'),
    'std_srvs': ('ros-jazzy-common-interfaces', 'std_srvs'),
    'yaml': ('pyyaml', 'python3-yaml'),
    'zstandard': ('zstandard', 'mcap-ros2-support'),
}
"""Module → distribution that brings it by pip, key that brings it by rosdep."""
OPTIONAL = {'argcomplete': 'completion', 'control': 'control', 'pandas': 'pandas',
            'numba': 'numba', 'dask': 'cluster', 'distributed': 'cluster', 'pyarrow': 'parquet',
            'can': 'cia402', 'canopen': 'cia402', 'serial': 'serial', 'aiohttp': 'live',
            'foxglove': 'foxglove', 'flint': 'certify'}
"""Module → extra that brings it; nothing needs them."""

pytestmark = pytest.mark.skipif(not (ROOT / 'package.xml').is_file(),
                                reason='needs the source tree')


@pytest.fixture(scope='module')
def manifest():
    return ET.parse(ROOT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def described():
    """Return what setup.py reports, without setuptools doing anything."""
    reported = {}
    stub = types.ModuleType('setuptools')
    stub.setup = lambda **settings: reported.update(settings)
    stub.find_packages = lambda include: include
    patch = pytest.MonkeyPatch()
    with patch.context() as context:
        context.setitem(sys.modules, 'setuptools', stub)
        context.chdir(ROOT)
        runpy.run_path(str(ROOT / 'setup.py'))
    return reported


def test_version_and_description_have_one_source(manifest, described):
    number = manifest.findtext('version')
    assert re.fullmatch(r'\d+\.\d+\.\d+', number)
    assert version_module.version() == number
    assert described['version'] == number
    assert described['description'] == manifest.findtext('description')
    assert described['license'] == manifest.findtext('license') == 'Apache-2.0'
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert citation['version'] == number
    assert citation['license'] == 'Apache-2.0'
    assert citation['abstract'] == manifest.findtext('description')
    assert 'Apache License' in (ROOT / 'LICENSE').read_text(encoding='utf-8')
    for path in (ROOT / 'setup.py', ROOT / 'setup.cfg', ROOT / 'pyproject.toml'):
        assert f"'{number}'" not in path.read_text(encoding='utf-8')


def test_version_of_an_installed_copy(monkeypatch, tmp_path):
    monkeypatch.setattr(version_module, '__file__', str(tmp_path / 'dz_ros' / 'version.py'))
    monkeypatch.setattr('importlib.metadata.version', lambda name: {'dz_ros': '9.8.7'}[name])
    assert version_module.version() == '9.8.7'
    (tmp_path / 'package.xml').write_text('<package><name>other</name><version>1</version>'
                                          '</package>')
    assert version_module.version() == '9.8.7'


def test_version_of_a_copy_not_installed(monkeypatch, tmp_path):
    monkeypatch.setattr(version_module, '__file__', str(tmp_path / 'dz_ros' / 'version.py'))
    monkeypatch.setattr(version_module, 'NAME', 'dz_ros_not_installed')
    assert version_module.version() == 'unknown'


def test_manifest_is_one_that_ros_recognises(manifest):
    assert manifest.get('format') == '3'
    assert manifest.findtext('name') == 'dz_ros'
    assert manifest.findtext('export/build_type') == 'ament_python'
    email = manifest.find('maintainer').get('email')
    # catkin_pkg's own rule; a manifest that breaks it degrades to a plain Python package
    assert re.match(r'^[-a-zA-Z0-9_%+]+(\.[-a-zA-Z0-9_%+]+)*'
                    r'@[-a-zA-Z0-9%]+(\.[-a-zA-Z0-9%]+)*\.[a-zA-Z]{2,}$', email)
    assert (ROOT / 'resource' / 'dz_ros').is_file()
    order = [item.tag for item in manifest]
    assert order[:6] == ['name', 'version', 'description', 'maintainer', 'license', 'author']


@pytest.mark.slow
def test_what_the_code_imports_is_declared_for_pip_and_for_rosdep(manifest, described):
    used = set()
    for path in (ROOT / 'dz_ros').rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                used |= {item.name.split('.')[0] for item in node.names}
            elif isinstance(node, ast.ImportFrom):
                used.add(node.module.split('.')[0])
    used -= set(sys.stdlib_module_names) | {'dz_ros'}
    for module in set(OPTIONAL) & used:
        assert OPTIONAL[module] in described['extras_require']
    used -= set(OPTIONAL)
    assert used <= set(IMPORTED)
    keys = {item.text for item in manifest.findall('exec_depend')}
    by_pip = {re.split(r'[\[<>=]', text)[0]
              for text in described['install_requires'] + described['extras_require']['ros']}
    for module in used:
        distribution, key = IMPORTED[module]
        assert distribution in by_pip, module
        assert key in keys, module
    launch_files = ' '.join(path.read_text(encoding='utf-8')
                            for path in (ROOT / 'launch').glob('*.py'))
    for module in ('launch', 'launch_ros', 'ament_index_python'):
        if f'{module}.' in launch_files or f'from {module} ' in launch_files:
            assert module in keys


def test_wheels_of_ros_name_their_distribution_which_pins_them(described):
    wanted = [re.split(r'[\[<>=]', text)[0] for text in described['extras_require']['ros']]
    assert all(name.startswith('ros-jazzy-') for name in wanted)
    for name in wanted:
        try:
            needs = metadata.requires(name) or []
        except metadata.PackageNotFoundError:   # an installed ROS, or wheels by older names
            continue
        plain = name.replace('-jazzy', '')
        assert f'{plain}=={metadata.version(plain)}' in needs


def test_entry_points_lead_to_functions(described):
    scripts = dict(text.split(' = ') for text in described['entry_points']['console_scripts'])
    assert {'dz_ros', 'plant_node', 'controller_node', 'trajectory_node',
            'recorder_node'} <= set(scripts) <= {'dz_ros', *NODES}
    assert described['scripts'] == ['scripts/dz']       # it starts dz_ros
    for target in scripts.values():
        module, _, function = target.partition(':')
        assert callable(getattr(importlib.import_module(module), function))


def test_everything_that_belongs_to_an_installation_is_in_it(described):
    installed = {name for _, names in described['data_files'] for name in names}
    assert 'package.xml' in installed
    assert 'resource/dz_ros' in installed
    for folder in ('config', 'launch'):
        for path in (ROOT / folder).iterdir():
            if path.is_file():
                assert f'{folder}/{path.name}' in installed
    for path in (ROOT / 'dz_ros').rglob('*.py'):
        assert (path.parent / '__init__.py').is_file(), f'{path.parent} would not be installed'
    assert described['packages'] == ['dz_ros', 'dz_ros.*']


def test_no_dependency_is_named_twice(manifest):
    named = [item.text for item in manifest if item.tag.endswith('_depend')]
    assert len(named) == len(set(named))


@pytest.mark.parametrize('path', CONFIGURATIONS, ids=lambda path: path.stem)
def test_every_configuration_is_accepted_as_it_is_by_dz_and_by_ros(path):
    flat = flat_parameters(path)
    configuration = Configuration.from_flat(flat)
    assert configuration.set_aside == ()
    shared = {key: value for key, value in flat.items() if not key.startswith('axes.')}
    for name in configuration.axis_names:
        prefix = f'axes.{name}.'
        own = {key.removeprefix(prefix): value for key, value in flat.items()
               if key.startswith(prefix)}
        axis = configuration.axis(name)
        check_accepted(axis, {key: value for key, value in {**shared, **own}.items()
                              if key not in ('loop.axes', 'loop.seed', *axis.set_aside)})
    if not configuration.axis_names:
        check_accepted(configuration, shared)
    assert path.read_text(encoding='utf-8').startswith('# ')


def check_accepted(configuration, flat):
    """Check that a configuration has the values of its file, of the types that rcl reads."""
    found = configuration.to_flat()
    for key, value in flat.items():
        assert found[key] == value, key
        # rcl keeps 2 and 2.0 apart: what is declared as a float must be written as one
        assert type(value) is type(found[key]), f'{key}: {value}'
        if isinstance(value, list):
            assert [type(item) for item in value] == [type(item) for item in found[key]], key


def leaves(text):
    """Return (key, line) of every line of a YAML file that holds a value."""
    return [(match[1], line) for line in text.splitlines()
            if (match := re.match(r'\s+(\w+): +[^#\s]', line))]


@pytest.mark.parametrize('path', CONFIGURATIONS, ids=lambda path: path.stem)
def test_every_value_reports_what_it_is(path):
    lines = leaves(path.read_text(encoding='utf-8'))
    assert len(lines) > 10
    names = {'model', 'law', 'kind'}
    silent = [line for key, line in lines
              if '#' not in line and key not in names and not key.endswith('_drift')]
    assert silent == []


NOT_OF_THE_PAPER = {'edge_slope', 'edge_span', 'play', 'schedule_points', 'm_r_table',
                    'm_l_table', 'b_r_table', 'b_l_table'}
"""What a dead-zone may have besides, off by default."""


def test_the_paper_s_configuration_leaves_nothing_to_defaults():
    flat = flat_parameters(ROOT / 'config' / 'wang2004.yaml')
    configuration = Configuration.from_flat(flat)
    groups = {'plant': configuration.plant.parameters, 'controller': configuration.law.gains,
              'trajectory': configuration.trajectory.parameters,
              'plant.dead_zone': configuration.dead_zone}
    for prefix, group in groups.items():
        for item in schema.fields(type(group)):
            assert f'{prefix}.{item.name}' in flat or item.name in NOT_OF_THE_PAPER


def commands():
    """Yield (document, words) of every command in a code block of the documents."""
    for path in DOCUMENTS:
        text = path.read_text(encoding='utf-8')
        for block in re.findall(r'^```sh\n(.*?)^```', text, re.MULTILINE | re.DOTALL):
            for line in re.sub(r'\\\n', ' ', block).splitlines():
                for part in line.split('&&'):
                    words = shlex.split(part, comments=True)
                    if words:
                        yield path.name, words


def test_commands_in_documents_exist(described):
    targets = set(re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(encoding='utf-8'),
                             re.MULTILINE))
    scripts = {text.split(' = ')[0] for text in described['entry_points']['console_scripts']}
    scripts |= {Path(name).name for name in described['scripts']}
    seen = set()
    for document, words in commands():
        place = f'{document}: {" ".join(words)}'
        seen.add(words[0])
        if words[0] == 'make':
            assert {word for word in words[1:] if '=' not in word} <= targets, place
        elif words[0] == 'dz':
            check_dz(words[1:], place)
        elif words[:3] == ['ros2', 'run', 'dz_ros']:
            assert words[3] in scripts, place
            if words[3] == 'dz':
                check_dz(words[4:], place)
            for word in words:
                if word.startswith('src/dz_ros/'):
                    assert (ROOT / word.removeprefix('src/dz_ros/')).is_file(), place
        elif words[:3] == ['ros2', 'launch', 'dz_ros']:
            launch = (ROOT / 'launch' / words[3]).read_text(encoding='utf-8')
            for word in words[4:]:
                name = word.partition(':=')[0]
                assert f"DeclareLaunchArgument('{name}'" in launch, place
        elif '/' in words[0]:
            assert (ROOT / words[0]).is_file(), place
    assert {'make', 'dz', 'ros2'} <= seen


def check_dz(words, place):
    """Parse a command line of `dz` without running it, and read its configuration."""
    arguments = cli.parser_of(words).parse_args(words)
    if not words:       # prints the help
        return
    made = str(getattr(arguments, 'config', None) or '').endswith('identified.yaml')
    if hasattr(arguments, 'config') and not made:     # by an earlier command of the document
        Configuration.from_flat(flat_parameters(arguments.config, arguments.overrides))
    assert callable(arguments.do), place


@pytest.mark.skipif(shutil.which('make') is None, reason='make is not installed')
@pytest.mark.parametrize('words', [[], ['RUN=runs/mine']])
def test_the_demo_reports_the_run_it_has_recorded_whenever_it_starts(tmp_path, words):
    """By a clock that gives another second whenever it is asked."""
    clock = tmp_path / 'date'
    clock.write_text(f'#!/bin/sh\necho x >> {tmp_path}/asked\nwc -l < {tmp_path}/asked\n',
                     encoding='utf-8')
    clock.chmod(0o755)
    done = subprocess.run(['make', '-n', 'demo', *words], cwd=ROOT, check=True, text=True,
                          capture_output=True, env={
                              **os.environ, 'PATH': f'{tmp_path}:{os.environ["PATH"]}'})
    recorded = re.search(r'--record (\S+)', done.stdout)[1]
    assert re.search(r'dz report (\S+)', done.stdout)[1] == recorded
    assert recorded.startswith('runs/mine' if words else 'runs/demo-')
