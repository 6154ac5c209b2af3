# SPDX-License-Identifier: Apache-2.0
"""`dz bag import`: a log of another tool becomes a run that the other verbs work on."""

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.loop.offline import simulate
from dz_ros.recording.reader import read_run

MAP = 'stamp=ms*ms,x0=angle*deg,xd0=wanted*deg,v=percent/10-0.5'


@pytest.fixture(scope='module')
def log(tmp_path_factory):
    """Return a CSV file of a simulated servo: ms, degrees, and a command in percent, offset."""
    c = Configuration.from_flat({
        'plant.model': 'servo', 'controller.law': 'wang2004', 'loop.duration': 25.0,
        'plant.noise': [1e-5, 0.0], 'plant.x0': [0.1, 0.0], 'controller.lambda': 5.0,
        'plant.dead_zone.m_l': 0.8, 'trajectory.kind': 'multisine',
        'trajectory.amplitudes': [1.0, 0.5], 'trajectory.frequencies': [1.0, 2.7],
        'trajectory.phases': [0.0, 0.0]})
    run = simulate(c)
    path = tmp_path_factory.mktemp('log') / 'log.csv'
    table = np.column_stack([1e3 * run.t, np.degrees(run.x_measured[:, 0]),
                             np.degrees(run.x_d[:, 0]), 10.0 * (run.v + 0.5)])
    np.savetxt(path, table, fmt='%.10g', delimiter=';', header='ms;angle;wanted;percent',
               comments='')
    return path


def imported(log, out, *words):
    return main(['bag', 'import', str(log), '--out', str(out), '--map', MAP, '--config', 'servo',
                 *words])


@pytest.mark.slow
def test_an_imported_log_shows_what_the_device_is(log, tmp_path, capsys):
    run, found = tmp_path / 'run', tmp_path / 'found'
    assert imported(log, run) == 0
    reported = capsys.readouterr().out
    assert 'x0 [rad] = angle*deg' in reported
    assert 'note: x1 is missing: observed from x0' in reported
    assert main(['bag', 'info', str(run)]) == 0
    assert main(['driver', 'identify', '--from', str(run), '--out', str(found)]) in (0, 1)
    capsys.readouterr()
    assert main(['bag', 'whatif', str(run), '--fit', '--out', str(tmp_path / 'page')]) == 0
    values = {line.split()[0]: float(line.split()[1])
              for line in capsys.readouterr().out.splitlines() if ' ± ' in line}
    for name, value in (('b_r', 0.5), ('b_l', -0.6), ('b·m_r', 1.0), ('b·m_l', 0.8), ('a1', 0.4),
                        ('a2', 1.0)):
        assert values[name] == pytest.approx(value, rel=0.1), name


def test_a_run_is_never_overwritten_and_its_configuration_is_kept(log, tmp_path, capsys):
    run = tmp_path / 'run'
    assert imported(log, run, '--set', 'plant.inertia=2') == 0
    data = read_run(run)
    assert data.configuration['plant.inertia'] == 2.0
    assert data.info['mode'] == 'import'
    assert imported(log, run) == 2
    assert 'never overwritten' in capsys.readouterr().err


@pytest.mark.parametrize(('words', 'reported'), [
    (('nowhere.csv', '--map', MAP), 'no such file'),
    (('LOG', '--map', 'stamp=ms,x0=position'), 'begins with no column of the file; these are'),
    (('LOG', '--map', 'stamp=ms*ms,x5=angle'), 'is no signal of a run of order 2'),
    (('LOG', '--map', 'x0=angle'), "--map = 'x0': must name the column of the time"),
    (('LOG', '--map', 'stamp=ms,x0=angle'), 'rows are 5000 ms apart'),
    (('LOG', '--map', 'stamp=ms*ms,v=percent'), 'must name the column of x0'),
    (('LOG', '--map', MAP, '--config', 'nowhere'), 'nowhere'),
])
def test_what_cannot_be_imported_is_one_line(log, tmp_path, capsys, words, reported):
    words = [str(log) if word == 'LOG' else word for word in words]
    out = tmp_path / 'run'
    assert main(['bag', 'import', *words, '--out', str(out), *(
        () if '--config' in words else ('--config', 'servo'))]) == 2
    error = capsys.readouterr().err
    assert reported in error
    assert error.count('\n') == 1
    assert not out.exists()
