# SPDX-License-Identifier: Apache-2.0
"""A recording process that is killed."""

from __future__ import annotations

from pathlib import Path
import signal
import sys

import pytest

from dz_ros.recording.reader import read_run
from dz_ros.recording.recover import recover

KILLED = """
import itertools, sys
from pathlib import Path
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.writer import RunWriter

period = int(sys.argv[2])
now = 0
writer = RunWriter(Path(sys.argv[1]), {'mode': 'realtime'}, {'loop.rate': 1e9 / period},
                   clock=lambda: now * 1e-9)
codecs = {name: ArrayCodec(('seq', 'stamp', *(f'x{i}' for i in range(count))))
          for name, count in (('/reference', 3), ('/state', 4), ('/command', 3), ('/terms', 13))}
for name in codecs:
    writer.add_topic(name, 'std_msgs/msg/Float64MultiArray')
for k in itertools.count():
    now = k * period
    for name, codec in codecs.items():
        writer.write(name, codec.encode([k, now * 1e-9, *range(len(codec.labels) - 2)]), now, now)
    print(now, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize('rate', [1, 200, 5000])
def test_kill_costs_less_than_a_second(tmp_path, processes, rate):
    """The writer's clock is that of the messages, so the machine's speed does not matter."""
    period = 10**9 // rate
    process = processes(sys.executable, '-c', KILLED, tmp_path / 'run', str(period),
                        cwd=Path(__file__).parents[2])
    process.wait_for_line(str(3000 * period))
    process.signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    written = [int(line) for line in process.output.splitlines() if line.isdigit()]
    found = read_run(tmp_path / 'run')
    assert 'cut off' in found.info['cut']
    last = max(int(channel.log_time[-1]) for channel in found.channels.values())
    # The last line may be half a number, so the last but one; beside, one sample was under way.
    assert written[-2] - last < max(10**9, 2 * period)
    assert found.configuration == {'loop.rate': 1e9 / period}
    summary = recover(tmp_path / 'run', tmp_path / 'mended')
    assert summary.missing == 0
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    with rosbag2.Reader(tmp_path / 'mended') as reader:
        assert sum(1 for _ in reader.messages()) == summary.messages
