# SPDX-License-Identifier: Apache-2.0
"""What counts as late is the same where it cannot be imported."""

from pathlib import Path
import re

import dz_ros
from dz_ros.core.lateness import LATE, LATE_COUNT, LATE_TEXT
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
