# SPDX-License-Identifier: Apache-2.0
"""Retuned laws: equal budgets, hard limits, kept searches, tables that name the winner."""

from dataclasses import replace
import json
import math
from pathlib import Path
import re

import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.core.schema import fields
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import load_configuration
from dz_ros.studies.entrants import entrants
from dz_ros.studies.outcome import row_of
from dz_ros.studies.retune import (
    ALL,
    Conditions,
    effort_of,
    evaluate,
    Found,
    limits_of,
    margins,
    place_of,
    ranks,
    read,
    retune,
    scaled,
    score_of,
    search,
)
from dz_ros.studies.retune_page import best_of, errors_table, margins_table, summary, table
from dz_ros.studies.scenarios import base_configuration, scenarios

DURATION = 6.0


@pytest.mark.parametrize('name', LAWS.builtin)
def test_free_gains_exist_and_their_ends_are_allowed(name):
    law = LAWS.load(name)
    known = {item.name for item in fields(law.Gains)}
    assert law.tunable
    for item in law.tunable:
        assert item.key in known
        assert 0.0 < item.low < item.high
        for value in (item.low, item.high):
            Configuration.from_flat({'controller.law': name, f'controller.{item.key}': value})


def test_the_unit_cube_is_the_range():
    entrant = entrants()['ladrc']
    law = LAWS.load('ladrc')
    for share, end in ((0.0, 'low'), (1.0, 'high')):
        found = scaled(entrant, [share] * len(law.tunable))
        for item in law.tunable:
            assert found[f'controller.{item.key}'] == pytest.approx(getattr(item, end))


def test_the_place_of_gains_is_where_they_are_scaled_from():
    entrant = entrants()['robust_eso']
    shipped = scaled(entrant, place_of(entrant))
    assert shipped['controller.lambda'] == pytest.approx(10.0)
    assert shipped['controller.observer_rate'] == pytest.approx(50.0)
    beyond = {**shipped, 'controller.lambda': 1e6}
    assert place_of(entrant, beyond)[0] == 1.0


def test_limits_are_hard():
    good, _ = score_of([(1e-3, 4.0, 5.0)], 10.0, 8.0)
    best, _ = score_of([(1e-9, 4.0, 10.1)], 10.0, 8.0)
    worse, _ = score_of([(1e-9, 20.0, 5.0)], 10.0, 8.0)
    lost, error = score_of([(1e-3, 4.0, 5.0), None], 10.0, 8.0)
    assert good < best < worse < lost
    assert math.isinf(error)


def test_effort_is_that_of_the_comparison():
    base = base_configuration(DURATION)
    changes = {'controller.law': 'robust_eso'}
    row = row_of(base, changes)
    assert effort_of(base, changes) == (row['error_max'], row['v_variation'], row['v_peak_run'])
    assert effort_of(base, {**changes, 'controller.lambda': -1.0}) is None


def test_chatter_under_delay_is_no_measure_of_effort():
    names = ('nominal', 'b=2, delay 1')
    known = scenarios(DURATION)
    base = base_configuration(DURATION)
    paper = {'controller.law': 'wang2004'}
    chatter = effort_of(base, {**paper, **known['b=2, delay 1'].members[0]})[1]
    limits = limits_of({name: known[name] for name in names}, DURATION)
    assert chatter > 100.0
    assert limits['b=2, delay 1'][1] < 0.2 * chatter


def test_a_law_with_a_place_for_the_limit_is_given_it():
    entrant = entrants()['ladrc 2']
    conditions = Conditions.full(['ω = 3'], DURATION, 1)
    gains = scaled(entrant, place_of(entrant, {
        'controller.lambda': 30.0, 'controller.observer_rate': 60.0,
        'controller.input_gain': 1.0}))
    found = evaluate(entrant, gains, conditions, 'ω = 3', 0)
    assert 16.7 < found.peak <= conditions.limits['ω = 3'][0]


def test_searches_are_kept_and_not_made_again(tmp_path, monkeypatch):
    path = tmp_path / 'searches.jsonl'
    laws = {name: entrants()[name] for name in ('pd', 'ladrc')}
    first = retune(laws, ['nominal'], path, DURATION, 1, 1, 12, jobs=1)
    assert len(path.read_text().splitlines()) == 4
    monkeypatch.setattr('dz_ros.studies.retune.search', None)
    assert retune(laws, ['nominal'], path, DURATION, 1, 1, 12, jobs=1) == first
    assert {item.scenario for item in first} == {'nominal', ALL}
    limits = limits_of({'nominal': scenarios(DURATION)['nominal']}, DURATION)['nominal']
    for item in best_of(first).values():
        if item.score < 10.0:
            assert item.peak <= limits[0] * (1.0 + 1e-6)
            assert item.variation <= limits[1] * (1.0 + 1e-6)
    with pytest.raises(ConfigurationError, match='holds searches of a budget of 12'):
        retune(laws, ['nominal'], path, DURATION, 1, 1, 13, jobs=1)
    path.write_text('{"law": 1}\n')
    with pytest.raises(ConfigurationError, match='not a file of searches'):
        read(path)


def test_a_search_is_never_worse_than_the_gains_as_shipped():
    entrant = entrants()['disturbance_observer']
    conditions = Conditions.full(['nominal'], DURATION, 1)
    shipped = evaluate(entrant, {}, conditions, 'nominal', 0)
    found = search(entrant, 'nominal', conditions, conditions, 0, 12)
    assert found.score <= shipped.score + 1e-6      # gains scaled there and back
    assert found.errors['nominal'] == pytest.approx(found.error)


def test_a_search_goes_on_where_the_best_candidates_are_beyond_a_limit(monkeypatch):
    """The first six in full fail, and so does what the search began with."""
    entrant = entrants()['pd']
    conditions = Conditions.full(['nominal'], DURATION, 1)
    in_full = []

    def judged(entrant, gains, conditions_, name, seed):
        trial = conditions_ is not conditions
        if not trial:
            in_full.append(gains)
        score = gains['controller.k_d'] if trial or len(in_full) > 6 else 11.0
        return Found('pd', name, seed, gains, score, 1.0, 1.0, 1.0, errors={name: 1.0})

    monkeypatch.setattr('dz_ros.studies.retune.evaluate', judged)
    trial = Conditions.trial(['nominal'], DURATION, 1)
    found = search(entrant, 'nominal', trial, conditions, 0, 40)
    assert found.score < 11.0
    assert in_full[6]['controller.k_d'] > in_full[5]['controller.k_d']
    assert len(in_full) == 8        # and what it began with


def test_candidates_far_down_the_list_are_run_in_full_where_the_best_ones_fail():
    found = ranks(200)
    assert found[:7] == [0, 1, 2, 3, 4, 5, 7]
    assert found[-1] == 199
    assert found == sorted(set(found))
    assert len(found) <= 20
    assert ranks(3) == [0, 1, 2]


def test_table_names_the_best_and_the_distance():
    one = Found('robust_eso', 'nominal', 0, {}, math.log(3e-4), 3e-4, 6.0, 5.0, (4.4, 2.1), 1)
    other = replace(one, law='ladrc', score=math.log(6e-4), error=6e-4)
    beyond = replace(one, law='pid', score=10.5, error=1e-5)
    lines = table([one, other, beyond])
    assert '| **`robust_eso`** | yes |' in lines[-1]
    assert '| 2.00 |' in lines[-1]
    assert 'pid' not in lines[-1]
    assert 'none within the limits' in table([beyond])[-1]
    assert len({len(re.split(r'(?<!\\)\|', line)) for line in [*lines, *table([beyond])]}) == 1
    assert summary([one, other, beyond]) == [
        'With gains tuned for each scenario `robust_eso` has the smallest error in 1 of 1 '
        'scenarios.']
    better = replace(other, error=1e-4, score=math.log(1e-4))
    assert '| no |' in table([one, better])[-1]
    assert '| 3.00 |' in table([one, better])[-1]
    assert summary([one, better])[0].endswith('; another law is better in 1:')
    assert summary([one, better])[-1] == '| nominal | `ladrc` | 3.00 |'
    assert summary([replace(beyond, law='robust_eso'), better])[-1] == (
        '| nominal | `ladrc` | beyond a limit |')
    everywhere = [replace(item, scenario=ALL, errors={'nominal': item.error})
                  for item in (one, other)]
    lines = margins_table([one, replace(other, delay=-1, beta=(1.0, 0.5)), beyond])
    assert lines[0] == '| scenario | `robust_eso` | `ladrc` | `pid` |'
    assert lines[-1] == '| nominal | 4.40, 2.10; 1 | 1.00, 0.50; none | 4.40, 2.10; 1* |'
    assert errors_table(everywhere)[-1] == '| nominal | **0.0003** | 0.0006 |'


def test_margins_are_those_of_the_matrix():
    c = Configuration.from_flat({'controller.law': 'robust_eso'})
    (free, late), delay = margins(c)
    assert (free, late) == (pytest.approx(4.44, abs=0.02), pytest.approx(2.08, abs=0.02))
    assert delay == 1
    assert margins(Configuration.from_flat({'controller.law': 'neural'}))[1] >= -1


def test_margins_have_the_observer_of_the_velocity():
    c = load_configuration('robust_eso', ['driver.measured=1'])
    (_, late), _ = margins(c)
    assert late == pytest.approx(1.034, abs=0.002)


def test_verb_prints_both_tables(tmp_path, capsys):
    words = ['arena', '--retune', str(tmp_path / 'x.jsonl'), '--laws', 'pd', '--scenarios',
             'nominal', '--budget', '4', '--searches', '1', '--duration', '4', '--quiet']
    assert main(words) == 0
    assert '| nominal |' in capsys.readouterr().out
    assert json.loads((tmp_path / 'x.jsonl').read_text().splitlines()[0])['law'] == 'pd'
    assert main([*words, '--budget', '0']) == 2


def test_the_readme_reports_what_the_table_reports():
    root = Path(__file__).parents[2]
    reported = '\n'.join(summary(list(read(root / 'benchmarks' / 'retuned.jsonl').values())))
    assert reported in (root / 'docs' / 'arena.md').read_text()
    readme = ' '.join((root / 'README.md').read_text().split())
    best, count = map(int, re.search(r'smallest error in (\d+) of (\d+) scenarios',
                                     reported).groups())
    better = int(re.search(r'another law is better in (\d+)', reported)[1])
    times = sorted(map(float, re.findall(r'` \| ([\d.]+) \|', reported)))
    assert f'for all {count} scenarios' in readme
    assert f'best in {best}; another law is better in {better}' in readme
    assert round(times[0], 1) == float(re.search(r'by ([\d.]+) to', readme)[1])
    assert round(times[-1], 1) == float(re.search(r'by [\d.]+ to ([\d.]+) times', readme)[1])
