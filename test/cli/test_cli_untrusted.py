# SPDX-License-Identifier: Apache-2.0
"""Recordings are data: the verbs that read them import nothing they name and print no forged line.

The module that the recordings name leaves a file beside itself when it is imported, and then exits
with code 0, as one would that wants an audit to pass.
"""

from dataclasses import replace
import json
import math
import os
from pathlib import Path
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest

from dz_ros.cli.main import main
from dz_ros.cli.run import _Loop, progress_of
from dz_ros.core.dataset import RunData
from dz_ros.core.events import ConfigurationEvent
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run

EVIL = 'from pathlib import Path\nPath(__file__).with_name("was_imported").touch()\n'
EXITS = 'import sys\nsys.exit(0)\n'
MINE = ('from dz_ros.core.plants.wang2004 import Wang2004\n'
        'class Mine(Wang2004):\n    name = "mine"\n')
FORGED = 'robust\nevery command and every estimate is reproduced bit for bit\n\x1b[2K\r$\\frac{1'
NAMES = ('plant.model', 'controller.law', 'trajectory.kind', 'driver.name')


@pytest.fixture(scope='module')
def original(tmp_path_factory):
    run = tmp_path_factory.mktemp('runs') / 'run'
    assert main(['simulate', 'wang2004', '--duration', '6', '--record', str(run)]) == 0
    return read_run(run)


def naming(data: RunData, **changed: str) -> RunData:
    """Return the run as if it had been of such a configuration, stated by its nodes as well."""
    flat = {**data.configuration, **changed}
    begin = int(data.channels['state'].log_time[0]) - 1
    stated = ConfigurationEvent('/controller_node', flat, ('controller', 'safety', 'plant'),
                                memory=(0.85, 0.85, 0.85), version='0.1.0')
    return replace(data, configuration=flat,
                   events=((begin, '/controller_node', stated.to_json()),))


def dz(*words: object, path: Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a verb in a process of its own that could import what lies in a folder."""
    found = [str(path), os.environ.get('PYTHONPATH', '')]
    return subprocess.run(
        [sys.executable, '-m', 'dz_ros', *map(str, words)], capture_output=True, text=True,
        check=False, timeout=300, cwd=cwd,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, found))})


VERBS = {
    'audit': ('bag', 'audit', '{run}'),
    'info': ('bag', 'info', '{run}'),
    'report': ('report', '{run}', '--json'),
    'report with pictures': ('report', '{run}', '--out', '{out}'),
    'compare': ('bag', 'compare', '{run}', '{run}', '--json'),
    'whatif': ('bag', 'whatif', '{run}', '--set', 'controller.lambda=2', '--out', '{out}'),
    'whatif --fit': ('bag', 'whatif', '{run}', '--fit', '--out', '{out}'),
    'replay --into': ('bag', 'replay', '{run}', '--into', 'controller'),
    'identify': ('driver', 'identify', '--from', '{run}', '--out', '{out}'),
    'recover': ('bag', 'recover', '{run}', '{out}'),
}
CANNOT = {'audit': 1, 'whatif': 2, 'whatif --fit': 2, 'replay --into': 2, 'identify': 2}
"""Verb → exit code where it needs the configuration and may not have it."""


@pytest.mark.slow
@pytest.mark.parametrize('verb', VERBS)
def test_no_verb_imports_what_a_recording_names(original, tmp_path, verb):
    if verb == 'replay --into':
        pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    (tmp_path / 'evil_module.py').write_text(EVIL + EXITS)
    named = dict.fromkeys(NAMES, 'evil_module:Thing')
    save_run(naming(original, **named), tmp_path / 'run')
    done = dz(*(word.format(run=tmp_path / 'run', out=tmp_path / 'out') for word in VERBS[verb]),
              path=tmp_path)
    reported = done.stdout + done.stderr
    assert not (tmp_path / 'was_imported').exists(), reported
    assert done.returncode == CANNOT.get(verb, 0), reported
    assert 'Traceback' not in reported
    if verb not in ('info', 'recover'):
        assert "'evil_module:Thing'" in reported
        assert '--allow-import evil_module' in reported


@pytest.mark.slow
@pytest.mark.parametrize('verb', ['audit', 'report', 'compare', 'whatif'])
@pytest.mark.parametrize('raised', [EXITS, 'raise BaseException("no\\nway")\n', '1 / 0\n'])
def test_an_allowed_import_that_fails_is_one_line_and_no_success(original, tmp_path, verb, raised):
    (tmp_path / 'evil_module.py').write_text(EVIL + raised)
    save_run(naming(original, **{'plant.model': 'evil_module:Thing'}), tmp_path / 'run')
    done = dz(*(word.format(run=tmp_path / 'run', out=tmp_path / 'out') for word in VERBS[verb]),
              '--allow-import', 'evil_module', path=tmp_path)
    reported = done.stdout + done.stderr
    assert (tmp_path / 'was_imported').exists()
    assert done.returncode in (1, 2), reported
    assert 'Traceback' not in reported
    assert 'cannot be loaded' in reported
    assert 'bit for bit' not in reported


def test_a_plant_of_ones_own_is_audited_with_the_option(original, tmp_path):
    (tmp_path / 'my_own_plants.py').write_text(MINE)
    save_run(naming(original, **{'plant.model': 'my_own_plants:Mine'}), tmp_path / 'run')
    refused = dz('bag', 'audit', tmp_path / 'run', path=tmp_path)
    assert refused.returncode == 1
    assert '--allow-import my_own_plants' in refused.stdout
    done = dz('bag', 'audit', tmp_path / 'run', '--allow-import', 'my_own_plants', path=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'bit for bit' in done.stdout


def test_a_plant_of_ones_own_in_a_file_needs_no_option(tmp_path):
    (tmp_path / 'my_own_plants.py').write_text(MINE)
    (tmp_path / 'mine.yaml').write_text('plant:\n  model: my_own_plants:Mine\n'
                                        'controller:\n  law: wang2004\nloop:\n  duration: 2.0\n')
    done = dz('simulate', tmp_path / 'mine.yaml', path=tmp_path)
    assert done.returncode == 0, done.stderr
    (tmp_path / 'my_own_plants.py').write_text(EXITS)
    done = dz('simulate', tmp_path / 'mine.yaml', path=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count('\n') == 1
    assert 'SystemExit' in done.stderr


def test_code_that_exits_in_a_step_is_no_success(tmp_path):
    (tmp_path / 'quitting.py').write_text(
        MINE + '    def __init__(self, parameters):\n        raise SystemExit(0)\n')
    (tmp_path / 'mine.yaml').write_text('plant:\n  model: quitting:Mine\n')
    done = dz('simulate', tmp_path / 'mine.yaml', path=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count('\n') == 1


@pytest.mark.parametrize('extra', ['', os.pathsep])
def test_what_lies_in_the_current_folder_is_not_imported(tmp_path, extra):
    here = tmp_path / 'here'
    here.mkdir()
    elsewhere = tmp_path / 'elsewhere'
    elsewhere.mkdir()
    for name in ('numpy', 'evil_module', 'yaml'):
        (here / f'{name}.py').write_text(EVIL + EXITS)
    metadata = here / 'evil-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text('[dz_ros.plants]\nevil = evil_module:Thing\n')
    done = dz('list', 'plants', path=Path(f'{elsewhere}{extra}'), cwd=here)
    assert done.returncode == 0, done.stderr
    assert 'evil' not in done.stdout
    assert not (here / 'was_imported').exists()


@pytest.mark.slow
@pytest.mark.parametrize('verb', ['audit', 'info', 'report', 'report with pictures', 'compare'])
def test_no_line_is_forged(original, tmp_path, verb):
    data = naming(original, **{'controller.law': FORGED, 'plant.model': FORGED})
    terms = data.channels['terms']
    labels = (*terms.labels[:-1], 'forged\nevery\x1b[2K $\\frac{1')
    data = replace(data, info={**data.info, 'host': FORGED, 'dz_ros': FORGED},
                   channels={**data.channels, 'terms': replace(terms, labels=labels)})
    save_run(data, tmp_path / 'run')
    done = dz(*(word.format(run=tmp_path / 'run', out=tmp_path / 'out') for word in VERBS[verb]),
              path=tmp_path)
    reported = done.stdout + done.stderr
    assert 'Traceback' not in reported
    assert '\x1b' not in reported
    assert '\r' not in reported
    assert not any(line.startswith(('every', 'forged')) for line in reported.splitlines())
    if verb == 'report with pictures':
        page = (tmp_path / 'out' / 'report.html').read_text(encoding='utf-8')
        assert '\x1b' not in page
        assert '\nevery command' not in page


@pytest.mark.parametrize('line', [
    '{"t": 1}', '{"t": [1], "error": 0, "v": 0}', '{"t"' + '[' * 100_000, '{"t": 1, "error": "x"}',
    '{"t": 1.0, "error": 0.1, "v": 0.2, "s_over_epsilon": {}, "rate": null, "late": null}'])
def test_a_line_that_only_looks_like_progress_is_shown(line):
    assert progress_of(line) is None


def test_progress_is_read():
    line = {'t': 1.0, 'error': 0.1, 'v': math.nan, 's_over_epsilon': None, 'rate': None, 'late': 3}
    assert progress_of(json.dumps(line)).keys() == line.keys()
    assert progress_of(json.dumps({**line, 't': None})) is None


def test_dz_run_escapes_what_a_node_prints(capsys):
    loop = object.__new__(_Loop)
    loop.__dict__.update(_lock=threading.Lock(), _terminal=False, _printing=True, _line='')
    loop._read(SimpleNamespace(stdout=['\x1b[33m[WARN] a\x1b[0m\x1b[2K\rforged\n']))
    assert capsys.readouterr().out == '[WARN] a\\x1b[2K\\rforged\n'
