# SPDX-License-Identifier: Apache-2.0
"""Requests to the operating system: made to all threads, refused with a reason, never fatal."""

import json
import os
import subprocess
import sys

import pytest

from dz_ros.runtime import privileges
from dz_ros.runtime.privileges import ask
from dz_ros.runtime.probe import lateness, main

LINUX = pytest.mark.skipif(not sys.platform.startswith('linux'), reason='asks Linux')


def refuse(*_):
    raise PermissionError(1, 'Operation not permitted')


@LINUX
def test_what_is_refused_comes_back_as_text_and_the_rest_is_done(monkeypatch):
    done = []
    monkeypatch.setattr(os, 'sched_setscheduler', refuse)
    monkeypatch.setattr(os, 'sched_setaffinity', lambda thread, cores: done.append(cores))
    monkeypatch.setattr(privileges, 'lock_memory', refuse)
    refused = ask(50, {1, 0}, lock=True)
    assert refused == ['locked memory (Operation not permitted)',
                       'SCHED_FIFO 50 (Operation not permitted)']
    assert done
    assert all(cores == [0, 1] for cores in done)


def test_nothing_asked_is_nothing_done(monkeypatch):
    for name in ('use_fifo', 'use_cores', 'lock_memory'):
        monkeypatch.setattr(privileges, name, refuse)
    assert ask() == []


@pytest.mark.parametrize('name', ['sched_setscheduler', 'sched_setaffinity'])
def test_a_system_without_such_things_refuses(monkeypatch, name):
    for other in ('sched_setscheduler', 'sched_setaffinity'):   # this process stays as it is
        monkeypatch.setattr(os, other, lambda *_: None)
    monkeypatch.delattr(os, name)
    refused = ask(10, [0])
    assert any('not on this system' in words for words in refused)


@LINUX
def test_cores_hold_for_all_threads_of_the_process():
    """In a process of its own: affinity cannot be left behind in this one."""
    code = ('import os, threading\n'
            'from dz_ros.runtime.privileges import ask\n'
            'from pathlib import Path\n'
            'release = threading.Event()\n'
            'threading.Thread(target=release.wait).start()\n'
            'core = max(os.sched_getaffinity(0))\n'
            'assert ask(cores=[core]) == []\n'
            'threads = [int(path.name) for path in Path("/proc/self/task").iterdir()]\n'
            'print(len(threads), {frozenset(os.sched_getaffinity(t)) for t in threads} == '
            '{frozenset([core])})\n'
            'assert "Invalid argument" in ask(cores=[4096])[0]\n'
            'release.set()\n')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ['2', 'True']


def test_lateness_is_ordered_and_complete():
    found = lateness(1000.0, 0.05)
    assert len(found) == 50
    assert found == sorted(found)
    assert found[0] >= 0.0


def test_the_probe_prints_what_it_measured(capsys, monkeypatch):
    monkeypatch.setattr('dz_ros.runtime.probe.settle', lambda: None)
    monkeypatch.setattr('dz_ros.runtime.probe.ask', lambda *_: ['everything'])
    assert main(['--duration', '0.02']) == 0
    out = capsys.readouterr().out
    assert '"refused": ["everything"]' in out
    assert len(json.loads(out)['lateness']) == 4
