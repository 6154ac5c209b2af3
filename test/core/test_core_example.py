# SPDX-License-Identifier: Apache-2.0
"""A user's own plant, trajectory and law, found by ``module:Class`` and by entry point."""

import importlib.util
from pathlib import Path
import runpy
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy import integrate
import yaml

from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.loop.offline import simulate
from dz_ros.core.plants import PLANTS
from dz_ros.core.trajectories import TRAJECTORIES
from dz_ros.errors import ConfigurationError, UnknownNameError

EXAMPLE = Path(__file__).parents[2] / 'examples' / 'dz_ros_example'
NAMES = {'plant.model': 'dz_ros_example.tank:Tank',
         'trajectory.kind': 'dz_ros_example.logistic:Logistic',
         'controller.law': 'dz_ros_example.pi:Pi'}


def read():
    """Return the example's configuration file as dotted keys."""
    tree = yaml.safe_load((EXAMPLE / 'config' / 'tank.yaml').read_text(encoding='utf-8'))
    sections = tree['/**']['ros__parameters']
    flat = {f'{section}.{key}': value for section, values in sections.items()
            for key, value in values.items()}
    for key, value in flat.pop('plant.dead_zone').items():
        flat[f'plant.dead_zone.{key}'] = value
    return flat


@pytest.fixture
def fresh(monkeypatch):
    """Forget the example's modules afterwards, as if it had never been there."""
    yield monkeypatch
    for name in [name for name in sys.modules if name.startswith('dz_ros_example')]:
        del sys.modules[name]


@pytest.fixture
def on_path(fresh):
    """Only the folder of the example is on the path: nothing is installed."""
    fresh.syspath_prepend(EXAMPLE)


@pytest.fixture
def described(fresh):
    """Return what setup.py gives setuptools, without setuptools."""
    given = {}
    fresh.setitem(sys.modules, 'setuptools',
                  types.SimpleNamespace(setup=lambda **keys: given.update(keys)))
    fresh.chdir(EXAMPLE)
    runpy.run_path('setup.py')
    return given


@pytest.fixture
def installed(fresh, described, tmp_path):
    """Return where the example is installed: its package and the entry points of its setup.py."""
    shutil.copytree(EXAMPLE / 'dz_ros_example', tmp_path / 'dz_ros_example',
                    ignore=shutil.ignore_patterns('__pycache__'))
    info = tmp_path / 'dz_ros_example-0.1.0.dist-info'
    info.mkdir()
    info.joinpath('METADATA').write_text('Metadata-Version: 2.1\nName: dz_ros_example\n'
                                         'Version: 0.1.0\n', encoding='utf-8')
    lines = [line for group, points in described['entry_points'].items()
             for line in (f'[{group}]', *points)]
    info.joinpath('entry_points.txt').write_text('\n'.join(lines) + '\n', encoding='utf-8')
    fresh.syspath_prepend(tmp_path)
    return tmp_path


def check_that_it_tracks(configuration):
    found = simulate(configuration)
    late = found.t > 20.0
    assert np.abs(found.x[late, 0] - found.x_d[late, 0]).max() < 1e-3
    assert found.x[-1, 0] == pytest.approx(0.6, abs=1e-3)
    assert found.column('integral')[-1] == pytest.approx(
        -(0.5 * np.sqrt(0.6) + 0.2) / 50.0, rel=1e-2)  # outflow and dead-zone, through k_i


def test_by_module_and_class(on_path):
    check_that_it_tracks(Configuration.from_flat({**read(), **NAMES}))


def test_by_entry_point(installed):
    check_that_it_tracks(Configuration.from_flat(read()))
    for registry, name in ((PLANTS, 'tank'), (TRAJECTORIES, 'logistic'), (LAWS, 'pi')):
        assert name in registry.installed()
        assert registry.all()[name].name == name
        module = sys.modules[registry.load(name).__module__]
        assert Path(module.__file__).parent.parent == installed


def test_both_ways_are_the_same_run_and_written_down_as_given(installed):
    named = Configuration.from_flat(read())
    direct = Configuration.from_flat({**read(), **NAMES})
    assert np.array_equal(simulate(named).x, simulate(direct).x)
    for configuration in (named, direct):
        flat = configuration.to_flat()
        assert Configuration.from_flat(flat).to_flat() == flat
    assert direct.to_flat()['plant.model'] == 'dz_ros_example.tank:Tank'
    assert named.to_flat()['plant.model'] == 'tank'


def test_without_it_the_error_reports_what_to_do(monkeypatch):
    with pytest.raises(UnknownNameError, match=r'no such plant; known: wang2004.*package\.module'):
        Configuration.from_flat(read())
    with pytest.raises(UnknownNameError, match='cannot be loaded'):
        Configuration.from_flat({**read(), **NAMES})


def test_our_plants_with_their_law_and_trajectory(on_path):
    found = simulate(Configuration.from_flat({
        'controller.law': NAMES['controller.law'], 'trajectory.kind': NAMES['trajectory.kind'],
        'plant.model': 'servo', 'controller.k_i': 5.0, 'controller.lambda': 3.0}))
    assert np.abs(found.x[-1, 0] - found.x_d[-1, 0]) < 0.05


def test_their_checks_are_asked(on_path):
    with pytest.raises(ConfigurationError, match=r'trajectory\.goal = 0\.2: must not be'):
        Configuration.from_flat({**read(), **NAMES, 'trajectory.goal': 0.2})
    with pytest.raises(ConfigurationError, match='gives 2 derivatives, the plant needs 3'):
        Configuration.from_flat({'plant.model': 'valve_actuator',
                                 'trajectory.kind': NAMES['trajectory.kind']})


def test_tank_and_curve_are_what_they_report(on_path):
    c = Configuration.from_flat({**read(), **NAMES, 'controller.k_p': 0.0, 'controller.k_i': 0.0})
    found = simulate(c)  # no command: the tank runs empty
    expected = integrate.solve_ivp(lambda _, h: -0.01 * np.sqrt(np.maximum(h, 0.0)), (0.0, 30.0),
                                   [0.2], rtol=1e-10, atol=1e-12).y[0, -1]
    assert found.x[-1, 0] == pytest.approx(expected, abs=1e-9)
    slope = np.gradient(found.x_d[:, 0], found.t)[1:-1]
    assert slope == pytest.approx(found.x_d[1:-1, 1], abs=1e-5)


def test_the_package_is_one_ros_knows(described):
    manifest = ET.parse(EXAMPLE / 'package.xml').getroot()
    assert manifest.findtext('name') == described['name'] == 'dz_ros_example'
    assert manifest.findtext('version') == described['version']
    assert manifest.findtext('export/build_type') == 'ament_python'
    assert manifest.findtext('exec_depend') == 'dz_ros'
    files = dict(described['data_files'])
    assert files['share/ament_index/resource_index/packages'] == ['resource/dz_ros_example']
    for names in files.values():
        for name in names:
            assert EXAMPLE.joinpath(name).is_file()


@pytest.mark.skipif(not importlib.util.find_spec('setuptools'),
                    reason='setuptools is not installed')
def test_setup_py_is_one_setuptools_knows(tmp_path):
    source = shutil.copytree(EXAMPLE, tmp_path / 'source',
                             ignore=shutil.ignore_patterns('__pycache__'))
    subprocess.run([sys.executable, 'setup.py', '-q', 'egg_info', '--egg-base', str(tmp_path)],
                   cwd=source, check=True, timeout=120, capture_output=True)
    points = (tmp_path / 'dz_ros_example.egg-info' / 'entry_points.txt').read_text('utf-8')
    assert 'tank = dz_ros_example.tank:Tank' in points
