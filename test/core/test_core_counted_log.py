# SPDX-License-Identifier: Apache-2.0
"""What happens often is logged seldom, and counted."""

from dz_ros.core.counted_log import CountedLog, MAX_KINDS


def test_a_line_for_the_first_and_for_each_power_of_ten():
    lines = []
    log = CountedLog(lines.append)
    for _ in range(1234):
        log.add('state: not finite')
    assert lines == [f'state: not finite ({number} so far)' for number in (1, 10, 100, 1000)]
    assert log.counts == {'state: not finite': 1234}


def test_numbers_counted_elsewhere_are_logged_when_they_gain_a_digit():
    lines = []
    log = CountedLog(lines.append)
    for number in (0, 0, 3, 3, 9, 12, 50, 4000):
        log.set('x', number)
    assert lines == ['x (3 so far)', 'x (12 so far)', 'x (4000 so far)']


def test_kinds_and_words_from_outside_are_limited():
    lines = []
    log = CountedLog(lines.append)
    for number in range(10 * MAX_KINDS):
        log.add(f'kind {number}', '\x1b[31m' + 'y' * 10 ** 5)
    assert len(log.counts) == MAX_KINDS + 1
    assert sum(log.counts.values()) == 10 * MAX_KINDS
    assert max(map(len, lines)) < 400
    assert all(line.isprintable() for line in lines)
