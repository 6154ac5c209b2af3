# SPDX-License-Identifier: Apache-2.0
"""A disk that is full, in a process of its own."""

from __future__ import annotations

from pathlib import Path
import sys

import pytest

from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.mcap_file import McapFile

FULL_DISK = """
import resource, sys
from pathlib import Path
from dz_ros.errors import RecordingError
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.writer import RunWriter
from dz_ros.recording.writer_thread import QueuedWriter

codec = ArrayCodec(('seq', 'stamp', 'x0'))
kind = 'std_msgs/msg/Float64MultiArray'
unlimited = resource.RLIM_INFINITY
resource.setrlimit(resource.RLIMIT_FSIZE, (120_000, unlimited))
writer = RunWriter(Path(sys.argv[1]), {'mode': 'offline'}, {})
writer.add_topic('/state', kind)
count = 50_000
if sys.argv[2] == 'direct':
    try:
        for k in range(count):
            writer.write('/state', codec.encode([k, k * 0.1, k / 7]), k, k)
    except RecordingError as error:
        print('refused', error)
    for again in (lambda: writer.write('/state', b'', 0, 0), writer.close):
        try:
            again()
        except RecordingError as error:
            print('again', error)
    print('summary', writer.summary().complete)
else:
    queued = QueuedWriter(writer)
    for k in range(count):
        queued.put('/state', codec.encode([k, k * 0.1, k / 7]), k, k)
    summary = queued.close()
    print('refused', queued.error)
    print('counts', summary.messages, summary.lost, summary.messages + summary.lost)
    print('summary', summary.complete)
resource.setrlimit(resource.RLIMIT_FSIZE, (unlimited, unlimited))   # coverage writes its own
"""


@pytest.mark.slow
@pytest.mark.parametrize('way', ['direct', 'queued'])
def test_full_disk(tmp_path, processes, way):
    pytest.importorskip('resource')
    process = processes(sys.executable, '-c', FULL_DISK, tmp_path / 'run', way,
                        cwd=Path(__file__).parents[2])
    assert process.wait() == 0, process.output
    lines = process.output.splitlines()
    assert lines[0].startswith('refused ')
    assert 'cannot be written: File too large' in lines[0]
    assert 'dz bag recover' in lines[0]
    assert lines[-1] == 'summary False'
    if way == 'direct':
        assert [line.split()[0] for line in lines] == ['refused', 'again', 'again', 'summary']
    else:
        written, _, total = map(int, lines[1].split()[1:])
        assert total == 50_000
    assert not (tmp_path / 'run/metadata.yaml').exists()
    file = McapFile(tmp_path / 'run/run_0.mcap')
    kept = [message for batch in file.batches() for message in batch]
    assert file.cut
    codec = ArrayCodec(('seq', 'stamp', 'x0'))
    assert [codec.decode(item.payload) for item in kept] == [
        (k, k * 0.1, k / 7) for k in range(len(kept))]
    assert kept
    if way == 'queued':
        assert 0 < written <= len(kept) < 50_000     # nothing is promised that is not there
