# SPDX-License-Identifier: Apache-2.0
"""A recording of a real positioning axis, which is no part of dz_ros and lies beside it.

Skipped where ``../shared/data/emps_200hz.csv`` is absent. The commands are those of
docs/real_log.md.
"""

import json
from pathlib import Path
import re
import shlex

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.files.configurations import load_configuration
from dz_ros.identification.plant_prediction import predict
from dz_ros.recording.reader import read_run

ROOT = Path(__file__).parents[2]
LOG = ROOT.parent / 'shared' / 'data' / 'emps_200hz.csv'
DOCUMENT = ROOT / 'docs' / 'real_log.md'
FORCE = 35.15
"""N/V."""
MAP = 'stamp=time_s,x0=position_m,xd0=desired_position_m,v=command_V'
pytestmark = [pytest.mark.slow, pytest.mark.skipif(
    not LOG.exists(), reason=f'{LOG.name} is not beside the package')]


def explained(folder, run):
    """Return the share of the position's variance that the identified plant predicts."""
    return predict(run, load_configuration(str(folder / 'identified.yaml'), [])).explained[0]


@pytest.fixture(scope='module')
def commands(tmp_path_factory):
    """Run the commands of the tutorial; return the folder and what each printed."""
    folder = tmp_path_factory.mktemp('axis')
    patch = pytest.MonkeyPatch()
    patch.chdir(folder)
    (folder / 'log.csv').symlink_to(LOG)
    text = DOCUMENT.read_text(encoding='utf-8')
    blocks = re.findall(r'```sh\n(.*?)```', text, re.DOTALL)
    lines = '\n'.join(blocks).replace('\\\n', ' ').splitlines()
    codes = {line: main(shlex.split(line)[1:]) for line in lines if line.startswith('dz ')}
    yield folder, codes
    patch.undo()


def test_the_commands_of_the_tutorial_run(commands):
    _, codes = commands
    assert len(codes) >= 4
    assert set(codes.values()) == {0}


def test_dead_zone_and_plant_are_those_of_an_independent_least_squares(commands):
    folder, _ = commands
    numbers = json.loads((folder / 'axis-found' / 'identified.json').read_text())
    low, high = (numbers['parameters']['b_r'][key] for key in ('low', 'high'))
    assert low <= 0.51 <= high
    low, high = (numbers['parameters']['b_l'][key] for key in ('low', 'high'))
    assert low <= -0.70 <= high
    b_r, b_l = (numbers['bounds'][f'controller.{name}_bounds'] for name in ('b_r', 'b_l'))
    assert b_r[0] <= 0.51 <= b_r[1]
    assert b_l[0] <= -0.70 <= b_l[1]
    plant = {name: item['value'] for name, item in numbers['plant'].items()}
    mass = 2.0 * FORCE / (plant['b·m_r'] + plant['b·m_l'])
    assert mass == pytest.approx(94.0, abs=3.0)
    assert plant['a1'] * mass == pytest.approx(197.5, abs=15.0)
    assert plant['a3'] * mass == pytest.approx(-3.3, abs=1.0)


def test_the_plant_predicts_the_whole_run_and_a_half_it_has_not_seen(commands, tmp_path):
    folder, _ = commands
    whole = read_run(folder / 'axis-run')
    assert explained(folder / 'axis-found', whole) >= 0.997
    # 20 s of it, the least from which bounds can be had; the rest is predicted.
    text = LOG.read_text(encoding='utf-8').splitlines()
    parts = {'seen': [text[0], *text[1:4101]], 'unseen': [text[0], *text[4101:]]}
    for name, lines in parts.items():
        (tmp_path / f'{name}.csv').write_text('\n'.join(lines), encoding='utf-8')
        assert main(['bag', 'import', str(tmp_path / f'{name}.csv'), '--out',
                     str(tmp_path / name), '--map', MAP, '--config', 'axis']) == 0
    assert main(['driver', 'identify', '--from', str(tmp_path / 'seen'), '--out',
                 str(tmp_path / 'found')]) == 0
    assert explained(tmp_path / 'found', read_run(tmp_path / 'unseen')) >= 0.995
    assert explained(tmp_path / 'found', whole) >= 0.995


def test_the_loop_with_the_plant_tracks_the_trajectory_of_the_file(commands):
    folder, _ = commands
    made = read_run(folder / 'axis-loop')
    # That of the file, not the loop's own, which goes through points of it.
    asked = read_run(folder / 'axis-run').channels['reference']
    reference = np.interp(made.channels['state']['stamp'], asked['stamp'], asked['xd0'])
    error = made.channels['state']['x0'] - reference
    begun = 600     # 3 s: the observed velocity it starts from is wrong, the start is a slow one
    assert np.abs(error[begun:]).max() < 2e-3 * np.ptp(reference)
