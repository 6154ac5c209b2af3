# SPDX-License-Identifier: Apache-2.0
"""What counts as late is the same where it cannot be imported."""

from pathlib import Path
import re

import pytest

import dz_ros
from dz_ros.core.lateness import fell_behind, LATE, LATE_COUNT, LATE_TEXT
from dz_ros.runtime.deadlines import LATE_NS

PAGE = Path(dz_ros.__file__).parent / 'live' / 'page'


def test_late_is_a_millisecond():
    assert (LATE, LATE_TEXT) == (0.001, '1 ms')


def test_the_clock_of_the_loop_counts_the_same():
    assert LATE_NS * 1e-9 == LATE


def test_the_page_counts_the_same():
    found = re.search(r'const LATE = ([\d.]+);', (PAGE / 'histograms.js').read_text('utf-8'))
    assert float(found[1]) == LATE
    assert f"'{LATE_COUNT}'" in (PAGE / 'nodes.js').read_text('utf-8')


@pytest.mark.parametrize(('samples', 'skipped', 'words'), [
    (0, 0, ''), (1000, 0, ''), (990, 10, ''), (989, 11, '11 of 1000 samples were skipped (1.1 %)'),
    (5467, 934, '934 of 6401 samples were skipped (14.6 %)'),
    (4, 996, '996 of 1000 samples were skipped (99.6 %)')])
def test_a_machine_that_does_not_keep_up_is_named(samples, skipped, words):
    found = fell_behind(samples, skipped)
    assert found == (f'the machine did not keep up: {words}' if words else '')
