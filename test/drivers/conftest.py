"""Fixtures of the tests of drivers: the reference firmware, compiled."""

from pathlib import Path
import shutil
import subprocess

import pytest

FIRMWARE = Path(__file__).parents[2] / 'examples' / 'firmware'
FLAGS = ('-std=c99', '-pedantic', '-O2', '-Wall', '-Wextra', '-Wshadow', '-Wconversion', '-Werror')


SANITIZER = ('-fsanitize=undefined', '-fno-sanitize-recover=all', '-static-libubsan')


def compiled(folder, name, *arguments, sanitized=False):
    """Compile the firmware, skip where there is no compiler; return the file."""
    compiler = shutil.which('cc')
    if compiler is None:
        pytest.skip('no C compiler (cc) on this machine: the firmware is not tested')
    if not FIRMWARE.is_dir():
        pytest.skip('needs the source tree: examples/firmware is not installed')
    target = folder / name

    def compile_with(*flags):
        return subprocess.run([compiler, *FLAGS, *flags, '-o', str(target), *arguments],
                              cwd=FIRMWARE, capture_output=True, text=True, timeout=120,
                              check=False)

    done = compile_with(*SANITIZER) if sanitized else None
    if done is None or done.returncode:     # not every compiler has the sanitizer
        done = compile_with()
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return target


@pytest.fixture(scope='session')
def firmware(tmp_path_factory):
    """Return the reference firmware as a program for this machine."""
    return compiled(tmp_path_factory.mktemp('firmware'), 'firmware', 'dz_device.c', 'line_main.c',
                    '-lm')


@pytest.fixture(scope='session')
def firmware_library(tmp_path_factory):
    """Return the firmware's portable part as a shared library."""
    return compiled(tmp_path_factory.mktemp('firmware'), 'dz_device.so', '-shared', '-fPIC',
                    'dz_device.c', sanitized=True)
