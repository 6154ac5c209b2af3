# SPDX-License-Identifier: Apache-2.0
import contextlib
import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.files.yaml12 import parse, YamlError


@pytest.mark.parametrize(('text', 'expected'), [
    ('1e-3', 1e-3), ('1E3', 1000.0), ('-1.5e+3', -1500.0), ('.5', 0.5), ('5.', 5.0),
    ('1', 1), ('-7', -7), ('010', 10), ('0x1F', 31),
    ('12:30', '12:30'), ('2020-01-01', '2020-01-01'), ('1_000', '1_000'), ('0o7', '0o7'),
    ('true', True), ('on', True), ('No', False), ('"true"', 'true'), ('~', None), ('', None),
    ('my.module:Name', 'my.module:Name'), ('=', '='), ('[1, 1e1, a]', [1, 10.0, 'a']),
])
def test_scalars_are_what_they_look_like(text, expected):
    found = parse(text)
    assert found == expected
    assert type(found) is type(expected)


def test_infinity_and_nan():
    assert parse('-.inf') == -math.inf
    assert math.isnan(parse('.nan'))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_as_python_writes_it(number):
    assert float(parse(repr(number))) == number


@pytest.mark.parametrize(('text', 'part'), [
    ('a: 1\nb: {c: 1, c: 2}', 'line 2: c is given twice'),
    ('a: [1, 2', 'line 1'),
    ('a: b: c', 'line 1'),
    ('a: 1\n\tb: 2', 'line 2'),
    ('[a]: 1', 'line 1: a key must be a word'),
    ('&x [*x]', 'aliases'),
    ('!!python/object/apply:os.getcwd []', 'line 1'),
    ('!!float x', 'tag'), ('!!int x', 'tag'), ('!!timestamp x', ''),
    ('\x00', 'special characters'),
    ('a: 1\n---\nb: 2', 'line 2'),
    ('[' * 5000, 'too deeply'),
    ('9' * 5000, 'tag'),
])
def test_what_is_not_yaml_is_one_line(text, part):
    with pytest.raises(YamlError) as caught:
        parse(text)
    assert part in str(caught.value)
    assert str(caught.value)
    assert '\n' not in str(caught.value)


@given(st.text(max_size=30))
def test_no_text_gets_past_the_two_ways_to_end(text):
    with contextlib.suppress(YamlError):
        parse(text)
