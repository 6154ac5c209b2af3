# SPDX-License-Identifier: Apache-2.0
"""Indices of chunks kept as bytes: the same file, a quarter of the memory."""

import tracemalloc

from mcap.reader import make_reader

from dz_ros.recording import writer as module
from dz_ros.recording.channels import ARRAY
from dz_ros.recording.writer import RunWriter

CHUNKS = 400
TOPICS = ('/state', '/command', '/terms', '/reference', '/truth')


def written(folder, clock=lambda: 0.0):
    """Write a run of many chunks; return its file and the memory it took to hold them."""
    with RunWriter(folder, {'mode': 'test'}, {'loop.rate': 200.0}, clock=clock) as run:
        for topic in TOPICS:
            run.add_topic(topic, ARRAY.name)
        tracemalloc.start()
        try:
            for chunk in range(CHUNKS):
                for topic in TOPICS:
                    run.write(topic, b'\0\1\0\0' + b'\0' * 8, 1000 * chunk + 7, 1000 * chunk)
                run.flush()
                if chunk == CHUNKS // 4:
                    before = tracemalloc.get_traced_memory()[0]
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
    return run.path, grown


def test_the_file_is_the_same_and_the_memory_a_quarter(tmp_path, monkeypatch):
    packed, small = written(tmp_path / 'packed' / 'run')
    monkeypatch.setattr(module, 'pack_indices', lambda writer: None)
    plain, large = written(tmp_path / 'plain' / 'run')
    assert packed.read_bytes() == plain.read_bytes()
    assert small < 300 * CHUNKS * 3 // 4        # bytes for each chunk
    assert large > 3 * small     # a quarter, or less


def test_a_reader_finds_every_chunk(tmp_path):
    path, _ = written(tmp_path / 'run')
    with path.open('rb') as file:
        summary = make_reader(file).get_summary()
    assert len(summary.chunk_indexes) == CHUNKS
    assert [item.message_start_time for item in summary.chunk_indexes] == [
        1000 * chunk + 7 for chunk in range(CHUNKS)]
    assert all(len(item.message_index_offsets) == len(TOPICS) for item in summary.chunk_indexes)
