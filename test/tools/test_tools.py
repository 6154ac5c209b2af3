# SPDX-License-Identifier: Apache-2.0
"""The tools behind make: they must be able to say no."""

import importlib.util
from pathlib import Path
import subprocess
import sys

import pytest

TOOLS = Path(__file__).parents[2] / 'tools'
sys.path.insert(0, str(TOOLS))     # as for a tool that is started


def load(name):
    """Return a tool as a module; none of them is part of the package."""
    spec = importlib.util.spec_from_file_location(name, TOOLS / f'{name}.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def docs(tmp_path, monkeypatch):
    """Return check_docs on a small project without fault, and a function that adds a file."""
    module = load('check_docs')
    monkeypatch.setattr(module, 'ROOT', tmp_path)
    monkeypatch.setattr(module, 'tracked_files', lambda: sorted(
        path.relative_to(tmp_path) for path in tmp_path.rglob('*') if path.is_file()))

    def write(name, text):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding='utf-8')

    write('README.md', '# One\n\n[notes](docs/notes.md#two-things) by [known2000]\n')
    write('docs/architecture.md', 'Folders of `dz_ros/`:\n\n| `core/` | numbers |\n\n'
                                  'Beside `dz_ros/`:\n\n| `docs/` | text |\n')
    write('docs/notes.md', '# Notes\n\n## Two things\n\n`[not](a link)` [web](https://x.y)\n')
    write('docs/index.md', 'notes\narchitecture\nnotation\nmathematics\nreferences\nterms\nmore\n')
    write('docs/more.md', '')
    write('docs/references.md', '```bibtex\n@book{known2000,\n}\n```\n')
    write('dz_ros/core/a.py', '"""After [known2000]."""\n')
    write('docs/terms.md', '| term | meaning | where | not |\n|---|---|---|---|\n'
                           '| again | | | anew, once more |\n| x | | | `change_old`, old |\n')
    monkeypatch.setattr(module.retired_words, 'NOT_YET', ('dz_ros/late',))
    assert module.main() == 0
    return module, write


@pytest.mark.parametrize(('name', 'text', 'fault'), [
    ('docs/more.md', '[gone](nowhere.md)\n', 'docs/more.md: nowhere.md does not exist'),
    ('docs/more.md', '![gone](nowhere.png)\n', 'nowhere.png does not exist'),
    ('docs/more.md', '[a](notes.md#three)\n', 'notes.md#three: no such heading'),
    ('docs/more.md', 'after [unknown1999]\n', 'docs/more.md:1: [unknown1999] is not in'),
    ('dz_ros/core/b.py', '# [known2000; unknown1999]\n', '[unknown1999] is not in'),
    ('docs/references.md', '@book{known2000,}\n@book{known2000,}\n', 'known2000 is given 2 times'),
    ('dz_ros/core/b.py', '# by §3\n', 'b.py:1: docs/mathematics.md has no section 3'),
    ('docs/notation.md', '<!-- signals: written by tools/signal_tables.py -->\n'
                         '<!-- end of signals -->\n', 'docs/notation.md: old tables of signals'),
    ('docs/references.md', '@book{known2000,}\n@book{idle1999,}\n', 'nothing cites idle1999'),
    ('dz_ros/nodes/c.py', '', 'lacks the folder dz_ros/nodes/'),
    ('extra/c.py', '', 'lacks the folder extra/'),
    ('docs/architecture.md', 'Folders of `dz_ros/`:\n| `core/` | x |\n| `gone/` | x |\n'
     'Beside `dz_ros/`:\n| `docs/` | x |\n', 'the folder dz_ros/gone/ is not there'),
    ('docs/architecture.md', '[known2000]\n', 'there must be two tables of folders'),
    ('docs/other.md', '', 'docs/index.md: lacks other'),
    ('docs/more.md', 'by `docs/gone.yaml`\n', 'there is no docs/gone.yaml'),
    ('docs/more.md', 'by `core/gone.py`\n', 'there is no core/gone.py'),
    ('docs/more.md', 'by `test_gone`\n', 'there is no test_gone.py in test/'),
    ('docs/more.md', 'Begin\nANEW.\n', "docs/more.md:2: 'ANEW': see docs/terms.md"),
    ('dz_ros/core/b.py', '# what is\n# once\n# more\n', "b.py:2: 'once\\nmore'"),
    ('dz_ros/core/b.py', 'x = ("begin once"\n     " more")\n', "b.py:1: 'once\\n more'"),
    ('dz_ros/core/b.py', 'def begin_anew(): pass\n', "b.py:1: 'anew'"),
    ('dz_ros/core/b.py', 'class BeginAnew: pass\n', "b.py:1: 'Anew'"),
    ('dz_ros/core/b.py', 'PATIENCE = 1\n', "b.py:1: 'PATIENCE'"),
    ('dz_ros/core/telling.py', '', "telling.py:1: 'a file called telling'"),
])
def test_every_fault_of_a_document_is_found(docs, name, text, fault, capsys):
    module, write = docs
    write(name, text)
    capsys.readouterr()
    assert module.main() == 1
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 1
    assert fault in err[0]


def test_git_knows_the_files_of_this_project():
    module = load('check_docs')
    found = {str(path) for path in module.tracked_files()}
    assert {'README.md', 'dz_ros/errors.py', 'docs/references.md'} <= found
    assert not any('__pycache__' in name or name.startswith('.') for name in found)


@pytest.fixture
def environment(monkeypatch, tmp_path):
    """Return tools/environment.py with commands recorded instead of run."""
    module = load('environment')
    calls = []

    def call(command, **_):
        calls.append(command)
        if '-m' in command and command[command.index('-m') + 1] == 'venv':
            (tmp_path / 'venv').mkdir(exist_ok=True)
        return 0

    monkeypatch.setattr(subprocess, 'call', call)
    monkeypatch.delenv('ROS_DISTRO', raising=False)
    return module, calls, str(tmp_path / 'venv')


def installs(calls):
    """Return what pip was asked to install, command by command."""
    return [command[-1] for command in calls if 'install' in command]


def test_an_environment_is_made_once_and_follows_its_sources(environment, monkeypatch, tmp_path):
    module, calls, venv = environment
    assert module.main([venv, 'ros']) == 0
    assert installs(calls) == ['.[ros]']
    calls.clear()
    assert module.main([venv, 'ros']) == 0
    assert module.main([venv]) == 0
    assert installs(calls) == []
    assert module.main([venv, 'test']) == 0
    assert installs(calls) == ['.[ros,test]']     # what it has stays up to date with the rest
    calls.clear()
    monkeypatch.setattr(module, 'state', lambda ros_here: {
        'base': (tmp_path / 'venv' / 'dz_ros.stamp').read_text().splitlines()[0],
        'sources': 'changed'})
    assert module.main([venv]) == 0
    assert installs(calls) == ['.[ros,test]']
    monkeypatch.setattr(module, 'state', lambda ros_here: {'base': 'other', 'sources': 'changed'})
    calls.clear()
    assert module.main([venv, 'lint']) == 0
    assert any('venv' in command for command in calls)
    assert installs(calls) == ['.[lint]']         # another Python: from the beginning


def test_what_failed_is_tried_again(environment, monkeypatch, capsys):
    module, calls, venv = environment
    succeed = subprocess.call
    monkeypatch.setattr(subprocess, 'call', lambda command, **rest: (
        1 if 'install' in command else succeed(command, **rest)))
    assert module.main([venv, 'ros']) == 2
    assert capsys.readouterr().err.count('\n') == 1
    monkeypatch.setattr(subprocess, 'call', succeed)
    assert module.main([venv, 'ros']) == 0
    assert installs(calls) == ['.[ros]']


@pytest.mark.parametrize('version', [(2, 7), (3, 9), (3, 14), (4, 0)])
def test_another_python_is_refused_in_one_line(environment, version, monkeypatch, capsys):
    module, calls, venv = environment
    monkeypatch.setattr(sys, 'version_info', (*version, 0, 'final', 0))
    assert module.main([venv]) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert '3.10 to 3.13' in err
    assert calls == []


def test_another_distribution_is_refused_in_one_line(environment, monkeypatch, capsys):
    module, calls, venv = environment
    monkeypatch.setenv('ROS_DISTRO', 'humble')
    assert module.main([venv, 'ros']) == 2
    assert 'humble' in capsys.readouterr().err
    assert calls == []


def test_an_installed_ros_is_used_instead_of_the_wheels(environment, monkeypatch):
    module, calls, venv = environment
    import numpy
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, 'find_spec', lambda name, *rest: (
        find('json') if name == 'rclpy' else find(name, *rest)))
    assert module.main([venv, 'ros', 'test']) == 0
    assert any('--system-site-packages' in command for command in calls)
    (command,) = [command for command in calls if 'install' in command]
    assert '.[test]' in command
    assert f'numpy=={numpy.__version__}' in command


def test_a_folder_that_is_not_in_order_yet_is_counted(docs, capsys):
    module, write = docs
    folders = (module.ROOT / 'docs' / 'architecture.md').read_text()
    write('docs/architecture.md', folders.replace('| `core/`', '| `late/` | x |\n| `core/`'))
    write('dz_ros/late/b.py', '"""Anew."""\nanew = canew = 1\n')
    assert module.main() == 0
    assert 'docs: note: dz_ros/late: 2 retired words' in capsys.readouterr().out


def test_every_allowed_use_has_a_reason_and_is_used():
    words = load('retired_words')
    root = TOOLS.parent
    for name, _, reason in words.ALLOWED:
        assert reason
        assert (root / name).is_file()
    for name in words.NOT_YET:
        assert (root / name).exists() or name.startswith('docs/'), name
