# SPDX-License-Identifier: Apache-2.0
"""Text of unknown origin, as it is shown."""

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from dz_ros.core.text import counted, plain, printable


def test_one_of_a_thing_has_no_s():
    assert [counted(number, 'run') for number in (0, 1, 2)] == ['0 runs', '1 run', '2 runs']


@pytest.mark.parametrize(('text', 'shown'), [
    ('x̃ in ±1 µm, θ̂₁ → 3', 'x̃ in ±1 µm, θ̂₁ → 3'), ('a\nb', r'a\nb'),
    ('a\r\x1b[2Kb', r'a\r\x1b[2Kb'),
    ('a\x9b1m', r'a\x9b1m'), ('a\u202eb', r'a\u202eb'), ('a\u2028b', r'a\u2028b'),
    ('\ud800', r'\ud800'), ('a b', 'a b'), (3, '3'),
])
def test_what_is_not_visible_in_place_is_escaped(text, shown):
    assert printable(text) == shown


@settings(deadline=None)
@given(st.text())
def test_it_is_one_line_and_can_be_written(text):
    shown = printable(text)
    assert len(shown.splitlines()) <= 1
    assert not any(ord(item) < 32 or 127 <= ord(item) < 160 for item in shown)
    shown.encode()


@settings(deadline=None)
@given(st.text(st.characters() | st.sampled_from('$\\_^{}')))
def test_matplotlib_takes_none_of_it_for_mathtext(text):
    cbook = pytest.importorskip('matplotlib.cbook')
    assert not cbook.is_math_text(plain(text))


def test_long_text_is_cut():
    assert printable('x' * 20, 5) == 'xxxxx…'
