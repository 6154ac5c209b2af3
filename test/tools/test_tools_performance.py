# SPDX-License-Identifier: Apache-2.0
"""The benchmarks judge rightly, and their peers compute the same loop."""

from dataclasses import replace
from pathlib import Path
import shutil
import sys

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks import performance  # noqa: E402
from benchmarks.speed_kit import peers, running  # noqa: E402
from benchmarks.speed_kit.profile_of_a_node import functions  # noqa: E402
from benchmarks.speed_kit.rows import (  # noqa: E402
    in_turns,
    interval,
    markdown,
    Row,
    show,
    spread,
)
from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.dataset import Channel, from_run  # noqa: E402
from dz_ros.core.loop.offline import simulate  # noqa: E402


@pytest.fixture(scope='module')
def paper():
    return Configuration.from_flat({'loop.duration': 2.0})


@pytest.mark.parametrize(('value', 'target', 'least', 'met'), [
    (1.1, 1.15, False, True), (1.2, 1.15, False, False), (26.0, 25.0, True, True),
    (24.9, 25.0, True, False), (0.0, 0.0, False, True), (99.0, None, False, True)])
def test_a_row_knows_whether_it_is_met(value, target, least, met, capsys):
    row = Row('speed', value, target, least=least)
    assert row.met is met
    assert show([row]) == (not met)
    assert ('MISSED' in capsys.readouterr().out) is not met


@pytest.mark.parametrize(('ratios', 'least', 'verdict'), [
    ([1.0, 1.1, 1.12], False, 'met'), ([1.1, 1.2, 1.3], False, 'open'),
    ([1.2, 1.3, 1.4], False, '**MISSED**'), ([0.7, 0.75, 0.85], True, 'open'),
    ([0.7, 0.75, 0.76], True, '**MISSED**')])
def test_a_row_of_turns_is_missed_only_where_its_interval_excludes_the_target(ratios, least,
                                                                              verdict):
    row = in_turns('ratio', ratios, 0.8 if least else 1.15, least=least)
    assert row.value == sorted(ratios)[1]
    assert row.cells()[3] == verdict
    assert row.missed == (verdict == '**MISSED**')
    assert show([row]) == row.missed


def test_the_interval_of_a_median_is_that_of_order_statistics():
    values = list(range(1, 101))
    assert interval(values[:1]) == (1, 1)
    assert interval(values[:4]) == (1, 4)       # too few to leave any out
    assert interval(values[:10]) == (2, 9)      # 97.9 %; the next one has 89.1 %
    assert interval(values[::-1]) == (42, 59)
    draw = np.random.default_rng(1)
    held = [low <= 0.0 <= high for low, high in (
        interval(draw.standard_normal(12).tolist()) for _ in range(2000))]
    assert 0.9 < np.mean(held) < 0.99


def test_a_table_has_a_line_for_each_row():
    lines = markdown([Row('|a|', 1.0), Row('b', 2.0, 3.0, 'µs', detail='c')])
    assert lines[2:] == ['| \\|a\\| | 1× |  |  |  |', '| b | 2 µs | ≤ 3 µs | met | c |']


def test_spreads_are_percentiles():
    assert spread([float(i) for i in range(1001)], 2.0) == pytest.approx({
        'p50': 1000.0, 'p99': 1980.0, 'p999': 1998.0, 'max': 2000.0})


@pytest.mark.skipif(shutil.which('cc') is None, reason='no C compiler')
def test_the_loop_in_c_gives_the_bits_of_ours(paper, tmp_path):
    x = peers.c_loop(peers.Example(paper), tmp_path)()
    assert np.array_equal(x, simulate(paper).x)


def test_the_loop_of_scipy_is_the_same_loop(paper):
    x = peers.by_solve_ivp(peers.Example(paper))
    assert np.abs(x - simulate(paper).x).max() < 1e-8


def test_the_loop_of_python_control_is_the_same_loop(paper):
    pytest.importorskip('control', reason='python-control is not installed')
    x = peers.by_control(peers.Example(paper))
    assert np.abs(x - simulate(paper).x).max() < 1e-11


def test_what_is_lost_late_skipped_and_unanswered_is_seen(paper):
    run = from_run(simulate(paper), 10 ** 18)
    clean = running.Measured()
    running.judge(clean, run)
    assert (clean.lost, clean.skipped, clean.unanswered, clean.late) == (0, 0, 0, 0)
    assert clean.samples == 201
    state, command = run.channels['state'], run.channels['command']
    published = state.publish_time.copy()
    published[300] += 2_000_000
    stamps = state.values.copy()
    stamps[350:, 1] += 0.010
    published[350:] += 10_000_000
    keep = np.arange(len(command)) != 320
    found = running.Measured()
    running.judge(found, replace(run, channels={
        **run.channels,
        'state': Channel(state.labels, stamps, state.log_time, published),
        'command': Channel(command.labels, command.values[keep], command.log_time[keep],
                           command.publish_time[keep])}))
    assert (found.lost, found.skipped, found.unanswered) == (1, 2, 1)
    assert (found.late, found.too_late) == (2, 1)


def test_stacks_become_functions():
    raw = 'main (a.py:1);spin (b.py:20) 7\nmain (a.py:1);spin (b.py:31) 2\nmain (a.py:4) 1'
    assert functions(raw) == {'spin (b.py)': 9, 'main (a.py)': 1}


def test_tables_are_put_between_their_marks_and_nowhere_else(tmp_path, monkeypatch):
    document = tmp_path / 'performance.md'
    begin, end = performance.marked('table')
    document.write_text(f'# A\n\n{begin}\nold\n{end}\n\nlast\n', encoding='utf-8')
    monkeypatch.setattr(performance, 'DOCUMENT', document)
    performance.put('table', ['new'])
    assert document.read_text(encoding='utf-8') == f'# A\n\n{begin}\n\nnew\n\n{end}\n\nlast\n'
    with pytest.raises(ValueError, match='no marks'):
        performance.put('other', ['new'])


def test_the_document_has_every_mark():
    text = performance.DOCUMENT.read_text(encoding='utf-8')
    for name in ('table', 'law steps', 'profile'):
        assert all(mark in text for mark in performance.marked(name))
