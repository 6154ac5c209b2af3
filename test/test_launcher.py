# SPDX-License-Identifier: Apache-2.0
"""`scripts/dz`: an interrupt while Python itself starts is answered by dz, not by Python."""

from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

import pytest

import dz_ros

ROOT = Path(dz_ros.__file__).parents[1]
LAUNCHER = ROOT / 'scripts' / 'dz'
INTERRUPTED_AT_START = f"""#!{sys.executable}
import os, signal, sys
sys.path.insert(0, {str(ROOT)!r})
os.kill(os.getpid(), signal.SIGINT)     # dz_ros is not imported yet
from dz_ros.__main__ import main
sys.exit(main())
"""
BLOCKS = """#!/bin/sh
[ "$1" = --block-signal=INT ] && exit 125
exec /usr/bin/env "$@"
"""


def holds_signals_back():
    return subprocess.run(['env', '--block-signal=INT', 'true'], check=False,
                          capture_output=True).returncode == 0


needs_env = pytest.mark.skipif(not LAUNCHER.is_file() or not holds_signals_back(),
                               reason='needs the source tree and GNU env 8.31')


@pytest.fixture
def programs(tmp_path):
    """Return a function that makes a folder of programs: dz, and the console script given."""
    def make(console_script):
        folder = tmp_path / 'of programs'
        folder.mkdir()
        shutil.copy(LAUNCHER, folder / 'dz')
        (folder / 'dz_ros').write_text(console_script, encoding='utf-8')
        (folder / 'dz_ros').chmod(0o755)
        return folder

    return make


def call(*words, **settings):
    # As a terminal starts it, where the test itself may be a job in the background.
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=300.0,
                          preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
                          **settings)


@needs_env
def test_an_interrupt_before_dz_is_imported_is_its_one_line(programs):
    folder = programs(INTERRUPTED_AT_START)
    done = call(folder / 'dz', '--help')
    assert (done.returncode, done.stdout, done.stderr) == (130, '', 'dz: interrupted\n')
    alone = call(folder / 'dz_ros', '--help')
    assert 'Traceback' in alone.stderr      # what the launcher is for


@needs_env
@pytest.mark.slow
def test_no_instant_of_the_start_shows_a_traceback(programs):
    folder = programs('\n'.join(line for line in INTERRUPTED_AT_START.splitlines()
                                if 'os.kill' not in line))
    codes = set()
    for place in range(60):
        process = subprocess.Popen(
            [folder / 'dz', '--help'], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL), text=True)
        time.sleep(0.005 * place)       # the instant is the input of this test
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=300.0)
        assert 'Traceback' not in err, (place, err)
        codes.add(process.returncode)
    # -2: before Python there is only a shell, which the signal ends; 0: it was done.
    assert 130 in codes
    assert codes <= {-2, 0, 130}


ARGUMENTS = '#!/bin/sh\nprintf "%s|" "$@"\nexit 7\n'


def words_arrive(done):
    assert (done.returncode, done.stdout) == (7, 'a b||*|--set|x=[1, 2]|'), done.stderr


@pytest.mark.skipif(not LAUNCHER.is_file(), reason='needs the source tree')
def test_arguments_and_exit_code_pass_through_however_it_is_called(programs, tmp_path):
    folder, words = programs(ARGUMENTS), ('a b', '', '*', '--set', 'x=[1, 2]')
    words_arrive(call(folder / 'dz', *words))
    link = tmp_path / 'dz'
    link.symlink_to(folder / 'dz')
    words_arrive(call(link, *words))        # as pipx does
    words_arrive(call('sh', 'dz', *words, cwd=folder))
    words_arrive(call('dz', *words, env={'PATH': f'{folder}:/usr/bin:/bin'}))


@pytest.mark.skipif(not LAUNCHER.is_file(), reason='needs the source tree')
def test_an_env_that_holds_no_signal_back_starts_it_all_the_same(programs):
    folder = programs(ARGUMENTS)
    (folder / 'env').write_text(BLOCKS, encoding='utf-8')
    (folder / 'env').chmod(0o755)
    words_arrive(call(folder / 'dz', 'a b', '', '*', '--set', 'x=[1, 2]',
                      env={'PATH': f'{folder}:/usr/bin:/bin'}))
