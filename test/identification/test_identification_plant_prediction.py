# SPDX-License-Identifier: Apache-2.0
"""What a plant predicts of a recording by its commands alone."""

from dataclasses import replace
import json
import math

import numpy as np
import pytest

from dz_ros.cli.bag.predict import percent
from dz_ros.cli.main import main
from dz_ros.core.dataset import Channel
from dz_ros.core.dataset import from_run as recorded
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import RecordingError
from dz_ros.files.configurations import load_configuration
from dz_ros.identification.plant_prediction import predict, Prediction, with_own_constant
from dz_ros.recording.save import save_run


def made(name, *overrides):
    """Return a configuration that measures exactly, and an offline run of it."""
    c = load_configuration(name, ['loop.duration=12.0', *overrides])
    c = c.replace(**{'plant.noise': [0.0] * c.plant.order, 'plant.resolution': 0.0,
                     'plant.derivative_resolution': []})
    return c, recorded(simulate(c), 10 ** 18)


def without_states(run, begin, end):
    """Return a run some of whose states are lost."""
    old = run.channels['state']
    keep = np.ones(len(old), dtype=bool)
    keep[begin:end] = False
    return replace(run, channels={**run.channels, 'state': Channel(
        old.labels, old.values[keep], old.log_time[keep], old.publish_time[keep])})


@pytest.mark.parametrize(('name', 'overrides'), [
    ('wang2004', ()), ('wang2004', ('loop.delay=2',)), ('servo', ()), ('thruster', ()),
    ('servo', ('plant.dead_zone.b_r_drift=[0.1, 0.7]',)), ('axis', ('driver.measured=1',)),
    ('first_order', ())], ids=str)
def test_the_plant_that_was_simulated_is_predicted(name, overrides):
    c, run = made(name, *overrides)
    found = predict(run, c)
    assert found.starts == (0,)
    assert found.lost == 0
    assert found.measured.shape[1] == c.make_driver().measured
    if found.measured.shape[1] == c.plant.order:
        assert found.predicted == pytest.approx(found.measured, abs=1e-9)
    assert all(share > 0.99 for share in found.explained)


def test_each_part_begins_with_what_was_measured():
    c, run = made('servo')
    found = predict(run, c, 1.0)
    assert len(found.starts) == 12
    assert found.predicted[list(found.starts)] == pytest.approx(
        found.measured[list(found.starts)])
    wrong = c.replace(**{'plant.viscous_friction': 0.1})
    once, often = predict(run, wrong), predict(run, wrong, 1.0)
    assert often.rms[0] < once.rms[0]
    assert once.explained[0] < 0.999


def test_a_hole_begins_a_part_and_short_parts_are_counted():
    c, run = made('servo')
    found = predict(without_states(without_states(run, 1004, 1010), 1000, 1001), c)
    assert len(found.starts) == 2
    assert found.lost == 3
    assert found.predicted == pytest.approx(found.measured, abs=1e-9)


@pytest.mark.parametrize('lost', [(0, 1000), (990, 1000)])
def test_a_part_begins_with_the_slope_of_its_own_samples(lost):
    c, run = made('axis', 'driver.measured=1')
    run = without_states(without_states(run, 1010, 1040), *lost)    # 1000 to 1009 stay
    found = predict(run, c)
    begin = np.flatnonzero(np.isclose(found.t, 5.0))[0]
    assert begin in found.starts
    part = slice(begin, begin + 10)
    assert found.predicted[part] == pytest.approx(found.measured[part], abs=2e-5)


def test_what_does_not_move_has_no_share_and_what_moves_little_has():
    t = np.arange(5.0)
    still = np.full((5, 1), 0.1)
    assert math.isnan(Prediction(t, still, still, (0,), 0).explained[0])
    small = 1e-200 * t[:, np.newaxis]
    assert Prediction(t, small, small, (0,), 0).explained == (1.0,)


def test_the_constant_force_of_a_recording_is_found():
    c, run = made('axis', 'plant.constant_force=-3.0')
    other = c.replace(**{'plant.constant_force': -4.0})
    whole = predict(run, other)
    changed, number = with_own_constant(run, other)
    assert number == 3
    assert changed.to_flat()['plant.constant_force'] == pytest.approx(-3.0, rel=1e-3)
    assert predict(run, changed).explained[0] > whole.explained[0]


def test_a_plant_without_a_constant_term_has_none_of_its_own():
    c, run = made('wang2004')
    assert with_own_constant(run, c) is None


def test_a_plant_that_diverges_explains_nothing():
    c, run = made('axis')
    found = predict(run, c.replace(**{'plant.viscous_friction': 1e9}))
    assert found.explained[0] == -math.inf
    assert found.rms[0] == math.inf
    assert percent(found.explained[0]) == 'diverges'


def test_another_rate_and_no_states_are_refused():
    c, run = made('servo')
    with pytest.raises(RecordingError, match='5 ms apart'):
        predict(run, c.replace(**{'loop.rate': 100.0}))
    with pytest.raises(RecordingError, match='needs states and commands'):
        predict(replace(run, channels={}), c)
    with pytest.raises(RecordingError, match='10 states in a row'):
        predict(without_states(run, 5, 10 ** 6), c)


@pytest.mark.parametrize(('share', 'text'), [
    (1.0, '100.00 %'), (0.9985, '99.85 %'), (0.99966, '99.966 %'), (0.999999, '99.99990 %'),
    (-1.5, '-150.00 %'), (-5.3e30, '-5.3e+32 %'), (math.nan, 'it does not move')])
def test_a_share_has_the_digits_that_count(share, text):
    assert percent(share) == text


@pytest.fixture
def saved(tmp_path):
    """Return the folder of a run of a servo."""
    save_run(made('servo')[1], tmp_path / 'run')
    return tmp_path / 'run'


def test_the_verb_prints_what_is_explained_and_draws_it(saved, tmp_path, capsys):
    picture = tmp_path / 'new.png'
    assert main(['bag', 'predict', str(saved), '--picture', str(picture)]) == 0
    out = capsys.readouterr().out
    assert 'plant servo of the run itself' in out
    assert '100.00 %' in next(row for row in out.splitlines() if row.startswith('once'))
    assert picture.read_bytes().startswith(b'\x89PNG')
    assert main(['bag', 'predict', str(saved), '--config', 'servo', '--set',
                 'plant.viscous_friction=0.1']) == 0
    once = next(row for row in capsys.readouterr().out.splitlines() if row.startswith('once'))
    assert '100.00 %' not in once
    assert main(['bag', 'predict', str(saved), '--config', 'wang2004']) == 0
    assert ('note: states of plant wang2004 are in 1, 1/s, those of the run in rad, rad/s'
            in capsys.readouterr().out)


@pytest.mark.slow
def test_the_numbers_as_json(saved, tmp_path, capsys):
    picture = tmp_path / 'x.png'
    assert main(['bag', 'predict', str(saved), '--json', '--picture', str(picture)]) == 0
    once, *parts = (found := json.loads(capsys.readouterr().out))['begun']
    assert once['every_s'] is None
    assert [item['every_s'] for item in parts] == [5.0, 1.0]
    assert once['explained'][0] == pytest.approx(1.0, abs=1e-6)
    assert found['units'] == ['rad', 'rad/s']
    assert found['own_constant'] is None
    assert picture.exists()
    run = tmp_path / 'pushed'
    save_run(made('axis', 'plant.constant_force=-3.0')[1], run)
    assert main(['bag', 'predict', str(run), '--set', 'plant.constant_force=-4.0', '--json']) == 0
    own = json.loads(capsys.readouterr().out)['own_constant']
    assert own['changed']['plant.constant_force'] == pytest.approx(-3.0, rel=1e-3)
    assert own['explained'][0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(('words', 'reported'), [
    (['--picture', '{run}/run.mcap'], 'exists already'),
    (['--config', 'two_link_arm', '--axis', 'shoulder'], 'moves several axes'),
    (['--config', 'first_order'], 'order 1'),
    (['--config', 'nothing'], 'nothing'),
    (['--config', '{run}/bounds.yaml'], 'must have a section plant'),
    (['--picture', '{run}/none/x.png'], 'no such directory')])
def test_what_cannot_be_predicted_is_refused_in_one_line(saved, capsys, words, reported):
    (saved / 'run.mcap').touch()
    (saved / 'bounds.yaml').write_text('controller: {b_bounds: [1.0, 2.0]}\n')
    assert main(['bag', 'predict', str(saved), *(word.format(run=saved) for word in words)]) != 0
    err = capsys.readouterr().err.strip().splitlines()
    assert reported in err[-1]
    assert not any('Traceback' in row for row in err)
