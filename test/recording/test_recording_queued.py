# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import errno
import os
import threading
import time

from mcap.reader import make_reader
import pytest

from dz_ros.errors import RecordingError
from dz_ros.recording import writer_thread as module
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import ARRAY, Qos
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.reader import read_run
from dz_ros.recording.writer import CHUNK_SECONDS, RunWriter
from dz_ros.recording.writer_thread import QueuedWriter

CODEC = ArrayCodec(('seq', 'stamp'))
TIME_OUT = 60.0


def numbers(path):
    return [CODEC.decode(item.payload)[0] for batch in McapFile(path).batches() for item in batch]


def test_everything_put_is_written_in_order(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {})
    with QueuedWriter(writer) as queued:
        queued.add_topic('/state', ARRAY.name, Qos(depth=3))
        for k in range(20_000):
            queued.put('/state', CODEC.encode([k, k * 0.1]), k, k)
        queued.add_metadata('dz_ros.note', {'a': 'b'})
        queued.add_configuration({'loop.rate': 1.0})
        summary = queued.close()
    assert (summary.messages, summary.lost, summary.missing, summary.complete) == (
        20_000, 0, 0, True)
    assert queued.error is None
    assert queued.close() is summary
    assert numbers(writer.path) == list(range(20_000))
    with writer.path.open('rb') as file:
        names = [item.name for item in make_reader(file).iter_metadata()]
    assert names[:3] == ['dz_ros.info', 'dz_ros.note', 'dz_ros.configuration']


def test_many_threads_may_put(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {})
    queued = QueuedWriter(writer)

    def put(topic):
        queued.add_topic(topic, ARRAY.name)
        for k in range(2000):
            queued.put(topic, CODEC.encode([k, 0]), k, k)

    threads = [threading.Thread(target=put, args=(f'/ns{n}/state',)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(TIME_OUT)
    summary = queued.close()
    assert summary.messages == 8000
    assert summary.missing == 0
    assert all(item.reordered == item.duplicates == 0 for item in summary.topics.values())


def test_put_never_waits_for_the_writer(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {})
    writer.add_topic('/state', ARRAY.name)
    barrier, write = threading.Event(), writer.write

    def slow(*message):
        assert barrier.wait(TIME_OUT)
        write(*message)

    writer.write = slow
    queued = QueuedWriter(writer)
    for k in range(1000):
        queued.put('/state', CODEC.encode([k, 0]), k, k)      # would hang here
    assert queued.pending in (999, 1000)
    barrier.set()
    assert queued.close().messages == 1000


def test_messages_put_together_are_stored_one_by_one(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {})
    writer.add_topic('/state', ARRAY.name)
    queued = QueuedWriter(writer)
    queued.put_all([])
    queued.put_all([('/state', CODEC.encode([k, 0]), k, k) for k in range(5)]
                   + [('/unknown', b'', 5, 5), ('/state', CODEC.encode([5, 0]), 5, 5)])
    summary = queued.close()
    assert (summary.messages, summary.lost) == (6, 1)
    assert numbers(writer.path) == list(range(6))


def test_a_single_message_reaches_the_file_without_a_next_one(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {})
    with QueuedWriter(writer, idle=0.01) as queued:
        queued.add_topic('/state', ARRAY.name)
        queued.put('/state', CODEC.encode([0, 0]), 0, 0)
        deadline = time.monotonic() + TIME_OUT
        while not numbers(writer.path) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert numbers(writer.path) == [0]


def test_one_bad_message_does_not_cost_the_others(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {})
    queued = QueuedWriter(writer)
    queued.add_topic('/state', ARRAY.name)
    queued.put('/state', CODEC.encode([0, 0]), 0, 0)
    queued.put('/unknown', b'', 0, 0)
    queued.put('/state', CODEC.encode([1, 0]), 0, 0)
    summary = queued.close()
    assert (summary.messages, summary.lost, summary.complete) == (2, 1, True)
    assert 'not registered' in str(queued.error)
    assert queued.lost == 1


def test_what_breaks_the_thread_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(threading, 'excepthook', lambda _: None)
    writer = RunWriter(tmp_path / 'run', {}, {})
    writer.add_topic('/state', ARRAY.name)
    queued = QueuedWriter(writer)
    good = ('/state', CODEC.encode([0, 0]), 0, 0)
    queued.put_all([good, ('/state', None, 0, 0), good])      # not bytes: the caller's mistake
    queued.put(*good)
    summary = queued.close()
    assert isinstance(queued.error, RecordingError)
    assert 'recording broke' in str(queued.error)
    assert (summary.messages, summary.lost) == (1, 3)


@pytest.mark.parametrize('wait', [False, True])
def test_close_from_two_threads_gives_the_same(tmp_path, wait):
    queued = QueuedWriter(RunWriter(tmp_path / 'run', {}, {}))
    found = []
    threads = [threading.Thread(target=lambda: found.append(queued.close())) for _ in range(2)]
    for thread in threads:
        thread.start()
        if wait:
            thread.join(TIME_OUT)
    for thread in threads:
        thread.join(TIME_OUT)
    assert found[0] is found[1]


@pytest.mark.slow
def test_configurations_that_repeat_or_flap_cost_next_to_nothing(tmp_path):
    """Ten minutes in which a node states its configuration ten times a second."""
    now = 0.0
    writer = RunWriter(tmp_path / 'run', {}, {}, clock=lambda: now)
    queued = QueuedWriter(writer, clock=lambda: now)
    queued.add_topic('/state', ARRAY.name)
    filling = {f'controller.key{k}': k / 7 for k in range(100)}
    for k in range(6000):
        now = 0.1 * k
        queued.put('/state', CODEC.encode([k, now]), k, k)
        flapping = {**filling, 'controller.gamma': float(k)}
        queued.add_metadata('dz_ros.node./controller_node', {'configuration': str(flapping)})
        queued.add_configuration(flapping)
        while queued.pending:       # the thread has seen this time
            time.sleep(0.0)
    summary = queued.close()
    assert (summary.messages, summary.lost, summary.complete) == (6000, 0, True)
    assert summary.bytes < 2_000_000
    with writer.path.open('rb') as file:
        reader = make_reader(file)
        assert reader.get_summary().statistics.chunk_count < 600.0 / CHUNK_SECONDS + 2
    found = read_run(tmp_path / 'run')
    assert found.configuration == {**filling, 'controller.gamma': 5999.0}     # the last one


class Disk:
    """A disk whose writes can be refused or held up."""

    def __init__(self, monkeypatch):
        self.room, self.barrier = True, threading.Event()
        self.barrier.set()
        write = os.pwrite

        def pwrite(*arguments):
            assert self.barrier.wait(TIME_OUT)
            if not self.room:
                write(arguments[0], arguments[1][:5], arguments[2])     # some of it fits
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return write(*arguments)

        monkeypatch.setattr(os, 'pwrite', pwrite)


def until(condition):
    deadline = time.monotonic() + TIME_OUT
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_beyond_the_backlog_messages_are_lost_and_counted_and_then_it_goes_on(
        tmp_path, monkeypatch):
    disk = Disk(monkeypatch)
    writer = RunWriter(tmp_path / 'run', {}, {}, backlog=10_000)
    queued = QueuedWriter(writer, idle=0.01)
    queued.add_topic('/state', ARRAY.name)
    put = 0

    def one():
        nonlocal put
        queued.put('/state', CODEC.encode([put, 1 / (put + 7)]), put, put)
        put += 1

    one()
    disk.room = False
    until(lambda: one() or 'No space left on device; up to 0.00954 MB wait' in queued.condition)
    assert queued.error is None
    until(lambda: one() or 'messages are lost from now on' in queued.condition)
    until(lambda: one() or queued.lost > 100)
    assert 'is lost' in str(queued.error)
    file = McapFile(writer.path)
    assert sum(map(len, file.batches())) <= 1       # what did not fit as a whole is not there
    disk.room = True
    until(lambda: not queued.condition)
    one()
    summary = queued.close()
    assert summary.complete
    assert summary.messages + summary.lost == put
    found = numbers(writer.path)
    assert len(found) == summary.messages
    assert found[-1] == put - 1
    assert summary.missing == summary.lost      # each of them shows as a hole
    assert (tmp_path / 'run/metadata.yaml').exists()


def test_a_disk_that_does_not_answer_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(module, 'CLOSE_TIME_OUT', 0.2)
    monkeypatch.setattr(module, 'MAX_PENDING', 1000)
    disk = Disk(monkeypatch)
    queued = QueuedWriter(RunWriter(tmp_path / 'run', {}, {}))
    queued.add_topic('/state', ARRAY.name)
    disk.barrier.clear()
    for k in range(20_000):
        queued.put('/state', CODEC.encode([k, 0.0]), k, k)
    assert queued.pending <= 1000 + 20_000 // 2
    summary = queued.close()
    assert (summary.messages, summary.lost, summary.complete) == (0, 20_000, False)
    assert 'the disk' in str(queued.error)
    disk.barrier.set()


def test_what_large_messages_that_wait_take_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(module, 'MAX_PENDING_BYTES', 1 << 20)
    disk = Disk(monkeypatch)
    queued = QueuedWriter(RunWriter(tmp_path / 'run', {}, {}))
    queued.add_topic('/state', ARRAY.name)
    disk.barrier.clear()
    for k in range(0, 2000, 20):
        queued.put_all([('/state', CODEC.encode([i, 0.0]) + bytes(100_000), i, i)
                        for i in range(k, k + 20)])
        assert queued.pending <= (1 << 20) // 100_000
    assert 'MiB wait' in str(queued.error)
    lost = queued.lost
    assert lost > 0
    disk.barrier.set()
    summary = queued.close()
    assert (summary.messages, summary.lost) == (2000 - lost, lost)


def test_a_file_that_lives_on_under_another_link_alone_was_removed(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {}, backlog=1)
    writer.file.check_place()
    (tmp_path / 'copy').hardlink_to(writer.path)
    writer.file.check_place()
    writer.path.unlink()
    with pytest.raises(RecordingError, match=r'/run_0\.mcap was removed while it was recorded'):
        writer.file.check_place()


def test_a_file_that_others_have_cut_is_not_called_whole(tmp_path):
    writer = RunWriter(tmp_path / 'run', {}, {}, backlog=1)
    os.truncate(writer.path, 20)
    with pytest.raises(RecordingError, match=r'_0\.mcap was cut to 20 of \d+ bytes by another'):
        writer.close()
    assert not writer.summary().complete
    assert writer.summary().bytes == 20
