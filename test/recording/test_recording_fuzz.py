# SPDX-License-Identifier: Apache-2.0
"""Altered files: a refusal, a note of what is missing, or the numbers that were recorded."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
import importlib.util
from pathlib import Path

import numpy as np
import pytest

INPUTS = 160
"""A minute on a quiet machine; `make fuzz` tries others for as long as asked."""
SEEDS_FOUND_EARLIER = (900006, 900215, 900289, 592185185, 592185361,
                       556137870, 700000302)
"""Seeds that once found something."""


@pytest.fixture(scope='module')
def fuzzer():
    spec = importlib.util.spec_from_file_location('fuzz', Path(__file__).with_name('fuzz.py'))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize('seeds', [*((seed,) for seed in SEEDS_FOUND_EARLIER), pytest.param(
    range(INPUTS), marks=pytest.mark.slow)])
def test_no_altered_file_gives_a_wrong_number(fuzzer, tmp_path, seeds):
    assert fuzzer.fuzz(seeds, None, tmp_path / 'found') == []


def test_the_fuzzer_notices_wrong_and_missing_rows(fuzzer, tmp_path):
    bases = fuzzer.Bases(tmp_path)
    state = bases.data.channels['state']
    values = state.values.copy()
    values[5, 2] += 1e-9
    longer = replace(state, values=np.vstack([state.values, state.values[-1:]]))
    for channel, wrong in ((replace(state, values=values), 'other numbers'),
                           (longer, 'lacks rows')):
        data = replace(bases.data, channels={**bases.data.channels, 'state': channel})
        assert wrong in fuzzer.same_rows(bases.folders['ours'], data)
    assert fuzzer.same_rows(bases.folders['ours'], bases.data) == ''


def test_the_fuzzer_notices_rows_that_another_reader_does_not_find(fuzzer, tmp_path, monkeypatch):
    pytest.importorskip('rosbags', reason='rosbags is not installed: no bags of others')
    bases = fuzzer.Bases(tmp_path)
    assert len(bases.folders) == 8
    for name in ('ours', 'sqlite3', 'sqlite3message', 'mcapfile'):
        run = bases.folders[name]
        stored, fault = fuzzer.other_reading(run)
        assert (stored, fault) == (fuzzer.rows_of(bases.data), '')
        assert fuzzer.stored_rows(run, run, bases.data) == ''
        row = next(iter(stored['state']))
        for change, wrong in ((1, 'lacks rows'), (-1, 'not stored')):
            other = {**stored, 'state': Counter(stored['state'])}
            other['state'][row] += change
            monkeypatch.setattr(fuzzer, 'other_reading', lambda _, other=other: (other, ''))
            assert wrong in fuzzer.stored_rows(run, run, bases.data)
        monkeypatch.undo()


def test_the_fuzzer_notices_what_does_not_end_and_what_fills_memory(fuzzer):
    def endless():
        with fuzzer.limited(0.05):
            while True:
                pass

    with pytest.raises(fuzzer.HangError):
        endless()


@pytest.mark.slow
def test_the_fuzzer_measures_the_memory_of_the_input_alone(fuzzer, tmp_path, monkeypatch):
    held = bytearray(b'x' * 2**28)
    start = fuzzer.start_of_growth()
    assert fuzzer.growth(start) < 100
    assert len(held + b'x') > 2**28
    assert fuzzer.growth(start) >= 250

    def greedy(folder):
        return '' if bytes(folder) + b'x' * 2**28 else 'nothing'

    del held
    bases = fuzzer.Bases(tmp_path / 'bases')
    monkeypatch.setattr(fuzzer, 'MEMORY', 200)
    seed = next(seed for seed in range(1000) if fuzzer.make(
        seed, bases, tmp_path / f'try{seed}')[0] == 'parameters')
    assert fuzzer.check(seed, bases, tmp_path) == ''
    monkeypatch.setattr(fuzzer, 'check_parameters', greedy)
    again = tmp_path / 'again'
    again.mkdir()
    assert fuzzer.check(seed, bases, again).endswith('MiB used')
