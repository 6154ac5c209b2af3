# SPDX-License-Identifier: Apache-2.0
"""Make the virtual environment of the Makefile, or bring it up to date; nothing to do is quick.

    python3 tools/environment.py VENV EXTRA…

Installs this source tree (editable) with the extras of setup.py named, added to those it has. A
stamp in the environment remembers what it was made from. Where a ROS 2 Jazzy is sourced, its own
rclpy is used instead of the wheels. Only the standard library, and syntax that old Pythons read
far enough to be told that they are too old.
"""

import hashlib
import importlib.util
import os
from pathlib import Path
import subprocess
import sys

SUPPORTED = ((3, 10), (3, 13))
DISTRIBUTION = 'jazzy'
ROOT = Path(__file__).resolve().parent.parent
SOURCES = ('setup.py', 'package.xml', 'scripts/dz', 'tools/environment.py')


def main(arguments):
    """Make the environment; return an exit code."""
    low, high = SUPPORTED
    if not low <= sys.version_info[:2] <= high:
        return complain('needs Python 3.{} to 3.{}, {} is {}.{}: choose one, e.g. make '
                        'PYTHON=python3.12 …'.format(low[1], high[1], sys.executable,
                                                     *sys.version_info[:2]))
    if importlib.util.find_spec('venv') is None or importlib.util.find_spec('ensurepip') is None:
        return complain('this Python has no venv; on Debian and Ubuntu: apt install python3-venv')
    distribution = os.environ.get('ROS_DISTRO', '')
    if distribution not in ('', DISTRIBUTION):
        return complain('ROS 2 ' + distribution + ' is sourced here, dz_ros is for '
                        + DISTRIBUTION + ': use a shell without it')
    ros_here = bool(distribution) and importlib.util.find_spec('rclpy') is not None
    folder = Path(arguments[0])
    stamp = folder / 'dz_ros.stamp'
    wanted, known = state(ros_here), {}
    if stamp.is_file():
        lines = stamp.read_text(encoding='utf-8').splitlines()
        known = {'base': lines[0], 'sources': lines[1], 'extras': lines[2].split()}
    python = folder / 'bin' / 'python'
    if known.get('base') != wanted['base'] or not works(python):
        print('Making {} with Python {}.{}'.format(folder, *sys.version_info[:2]), flush=True)
        if stamp.is_file():
            stamp.unlink()
        options = ['--system-site-packages'] if ros_here else []
        code = subprocess.call([sys.executable, '-m', 'venv', '--clear', *options, str(folder)])
        if code != 0:
            return complain('could not make ' + str(folder))
        known = {'extras': []}
    extras = sorted({*known['extras'], *arguments[1:]})
    if known.get('sources') == wanted['sources'] and extras == known['extras']:
        return 0
    installed = [extra for extra in extras if not (ros_here and extra == 'ros')]
    what = '.[{}]'.format(','.join(installed)) if installed else '.'
    print('Installing', what, 'into', folder, '(once; some 600 MB with ROS)', flush=True)
    command = [str(python), '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check',
               '--editable', what]
    if ros_here and importlib.util.find_spec('numpy') is not None:
        # The messages of an installed ROS are compiled for its own numpy.
        import numpy
        command.append('numpy==' + numpy.__version__)
    if subprocess.call(command, cwd=str(ROOT)) != 0:
        return complain('pip could not install the packages named in setup.py (see above)')
    # A tree installed as it stands has no byte code, and PYTHONDONTWRITEBYTECODE, which images of
    # containers set, would have it compiled again at every start.
    subprocess.call([str(python), '-m', 'compileall', '-q', 'dz_ros'], cwd=str(ROOT))
    stamp.write_text('{}\n{}\n{}\n'.format(wanted['base'], wanted['sources'], ' '.join(extras)),
                     encoding='utf-8')
    return 0


def state(ros_here):
    """Return what the environment is made from: its Python, the contents of the sources."""
    digest = hashlib.sha256()
    for name in SOURCES:
        digest.update((ROOT / name).read_bytes())
    base = '{}.{} {} ros={}'.format(*sys.version_info[:2], ROOT, int(ros_here))
    return {'base': base, 'sources': digest.hexdigest()}


def works(python):
    """Return whether the environment's Python runs (its base may have been removed)."""
    try:
        return subprocess.call([str(python), '-c', 'import pip'],
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) == 0
    except OSError:
        return False


def complain(message):
    """Say on one line what is wrong; return the exit code of a user's mistake."""
    sys.stderr.write('dz_ros: ' + message + '\n')
    return 2


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
