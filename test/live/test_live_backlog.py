# SPDX-License-Identifier: Apache-2.0
"""Messages that take long to read leave the page its time."""

from dz_ros.live.backlog import AT_ONCE, Backlog, MAX_BYTES, SHARE


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def test_a_few_messages_are_read_at_once_and_in_order():
    clock, read = Clock(), []
    backlog = Backlog(lambda payload, when: read.append((payload, when)), clock)
    for number in range(20):
        assert backlog.put(b'x', number) == 0
    backlog.work()
    assert read == [(b'x', number) for number in range(20)]


def test_a_flood_takes_its_share_and_the_newest_message_is_read_at_last():
    clock, read, spent = Clock(), [], 0.0

    def slow(_payload, when):
        nonlocal spent
        read.append(when)
        clock.now += 0.3
        spent += 0.3

    backlog, start, dropped = Backlog(slow, clock), clock(), 0
    for number in range(3000):
        dropped += backlog.put(bytes(1 << 20), number)
        clock.now += 1 / 30
        backlog.work()
    assert spent <= SHARE * (clock() - start) + AT_ONCE + 0.3
    assert spent >= 0.5 * SHARE * (clock() - start)
    assert read == sorted(read)
    assert dropped >= 3000 - len(read) - MAX_BYTES // (1 << 20)
    while read[-1] != 2999:
        clock.now += 1.0
        backlog.work()
