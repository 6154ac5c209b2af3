# SPDX-License-Identifier: Apache-2.0
"""The comparison: its scenarios, its cells, its tables and page; the same numbers on any cores.

Over 300 lines: scenarios, cells, tables and page are tested on one comparison, computed once.
"""

import csv
from dataclasses import replace
import importlib
import io
from pathlib import Path
import re

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.loop.offline import simulate
from dz_ros.core.schema import fields
from dz_ros.errors import UnknownNameError
from dz_ros.report.report import write_files
from dz_ros.studies.arena import Arena, Cell, divide, Plan, run_arena
from dz_ros.studies.arena_page import (
    BEATEN,
    beaten,
    compose,
    conditions,
    format_beaten,
    format_text,
    recovery,
    REFERENCE,
    write_arena,
)
from dz_ros.studies.arena_pictures import overview, scatter, unbeaten
from dz_ros.studies.entrants import entrants, IDEAL
from dz_ros.studies.outcome import COLUMNS, row_of, run_row
from dz_ros.studies.scenarios import base_configuration, scenarios, yardstick

DURATION = 6.0


@pytest.fixture(scope='module')
def arena():
    """Return a small comparison without compiling anything."""
    patch = pytest.MonkeyPatch()
    with patch.context() as context:
        context.setattr('dz_ros.core.loop.compiled.available', lambda: False)
        return run_arena(Plan.of([REFERENCE, 'wang2004', 'pd'],
                                 ['nominal', 'noise', 'disturbance pulse'], DURATION, 2), jobs=1)


def test_every_law_that_ships_takes_part():
    laws = {item.changes['controller.law'] for item in entrants().values()}
    # `scheduled` is robust_eso without a measured variable to follow, which the example has not.
    assert laws == {name for name, law in LAWS.builtin.items()
                    if not law.coupled} - {'scheduled'}


LIMITS = ('controller.v_max', 'controller.v_clip')


@pytest.mark.parametrize('scenario', scenarios().values(), ids=lambda item: item.name)
@pytest.mark.parametrize('entrant', entrants().values(), ids=lambda item: item.name)
def test_every_run_can_be_configured(entrant, scenario):
    for member in scenario.members:
        c = Configuration.from_flat({**base_configuration(), **entrant.changes, **member})
        assert set(c.set_aside) <= {*base_configuration(), *LIMITS}


@pytest.mark.parametrize('entrant', entrants().values(), ids=lambda item: item.name)
def test_every_law_has_its_own_gains(entrant):
    c = Configuration.from_changed(base_configuration(), entrant.changes)
    assert c.law.gains == Configuration.from_flat(dict(entrant.changes)).law.gains


def test_laws_with_a_place_for_the_limit_of_the_actuator_have_it():
    limited, = scenarios()['saturation'].members
    silent = {key: value for key, value in limited.items() if key not in LIMITS}
    for entrant in entrants().values():
        with_it, without = (Configuration.from_flat(
            {**base_configuration(), **entrant.changes, **item}).law
            for item in (limited, silent))
        names = {item.name for item in fields(with_it.Gains)}
        place = bool(names & {'v_max', 'v_clip'}) and entrant.name != 'extended'
        assert (with_it.constants != without.constants) == place, entrant.name


def test_the_step_lies_in_the_window():
    member, = scenarios()['step'].members
    assert 50.0 < member['trajectory.t_start'] < 55.0


def test_the_ideal_is_limited_the_example_s_break_points_and_keeps_them():
    for name, changes in ((item.name, item.changes) for item in entrants().values()):
        if name.startswith(IDEAL):
            for member in scenarios()['drift'].members:
                law = Configuration.from_flat({**base_configuration(), **changes, **member}).law
                example = Configuration.from_flat({}).dead_zone
                assert (law.gains.b_r, law.gains.b_l) == (example.b_r, example.b_l)


def test_neither_ours_nor_the_ideal_is_the_best_rival(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    best_rival = importlib.import_module('benchmarks.arena').best_rival
    row = {**dict.fromkeys(COLUMNS), 'lost': 0}
    errors = {'robust': 0.1, 'exact_inverse k=2.5': 0.2, 'neural': 0.3, 'pd': 0.4}
    found = Arena(Plan.of(['pd', 'neural', 'exact_inverse', 'robust'], ['noise']), {
        (name, 'noise'): Cell(({**row, 'error_max': errors.get(name, 0.9)},))
        for name in ('pd', 'neural', 'robust', *(f'exact_inverse k={k}' for k in (0, 1.47, 2.5)))})
    assert found.ranking('noise')[:3] == ['robust', 'exact_inverse k=2.5', 'neural']
    assert best_rival(found, 'noise') == 'neural'


def test_what_the_page_reports_of_its_window(arena):
    assert 'peak |v| over the whole run' in conditions(arena)
    assert ('seed' in conditions(arena).partition(';')[0]) == ('noise' in arena.plan.scenarios)
    window = min(10.0, 0.5 * arena.plan.duration)
    assert f'over the last {window:g} s, of the true state' in conditions(arena)


def test_pulses_lie_in_the_window_and_go_both_ways():
    pulses = [member['plant.disturbance_pulse']
              for member in scenarios()['disturbance pulse'].members]
    assert len(pulses) == 8
    assert {pulse[1] for pulse in pulses} == {20.0, -20.0}
    assert {pulse[2] for pulse in pulses} == {0.05}
    assert all(50.0 < pulse[0] < 58.0 for pulse in pulses)
    apart = np.diff(sorted({pulse[0] for pulse in pulses}))
    assert apart == pytest.approx([np.pi / 2] * 3, abs=0.01)


def test_the_yardstick_is_the_paper_s():
    assert yardstick() == (0.02, 0.04)


def test_a_row_is_what_an_independent_look_at_the_run_reports():
    flat = {**base_configuration(8.0), 'plant.noise': [1e-3, 1e-2]}
    run = simulate(Configuration.from_flat(flat))
    row = run_row(run.configuration, yardstick())
    last = run.t >= 4.0 - 1e-9
    error = run.x[last] - run.x_d[last, :2]     # the true state's, not the measured one's
    assert row['error_max'] == np.abs(error[:, 0]).max()
    assert row['v_variation'] == pytest.approx(np.abs(np.diff(run.v[last])).sum() / 4.0)
    assert row['v_peak_run'] == np.abs(run.v).max()
    assert row['omega'] == np.mean((np.abs(error) <= [0.02, 0.04]).all(axis=1))
    assert row['lost'] == 0
    assert set(row) == set(COLUMNS)


@pytest.mark.parametrize(('changed', 'reason'), [
    ({'controller.lambda': 9.0}, 'diverged|does not follow'),
    ({'controller.lambda': -1.0}, 'refused: controller.lambda'),
    ({'loop.duration': 0.0}, 'too short')])
def test_a_failed_run_is_kept_with_its_reason(changed, reason):
    row = row_of(base_configuration(10.0), changed)
    assert row['lost'] == 1
    assert re.search(reason, row['reason'])


def test_cells_hold_a_row_a_member(arena):
    assert {key: len(cell.rows) for key, cell in arena.cells.items()} == {
        (law, scenario): count for law in (REFERENCE, 'wang2004', 'pd')
        for scenario, count in (('nominal', 1), ('noise', 2), ('disturbance pulse', 8))}
    flats = arena.plan.configurations()
    assert len(flats) == arena.plan.runs == 33
    row = run_row(Configuration.from_flat(flats['wang2004', 'noise', 1]), yardstick())
    assert row == arena.cells['wang2004', 'noise'].rows[1]


def test_where_another_law_is_better_is_a_table(arena):
    assert arena.ranking('nominal') == [REFERENCE, 'wang2004', 'pd']
    rows = beaten(arena)
    assert {len(row) for row in rows} == {len(BEATEN)}
    assert {row[0] for row in rows} <= set(arena.plan.scenarios)
    nominal = {row[1]: row for row in rows if row[0] == 'nominal'}
    assert 'max |x̃|' not in nominal
    row = nominal['TV of v per s']
    assert row[3] == 'pd'
    assert float(row[4]) < float(row[2])
    assert float(row[5]) == pytest.approx(
        arena.cells['pd', 'nominal'].mean('error_max'), rel=1e-3)
    text = format_beaten(arena).splitlines()
    assert len(text) == len(rows) + 2
    assert text[1].split()[0] == 'scenario'


def test_without_the_recommended_law_the_page_gives_no_table_and_reports_why(arena):
    names = ('wang2004', 'pd')
    rest = Arena(replace(arena.plan, entrants={name: arena.plan.entrants[name] for name in names}),
                 {key: cell for key, cell in arena.cells.items() if key[0] in names})
    assert beaten(rest) == []
    assert format_beaten(rest) == ''
    assert f'{REFERENCE}, with which the others are compared, is not among these laws' in compose(
        rest, [])


def test_laws_are_named_where_no_other_has_less_of_both():
    points = {'a': (1.0, 5.0), 'b': (2.0, 2.0), 'c': (5.0, 1.0), 'd': (3.0, 3.0), 'e': (2.0, 6.0)}
    assert unbeaten(points) == {'a', 'b', 'c'}


@pytest.mark.slow
def test_every_law_of_a_subset_is_named_and_no_name_covers_another(arena):
    figure = scatter(arena).figure
    figure.canvas.draw()
    for ax in figure.axes:
        if not ax.get_visible():
            continue
        boxes = [item.get_window_extent() for item in ax.texts]
        assert {item.get_text() for item in ax.texts} == set(arena.plan.entrants)
        assert not [1 for place, box in enumerate(boxes) for other in boxes[:place]
                    if box.overlaps(other)]


def test_the_overview_shows_every_law_in_every_scenario(arena):
    picture = overview(arena)
    texts = [item.get_text() for item in picture.figure.axes[0].texts]
    assert len(texts) == len(arena.plan.entrants) * len(arena.plan.scenarios)
    assert texts.count('1') >= len(arena.plan.scenarios)


def test_a_lost_entrant_comes_last_and_is_reported_to_be_lost(arena):
    gone = {**dict.fromkeys(COLUMNS), 'lost': 1, 'reason': 'diverged', 'error_max': 0.0}
    lost = Arena(arena.plan, {**arena.cells, (REFERENCE, 'nominal'): Cell((gone,))})
    assert lost.ranking('nominal')[-1] == REFERENCE
    assert '1 of 1' in format_text(lost)


def test_recovery_names_the_laws_that_never_did():
    rows = [{'recovery_time': 0.25}, {'recovery_time': 0.75}]
    assert recovery(Cell(tuple(rows))) == '0.5'
    assert recovery(Cell((*rows, {'recovery_time': None}))) == 'never in 1 of 3'


def test_csv_holds_every_run_to_the_last_digit(arena):
    rows = list(csv.DictReader(io.StringIO(arena.csv())))
    assert len(rows) == 33
    for row in rows:
        cell = arena.cells[row['law'], row['scenario']]
        assert float(row['error_max']) == cell.rows[int(row['member'])]['error_max']


def test_the_page_stands_alone_and_names_everything(arena, tmp_path):
    page = write_arena(arena, tmp_path / 'out')
    text = page.read_text(encoding='utf-8')
    assert text.count('data:image/png;base64') == 3
    for name in (*arena.plan.entrants, *arena.plan.scenarios, 'Where another law is better'):
        assert name in text
    assert 'http' not in text
    assert sorted(item.name for item in (tmp_path / 'out').iterdir()) == [
        'arena.csv', 'arena.html', 'best_worst.png', 'error_effort.png', 'overview.png']
    write_files(tmp_path / 'out', {})


@pytest.mark.slow
def test_the_command_line_gives_the_same_numbers_on_two_processes(arena, capsys):
    assert main(['arena', '--laws', f'{REFERENCE},wang2004,pd', '--duration', '6', '--seeds', '2',
                 '--scenarios', 'nominal;noise;disturbance pulse', '-j', '2', '--csv',
                 '--quiet']) == 0
    assert capsys.readouterr().out == arena.csv()


def test_progress_counts_runs(monkeypatch):
    monkeypatch.setattr('dz_ros.core.loop.compiled.available', lambda: False)
    seen = []
    run_arena(Plan.of(['pd', 'pid'], ['nominal'], 2.0), jobs=1,
              progress=lambda *words: seen.append(words))
    assert [words[:2] for words in seen] == [(1, 2), (2, 2)]
    assert {words[2] for words in seen} == {'pd', 'pid'}


@pytest.mark.parametrize('jobs', [1, 2, 7, 64])
@pytest.mark.parametrize('laws', [['robust'], ['pd', 'robust', 'pid'], None])
def test_every_process_has_work_and_every_run_is_done_once(jobs, laws):
    plan = Plan.of(laws, None, DURATION, 3)
    pieces = divide(plan, jobs)
    runs = plan.runs // len(plan.entrants)
    assert sorted((name, run) for name, begin, end in pieces for run in range(begin, end)) == [
        (name, run) for name in sorted(plan.entrants) for run in range(runs)]
    assert len(pieces) >= min(plan.runs, 3 * jobs)
    assert all(begin < end for _, begin, end in pieces)


@pytest.mark.slow
def test_one_law_is_divided_among_processes_and_shows_how_far_it_is():
    seen = []
    found = run_arena(Plan.of(['pd'], ['nominal', 'noise', 'disturbance pulse'], 2.0, 3), jobs=2,
                      progress=lambda *words: seen.append(words))
    assert len(seen) >= 6
    assert [words[0] for words in seen] == sorted({words[0] for words in seen})
    assert seen[-1][:2] == (12, 12)
    alone = run_arena(found.plan, jobs=1)
    assert alone.csv() == found.csv()


def test_nonsense_is_one_line(capsys):
    for words in (('--laws', 'no_such_law'), ('--scenarios', 'flood'), ('--seeds', '0'),
                  ('--duration', 'nan'), ('-j', '-1')):
        assert main(['arena', *words]) == 2
        assert capsys.readouterr().err.count('\n') == 1
    with pytest.raises(UnknownNameError, match='known: robust'):
        Plan.of(['no_such_law'])


def test_list(capsys):
    assert main(['arena', '--list', '--laws', 'exact_inverse', '--scenarios', 'drift']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[:20].strip() for line in lines] == [
        'exact_inverse k=0', 'exact_inverse k=1.47', 'exact_inverse k=2.5', 'drift']
