# SPDX-License-Identifier: Apache-2.0
"""Build and test as colcon does in a ROS workspace, and look at what was installed.

Tests marked `ros`, `live` or `slow`, and those that only compute, are left to `make test`: a
second pass over the same code, however it was installed, would only double the time.
"""

import configparser
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET

ROOT = Path(__file__).resolve().parent.parent
NAME = 'dz_ros'
EXECUTABLES = ('dz', 'dz_ros', 'plant_node', 'actuator_node', 'controller_node', 'trajectory_node',
               'recorder_node', 'replay_node')
TIME_LIMIT = 1800
COMPUTING = ('core', 'identification', 'studies')
"""Folders of tests that only compute."""
PYTEST_ARGS = ('-m', 'not ros and not live and not slow',
               *(f'--ignore=test/{folder}' for folder in COMPUTING),
               '--no-cov',          # colcon adds --cov, which takes twice as long
               '--hypothesis-profile=quick', '-n', '3', '--dist', 'loadgroup')


def files(folder: Path) -> set[str]:
    """Return the files below a folder, relative to it; not what Python leaves there."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob('*')
            if path.is_file() and path.suffix != '.pyc'}


def main() -> int:
    """Build, test, look; return 0, or 1 with the first thing that is wrong."""
    environment = dict(os.environ)
    environment['PATH'] = f'{Path(sys.executable).parent}{os.pathsep}{environment["PATH"]}'
    with tempfile.TemporaryDirectory(prefix='dz_ros-colcon-') as folder:
        try:
            check(Path(folder), environment)
        except (AssertionError, subprocess.SubprocessError) as error:
            print(f'colcon: {error}', file=sys.stderr)
            return 1
    return 0


def check(folder: Path, environment: dict[str, str]) -> None:
    """Do it in a folder outside the source tree."""
    build, install = folder / 'build', folder / 'install'

    def colcon(*words: str) -> str:
        print('colcon', *(word for word in words if not word.startswith(str(folder))), flush=True)
        done = subprocess.run(['colcon', '--log-base', str(folder / 'log'), *words], cwd=ROOT,
                              env=environment, timeout=TIME_LIMIT, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, check=False)
        assert done.returncode == 0, f'{words[0]} failed:\n{done.stdout}'
        return done.stdout

    listed = colcon('list', '--base-paths', str(ROOT))
    types = {line.split()[0]: line.split()[-1] for line in listed.splitlines()}
    assert types.get(NAME) == '(ros.ament_python)', f'colcon list says {listed!r}'
    bases = ('--build-base', str(build), '--install-base', str(install))
    paths = ('--base-paths', str(ROOT))
    colcon('build', *bases, *paths)
    prefix = install / NAME
    executables = declared(prefix)
    for executable in executables:
        path = prefix / 'lib' / NAME / executable
        assert os.access(path, os.X_OK), f'lib/{NAME}/{executable} is missing or not executable'
    for kind in ('config', 'launch'):
        sources, shipped = files(ROOT / kind), files(prefix / 'share' / NAME / kind)
        assert sources == shipped, (f'share/{NAME}/{kind} differs in '
                                    f'{sorted(sources ^ shipped)}')
    use(prefix, folder, environment)
    colcon('test', *bases, *paths, '--return-code-on-test-failure', '--event-handlers',
           'console_direct+', '--pytest-args', *PYTEST_ARGS)
    suite = ET.parse(build / NAME / 'pytest.xml').getroot().find('.//testsuite')
    assert suite is not None, 'colcon test left no result'
    count = int(suite.get('tests', '0')) - int(suite.get('skipped', '0'))
    assert count > 0, 'colcon test ran no test'
    print(f'colcon: {len(executables)} executables, ament index and {count} tests in order')


def declared(prefix: Path) -> list[str]:
    """Return the executables that the installed package declares."""
    (path,) = prefix.glob('lib/python3*/site-packages/*.egg-info/entry_points.txt')
    points = configparser.ConfigParser()
    points.read(path, encoding='utf-8')
    found = sorted(points['console_scripts'])
    assert 'dz_ros' in found, f'{path.name} declares no dz_ros'
    return [*found, 'dz']       # a script that starts it


def use(prefix: Path, folder: Path, environment: dict[str, str]) -> None:
    """Run what was installed, from outside the source tree, as a sourced workspace would."""
    packages = next(prefix.glob('lib/python3*/site-packages'))
    sourced = {**environment, 'PYTHONPATH': str(packages), 'AMENT_PREFIX_PATH': str(prefix)}
    found = run([sys.executable, '-c', 'from ament_index_python import get_package_prefix as p; '
                 f'print(p("{NAME}"))'], folder, sourced)
    assert Path(found.strip()) == prefix, f'the ament index leads to {found.strip()}'
    dz = str(prefix / 'lib' / NAME / 'dz')
    version = ET.parse(ROOT / 'package.xml').getroot().findtext('version')
    assert run([dz, '--version'], folder, sourced).split() == [NAME, version]
    where = run([sys.executable, '-c', 'from dz_ros.files.configurations import *; '
                 'print(find_configuration("wang2004"))'], folder, sourced)
    assert where.startswith(str(prefix)), f'the configuration was found in {where.strip()}'
    run([dz, 'simulate', 'wang2004', '--duration', '1'], folder, sourced)


def run(command: list[str], folder: Path, environment: dict[str, str]) -> str:
    """Return what a command prints; it must end well."""
    done = subprocess.run(command, cwd=folder, env=environment, timeout=120, text=True,
                          capture_output=True, check=False)
    assert done.returncode == 0, f'{" ".join(command)}: {done.stderr.strip()}'
    return done.stdout


if __name__ == '__main__':
    sys.exit(main())
