# SPDX-License-Identifier: Apache-2.0
"""Sweeps: their points, their file that survives being cut, their maps, their cluster."""

import csv
from itertools import islice
import tracemalloc

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError, DzRosError, RunExistsError
from dz_ros.studies import sweep as module
from dz_ros.studies import sweep_plan
from dz_ros.studies.outcome import row_of
from dz_ros.studies.sweep import read_sweep, run_sweep
from dz_ros.studies.sweep_pictures import crossing
from dz_ros.studies.sweep_plan import Axis, parse_axes, SweepPlan

BASE = Configuration.from_flat({'loop.duration': 2.0, 'plant.substeps': 1,
                                'plant.noise': [0.0, 0.0]}).to_flat()


def plan_of(*axes, **settings):
    return SweepPlan(BASE, parse_axes(axes), **settings)


def test_a_grid_is_every_combination():
    points = plan_of('controller.epsilon=0.01:0.03:3', 'loop.delay=0,1').points()
    assert list(points) == [{'controller.epsilon': epsilon, 'loop.delay': delay}
                            for epsilon in np.linspace(0.01, 0.03, 3).tolist() for delay in (0, 1)]


def test_equal_ratios_include_both_ends():
    values = list(Axis.parse('controller.epsilon=0.005:0.5:5:log').grid())
    assert values[0] == pytest.approx(0.005)
    assert values[-1] == pytest.approx(0.5)
    assert np.ptp(np.diff(np.log(values))) < 1e-12


@given(st.floats(1e-3, 10.0), st.floats(1.0, 50.0), st.booleans(), st.floats(0.0, 0.999))
def test_every_sample_lies_on_its_axis(low, ratio, log, share):
    axis = Axis('k', low, low * ratio, 2, log)
    assert low * (1 - 1e-12) <= axis.at(share) <= low * ratio * (1 + 1e-12)


@pytest.mark.parametrize('sampler', ['random', 'sobol'])
def test_samples_follow_the_seed(sampler):
    axes = ('plant.b=0.5:2:2', 'controller.law=wang2004,robust')
    first, again, other = (list(plan_of(*axes, sampler=sampler, samples=37, seed=seed).points())
                           for seed in (1, 1, 2))
    assert first == again
    assert first != other
    assert len(first) == 37
    assert {point['controller.law'] for point in first} == {'wang2004', 'robust'}
    assert all(0.5 <= point['plant.b'] <= 2.0 for point in first)


def test_sobol_fills_the_line_more_evenly_than_chance():
    def gap(sampler):
        points = plan_of('plant.b=0:1:2', sampler=sampler, samples=64).points()
        return np.diff(np.sort([point['plant.b'] for point in points])).max()
    assert gap('sobol') < 2.0 / 64 < gap('random')


@pytest.mark.parametrize('sampler', ['random', 'sobol'])
def test_points_drawn_in_blocks_are_those_drawn_in_one_piece(sampler, monkeypatch):
    plan = plan_of('plant.b=0:1:2', 'plant.a1=0:1:2', sampler=sampler, samples=700, seed=5)
    monkeypatch.setattr(sweep_plan, 'BLOCK', 64)
    drawn = np.array([list(point.values()) for point in plan.points()])
    if sampler == 'random':
        whole = np.random.default_rng(5).random((700, 2))
    else:
        whole = pytest.importorskip('scipy.stats').qmc.Sobol(2, seed=5).random(1024)[:700]
    assert np.array_equal(drawn, whole)


@pytest.mark.parametrize(('axes', 'most'), [
    (('plant.b=1:2:3162', 'plant.a1=1:2:3162'), 2e6),
    (('plant.b=1:2:2000000',), 40e6)])      # 8 bytes a value, while they are spread twice that
def test_points_are_made_as_they_are_asked_for(axes, most):
    plan = plan_of(*axes)
    plan.check()
    tracemalloc.start()
    try:
        for _ in islice(plan.points(), 20000):
            pass
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def test_one_number_of_an_array():
    plan = plan_of('plant.noise[1]=0,0.01', 'plant.dead_zone.b_r_drift[0]=0.1,0.2')
    assert plan.changes(list(plan.points())[3]) == {'plant.noise': [0.0, 0.01],
                                                    'plant.dead_zone.b_r_drift': [0.2, 0.0]}


@pytest.mark.parametrize(('axes', 'settings', 'words'), [
    ((), {}, 'at least one key'), (('plant.b=1,2', 'plant.b=3,4'), {}, 'each once'),
    (('plant.nonsense=1,2',), {}, 'unknown key'), (('plant.x0[7]=1,2',), {}, 'no such element'),
    (('plant.b=1:2:3',), {'sampler': 'random'}, '--samples'),
    (('plant.b=1:2:9999', 'plant.a1=1:2:9999'), {}, 'too many')])
def test_what_cannot_be_swept_is_refused(axes, settings, words):
    with pytest.raises(DzRosError, match=words):
        plan_of(*axes, **settings).check()


@pytest.mark.parametrize('text', ['', 'plant.b', '=1:2:3', 'plant.b=1:2', 'plant.b=1:2:3:lin',
                                  'plant.b=a:b:c', 'plant.b=2:1:3', 'plant.b=0:1:3:log',
                                  'plant.b=1:nan:3', 'plant.b=1:2:0', 'plant.b='])
def test_what_is_no_axis_is_refused(text):
    with pytest.raises(ConfigurationError, match=r'--over|must be'):
        Axis.parse(text)


def test_rows_are_those_of_single_runs_in_order(tmp_path):
    plan = plan_of('controller.epsilon=0.01:0.05:3')
    assert run_sweep(plan, tmp_path / 's.csv', 1) == 0
    rows = read_sweep(tmp_path / 's.csv')
    assert [row['run'] for row in rows] == [0, 1, 2]
    for row, point in zip(rows, plan.points(), strict=True):
        single = row_of(BASE, point)
        assert {name: row[name] or None for name in single} == {
            name: value or None for name, value in single.items()}


def test_failed_runs_are_kept_with_their_reason(tmp_path):
    lost = run_sweep(plan_of('controller.lambda=1,-1,300'), tmp_path / 's.csv', 1)
    rows = read_sweep(tmp_path / 's.csv')
    assert lost == 2
    assert [row['lost'] for row in rows] == [0, 1, 1]
    assert rows[1]['reason'].startswith('refused: controller.lambda')
    assert rows[2]['reason'].startswith(('diverged', 'does not follow'))


BRITTLE = """
from dz_ros.core.plants.wang2004 import Wang2004


class Brittle(Wang2004):
    name = 'brittle'

    def __init__(self, parameters=None):
        super().__init__(parameters)
        if self.parameters.b > 3.0:
            raise KeyError('b')

    @staticmethod
    def regressors(x, p, y):
        if p[1] > 1.5:
            raise TypeError('no such\\n' + 'thing, ' * 200)
        y[0] = y[1] = 0.0
"""
"""A plant of a user's own, with mistakes in it."""


@pytest.mark.parametrize('jobs', [1, 2])
def test_what_a_plant_of_one_s_own_raises_costs_its_run_only(tmp_path, monkeypatch, jobs):
    (tmp_path / 'brittle.py').write_text(BRITTLE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(module, 'CHUNK', 1)
    base = {**BASE, 'plant.model': 'brittle:Brittle'}
    plan = SweepPlan(base, parse_axes(['plant.a1=1,2', 'plant.b=1,4']))
    assert run_sweep(plan, tmp_path / 's.csv', jobs) == 3
    rows = read_sweep(tmp_path / 's.csv')
    assert [row['lost'] for row in rows] == [0, 1, 1, 1]
    assert [(row['reason'] or '')[:18] for row in rows] == [
        '', 'refused: plant.mod', 'failed: TypeError:', 'refused: plant.mod']
    assert 'cannot be made: KeyError' in rows[1]['reason']
    assert rows[0]['error_max'] > 0.0
    if jobs == 1:       # not compiled: the message is the plant's own
        assert rows[2]['reason'].startswith('failed: TypeError: no such thing, thing,')
    assert len(rows[2]['reason']) < 320


@pytest.mark.slow
@pytest.mark.parametrize('kept', [0.0, 0.02, 0.4, 0.63, 0.99, 1.0])
def test_a_sweep_goes_on_from_wherever_it_was_cut(tmp_path, kept, monkeypatch):
    monkeypatch.setattr(module, 'CHUNK', 2)
    plan = plan_of('controller.epsilon=0.01:0.05:5')
    whole, cut = tmp_path / 'whole.csv', tmp_path / 'cut.csv'
    run_sweep(plan, whole, 1)
    content = whole.read_bytes()
    cut.write_bytes(content[:int(kept * len(content))])
    seen = []
    run_sweep(plan, cut, 1, resume=seen.append)
    assert cut.read_bytes() == content
    assert seen == [max(0, content[:int(kept * len(content))].count(b'\n') - 2)]


def test_another_sweep_s_file_is_refused(tmp_path):
    out = tmp_path / 's.csv'
    run_sweep(plan_of('controller.epsilon=0.02,0.03'), out, 1)
    before = out.read_bytes()
    with pytest.raises(ConfigurationError, match='holds another sweep'):
        run_sweep(plan_of('controller.epsilon=0.02,0.04'), out, 1)
    assert out.read_bytes() == before
    strange = tmp_path / 'letter.csv'
    strange.write_text('dear reader\n')
    with pytest.raises(ConfigurationError, match='not the file of a sweep'):
        run_sweep(plan_of('controller.epsilon=0.02,0.04'), strange, 1)
    assert strange.read_text() == 'dear reader\n'


def test_parquet_holds_the_same_rows(tmp_path):
    pytest.importorskip('pyarrow', reason='pyarrow is not installed: no Parquet')
    plan = plan_of('controller.epsilon=0.02,0.03', 'controller.lambda=1,-1')
    run_sweep(plan, tmp_path / 's.csv', 1)
    run_sweep(plan, tmp_path / 's.parquet', 1)
    for a, b in zip(read_sweep(tmp_path / 's.csv'), read_sweep(tmp_path / 's.parquet'),
                    strict=True):
        assert {k: v or None for k, v in a.items()} == {k: v or None for k, v in b.items()}
    assert sorted(item.name for item in tmp_path.iterdir()) == ['s.csv', 's.parquet']
    with pytest.raises(RunExistsError):
        run_sweep(plan, tmp_path / 's.parquet', 1)


@pytest.mark.slow
def test_two_processes_give_the_file_of_one(tmp_path, monkeypatch):
    monkeypatch.setattr(module, 'CHUNK', 2)
    plan = plan_of('controller.epsilon=0.01:0.05:6')
    run_sweep(plan, tmp_path / 'one.csv', 1)
    run_sweep(plan, tmp_path / 'two.csv', 2)
    assert (tmp_path / 'one.csv').read_bytes() == (tmp_path / 'two.csv').read_bytes()


@pytest.mark.slow
def test_the_measured_boundary_is_the_predicted_one(tmp_path):
    base = {**BASE, 'loop.duration': 8.0, 'loop.delay': 1}
    plan = SweepPlan(base, parse_axes(['controller.epsilon=0.0105:0.0165:13']))
    run_sweep(plan, tmp_path / 's.csv', 1)
    rows = read_sweep(tmp_path / 's.csv')
    x = np.array([row['controller.epsilon'] for row in rows])
    predicted = crossing(x, np.array([row['chatter_share'] for row in rows]), 1.0)
    measured = crossing(x, np.array([row['v_variation'] for row in rows]), 40.0)
    assert predicted == pytest.approx(0.0132, abs=5e-4)
    assert measured == pytest.approx(predicted, rel=0.05)


@pytest.mark.slow
def test_the_command_line_runs_and_draws(tmp_path, capsys):
    out = tmp_path / 's.csv'
    words = ['sweep', 'wang2004', '--over', 'controller.epsilon=0.01:0.1:4:log', '--duration', '1',
             '--out', str(out), '-j', '1', '--quiet']
    assert main(words) == 0
    assert '4 runs, 0 of them lost' in capsys.readouterr().out
    assert main(words) == 0                 # all done: nothing is run again
    with out.open() as file:
        assert len(list(csv.reader(file))) == 6
    assert main(['sweep', 'plot', str(out)]) == 0
    assert (tmp_path / 's-maps' / 'sweep_controller_epsilon.png').stat().st_size > 10000


@pytest.mark.parametrize('words', [
    ('--over', 'plant.b=1,2'), ('--over', 'plant.b=1,2', '--out', 's.txt'),
    ('--over', 'plant.b=1,2', '--out', 'nowhere/s.csv'), ('--out', 's.csv'),
    ('--over', 'plant.b=1,2', '--out', 's.csv', '-j', '-2'),
    ('--over', 'plant.b=1,2', '--out', 's.csv', '--duration', '0')])
def test_nonsense_is_one_line_and_leaves_no_file(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(['sweep', 'wang2004', *words]) == 2
    assert capsys.readouterr().err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_plot_of_nothing(tmp_path, capsys):
    assert main(['sweep', 'plot']) == 2
    assert main(['sweep', 'plot', str(tmp_path / 'none.csv')]) == 2
    assert 'no such file' in capsys.readouterr().err


def test_a_finished_sweep_is_put_in_order_whatever_the_order_of_its_rows(tmp_path):
    plan, out = plan_of('controller.epsilon=0.01:0.05:5'), tmp_path / 's.csv'
    run_sweep(plan, out, 1)
    content = out.read_bytes()
    head, rows = content.splitlines(True)[:2], content.splitlines(True)[2:]
    out.write_bytes(b''.join([*head, *(rows[place] for place in (3, 0, 4))]))
    seen = []
    run_sweep(plan, out, 1, resume=seen.append)
    assert seen == [3]
    assert out.read_bytes() == content
