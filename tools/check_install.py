# SPDX-License-Identifier: Apache-2.0
"""Install a copy of the source tree with pip into a new environment and try the commands there.

Without ROS: what needs rclpy must say so in one line, everything else must work.
"""

from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ('config', 'dz_ros', 'launch', 'resource', 'scripts', 'package.xml', 'pyproject.toml',
           'setup.cfg', 'setup.py', 'README.md')


def main() -> int:
    """Install and try; return 0, or 1 with the first thing that is wrong."""
    with tempfile.TemporaryDirectory(prefix='dz_ros-install-') as folder:
        try:
            check(Path(folder))
        except (AssertionError, subprocess.SubprocessError) as error:
            print(f'pip install: {error}', file=sys.stderr)
            return 1
    return 0


def check(folder: Path) -> None:
    """Do it in a folder outside the source tree."""
    source = folder / 'source'
    source.mkdir()
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns('__pycache__'))
        else:
            shutil.copy(path, source)
    environment = folder / 'environment'
    call([sys.executable, '-m', 'venv', str(environment)], folder)
    call([str(environment / 'bin' / 'python'), '-m', 'pip', 'install', '--quiet',
          '--disable-pip-version-check', str(source)], folder)
    dz = str(environment / 'bin' / 'dz')
    version = ET.parse(ROOT / 'package.xml').getroot().findtext('version')
    assert call([dz, '--version'], folder).stdout.split() == ['dz_ros', version]
    for kind in ('plants', 'laws', 'configurations'):
        assert 'wang2004' in call([dz, 'list', kind], folder).stdout, f'dz list {kind}'
    call([dz, 'simulate', 'wang2004', '--duration', '1', '--record', 'run'], folder)
    call([dz, 'bag', 'info', 'run'], folder)
    call([dz, 'report', 'run'], folder)
    refused = call([dz, 'run', 'wang2004'], folder, expected=2)
    assert refused.stderr.count('\n') == 1, f'dz run without rclpy says: {refused.stderr}'
    assert 'rclpy' in refused.stderr, f'dz run without rclpy says: {refused.stderr}'
    print('pip install: dz simulates, records and reports without ROS')


def call(command: list[str], folder: Path,
         expected: int = 0) -> subprocess.CompletedProcess[str]:
    """Run a command; it must end with the code expected."""
    done = subprocess.run(command, cwd=folder, timeout=900, text=True, capture_output=True,
                          check=False)
    assert done.returncode == expected, (
        f'{" ".join(command)} returned {done.returncode}: {done.stderr.strip()}')
    return done


if __name__ == '__main__':
    sys.exit(main())
