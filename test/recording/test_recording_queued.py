from __future__ import annotations

import threading
import time

from mcap.reader import make_reader
import pytest

from dz_ros.errors import RecordingError
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import ARRAY, Qos
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.queued import QueuedWriter
from dz_ros.recording.writer import RunWriter

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
    gate, write = threading.Event(), writer.write

    def slow(*message):
        assert gate.wait(TIME_OUT)
        write(*message)

    writer.write = slow
    queued = QueuedWriter(writer)
    for k in range(1000):
        queued.put('/state', CODEC.encode([k, 0]), k, k)      # would hang here
    assert queued.pending in (999, 1000)
    gate.set()
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


def test_what_breaks_the_thread_is_said(tmp_path, monkeypatch):
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
