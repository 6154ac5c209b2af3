# SPDX-License-Identifier: Apache-2.0
"""How many times faster than real time `dz bag audit` is: a run of 10 min at 200 Hz, as recorded.

The run is simulated and written as a recording; then the command is timed as a user calls it, and
its two parts by themselves. On a busy machine the CPU time is the better number.
"""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.dataset import from_run  # noqa: E402
from dz_ros.core.loop.offline import simulate  # noqa: E402
from dz_ros.recording.reader import read_run  # noqa: E402
from dz_ros.recording.save import save_run  # noqa: E402
from dz_ros.replay.audit.audit import audit  # noqa: E402

DURATION = 600.0
LAWS = ('wang2004', 'robust', 'neural')
"""The paper's, the recommended one and the one that computes most."""


def measure(law: str, folder: Path) -> None:
    """Print the times of one law."""
    configuration = Configuration.from_flat({
        'loop.duration': DURATION, 'plant.substeps': 1, 'controller.law': law})
    run = folder / law
    save_run(from_run(simulate(configuration), time.time_ns()), run)
    begin, used = time.perf_counter(), _children()
    done = subprocess.run([sys.executable, '-m', 'dz_ros', 'bag', 'audit', str(run)], cwd=ROOT,
                          env={**os.environ, 'PYTHONPATH': str(ROOT)}, capture_output=True,
                          text=True, check=False, timeout=600)
    whole, used = time.perf_counter() - begin, _children() - used
    if done.returncode:
        sys.exit(done.stdout + done.stderr)
    begin = time.process_time()
    data = read_run(run)
    reading = time.process_time() - begin
    begin = time.process_time()
    result = audit(data)
    recomputing = time.process_time() - begin
    print(f'{law:<20} {result.checked} samples, {result.compared} numbers: {whole:.2f} s = '
          f'{DURATION / whole:.0f} × real time; CPU {used:.2f} s = {DURATION / used:.0f} × '
          f'(reading {reading:.2f} s, recomputing {recomputing:.2f} s)')


def _children() -> float:
    """Return the CPU time of the commands so far [s]."""
    return sum(os.times()[2:4])


def main() -> None:
    """Measure some laws."""
    with tempfile.TemporaryDirectory() as folder:
        for law in LAWS:
            measure(law, Path(folder))


if __name__ == '__main__':
    main()
