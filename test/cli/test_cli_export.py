# SPDX-License-Identifier: Apache-2.0
"""`dz bag export`: the joined table in three formats, the same numbers in each."""

import csv
from dataclasses import replace
import math
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run
from dz_ros.runs.table import RunTable

RUN = Path(__file__).parents[1] / 'data' / 'recordings' / 'wang2004'


@pytest.fixture
def table():
    return RunTable.of(read_run(RUN))


def test_csv_holds_every_number(table, tmp_path, capsys):
    out = tmp_path / 'a.csv'
    assert main(['bag', 'export', str(RUN), '--out', str(out)]) == 0
    printed = capsys.readouterr().out
    assert 'x1 [1/s]' in printed
    assert f'{out}: {len(table.t)} samples' in printed
    rows = list(csv.DictReader(out.open()))
    assert [int(row['seq']) for row in rows] == table.seq.tolist()
    wanted = {'t': table.t, 'v': table.v, 'xd0': table.x_d[:, 0], **table.terms}
    for name, column in wanted.items():
        for row, number in zip(rows, column, strict=True):
            assert row[name] == '' if math.isnan(number) else float(row[name]) == number


LIMITED = """
import resource, sys
from dz_ros.cli.main import main
limits = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
code = main(sys.argv[1:])
resource.setrlimit(resource.RLIMIT_FSIZE, limits)       # coverage writes its own
sys.exit(code)
"""


@pytest.mark.parametrize('words', [
    ['simulate', 'wang2004', '--duration', '2', '--csv'], ['bag', 'export', str(RUN), '--out'],
    ['bag', 'export', str(RUN), '--mat', '--out']], ids=lambda words: ' '.join(words[:2]))
def test_a_table_for_which_there_is_no_room_is_named_and_not_left_in_part(words, tmp_path):
    out = tmp_path / 'table'
    done = subprocess.run([sys.executable, '-c', LIMITED, *words, str(out)], timeout=120,
                          capture_output=True, text=True, check=False, env={
                              **os.environ, 'PYTHONPATH': str(Path(__file__).parents[2])})
    assert done.returncode == 2
    assert done.stderr == f'dz: error: {out}: File too large\n'
    assert list(tmp_path.iterdir()) == []


def test_mat_has_column_vectors(table, tmp_path):
    from scipy.io import loadmat

    out = tmp_path / 'a.mat'
    assert main(['bag', 'export', str(RUN), '--mat', '--out', str(out)]) == 0
    found = loadmat(out)
    assert found['v'].shape == (len(table.t), 1)
    assert np.array_equal(found['s'][:, 0], table.terms['s'], equal_nan=True)


def test_parquet_has_the_same_columns(table, tmp_path):
    parquet = pytest.importorskip('pyarrow.parquet')
    out = tmp_path / 'a.parquet'
    assert main(['bag', 'export', str(RUN), '--parquet', '--out', str(out)]) == 0
    found = parquet.read_table(out)
    assert found.column_names[:4] == ['seq', 't', 'x0', 'x1']
    assert np.array_equal(found['t'].to_numpy(), table.t)


def test_nothing_is_overwritten(tmp_path, capsys):
    out = tmp_path / 'a.csv'
    out.write_text('mine')
    assert main(['bag', 'export', str(RUN), '--out', str(out)]) == 2
    assert 'never overwritten' in capsys.readouterr().err
    assert out.read_text() == 'mine'


def with_terms(path, *names):
    """Write the run with further terms, 77, 78, …, and return its directory."""
    data = read_run(RUN)
    terms = data.channels['terms']
    values = np.column_stack([terms.values, *(np.full(len(terms), 77.0 + i)
                                              for i in range(len(names)))])
    save_run(replace(data, channels={**data.channels, 'terms': replace(
        terms, labels=(*terms.labels, *names), values=values)}), path)
    return path


def test_no_term_takes_the_place_of_what_was_measured(table, tmp_path):
    path = with_terms(tmp_path / 'run', 'x0', 't', 'terms.t', 'v', 'w')
    found = RunTable.of(read_run(path)).columns
    for name, column in table.columns.items():
        if name != 'w':
            assert np.array_equal(found[name], column, equal_nan=True), name
    assert found['terms.x0'][0] == 77.0
    assert {'terms.t', 'terms.terms.t', 'terms.v', 'w'} <= set(found)


def test_names_of_a_recording_are_neither_formulas_nor_control_characters(tmp_path, capsys):
    names = ('=1+1', '@x', 'a"b', '\x1b[2J')
    path, out = with_terms(tmp_path / 'run', *names), tmp_path / 'a.csv'
    assert main(['bag', 'export', str(path), '--out', str(out)]) == 0
    assert '\x1b' not in capsys.readouterr().out
    head = next(csv.reader(out.open()))
    assert {"'=1+1", "'@x", 'a"b', '\\x1b[2J'} <= set(head)


def test_every_column_is_a_variable_of_its_own_in_matlab(tmp_path, capsys):
    from scipy.io import loadmat

    names = ('\N{GREEK SMALL LETTER KAPPA}_f', '_z', 'k' * 63 + '1', 'k' * 63 + '2', '$x')
    path, out = with_terms(tmp_path / 'run', *names), tmp_path / 'a.mat'
    assert main(['bag', 'export', str(path), '--mat', '--out', str(out)]) == 0
    found = loadmat(out)
    assert '_z is x_z in the file' in capsys.readouterr().out
    for place, name in enumerate(('x__f', 'x_z', 'k' * 63, 'k' * 57 + '_2', 'x_x')):
        assert found[name][0, 0] == 77.0 + place
