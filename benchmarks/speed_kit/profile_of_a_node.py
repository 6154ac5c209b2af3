# SPDX-License-Identifier: Apache-2.0
"""What controller_node's time on a core goes into: by thread, and in Python by function."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
import time

from benchmarks.speed_kit.processes import nodes_below
from benchmarks.speed_kit.running import environment, process

SECONDS = 15.0
NODE = 'controller_node'
MOST = 14
"""Functions that are shown."""


def thread_times(pid: int) -> dict[str, int]:
    """Return thread → time on a core [ns], threads of one name together."""
    found: Counter[str] = Counter()
    for task in Path(f'/proc/{pid}/task').iterdir():
        name = (task / 'comm').read_text().strip()
        name = 'Python' if int(task.name) == pid else re.sub(r'\d+$', '', name)
        found[name] += int((task / 'schedstat').read_text().split()[0])
    return dict(found)


def functions(raw: str) -> Counter[str]:
    """Return function → samples in which it was at work, from py-spy's raw stacks."""
    found: Counter[str] = Counter()
    for line in raw.splitlines():
        stack, _, count = line.rpartition(' ')
        frames = [frame.strip() for frame in stack.split(';')]
        leaf = next((frame for frame in reversed(frames) if frame), '')
        found[re.sub(r':\d+\)$', ')', leaf)] += int(count)
    return found


def measure() -> list[str]:
    """Return the profile as lines of Markdown."""
    words = ['-m', 'dz_ros', 'run', '--duration', str(SECONDS + 5.0), '--quiet', '--record']
    with tempfile.TemporaryDirectory() as folder, process(
            [*words, f'{folder}/run'], environment()) as running:
        time.sleep(4.0)
        pid = nodes_below(running.pid)[NODE]
        before, begin = thread_times(pid), time.monotonic()
        spy = shutil.which('py-spy', path=f'{Path(sys.executable).parent}') or shutil.which(
            'py-spy')
        raw = ''
        time.sleep(SECONDS / 3.0)       # threads first: a sampler costs time itself
        after, span = thread_times(pid), time.monotonic() - begin
        if spy:
            out = Path(folder) / 'stacks'
            subprocess.run([spy, 'record', '--pid', str(pid), '--rate', '500', '--duration',
                            str(round(SECONDS / 2.0)), '--format', 'raw', '--output', str(out)],
                           check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            raw = out.read_text()
    lines = ['| thread of `controller_node` | share of a core |', '|---|---|']
    threads = {name: (after[name] - before.get(name, 0)) * 1e-7 / span for name in after}
    lines += [f'| {name} | {share:.2f} % |' for name, share in
              sorted(threads.items(), key=lambda item: -item[1]) if share >= 0.01]
    if not raw:
        return [*lines, '', 'py-spy is not installed: nothing is known of the functions.']
    found = functions(raw)
    whole = sum(found.values())
    lines += ['', f'| function at work, of {whole} samples of the Python thread | share |',
              '|---|---|']
    return lines + [f'| `{name}` | {100.0 * count / whole:.1f} % |'
                    for name, count in found.most_common(MOST)]
