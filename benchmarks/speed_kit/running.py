# SPDX-License-Identifier: Apache-2.0
"""Loops and bare processes, started, watched and ended for a measurement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import re
import subprocess
import sys
import time
from typing import Any

import numpy as np

from benchmarks.speed_kit.processes import cpu_ns, nodes_below, resident
from dz_ros.core.dataset import RunData
from dz_ros.files.configurations import load_configuration, write_parameters
from dz_ros.nodes.ros.middleware import PROFILES, TRANSPORTS, wishes
from dz_ros.recording.reader import read_run
from dz_ros.runs.sequence import first_of_each
from dz_ros.runtime.process import PARENT

ROOT = Path(__file__).resolve().parents[2]
BARE = Path(__file__).with_name('bare.py')
INTERLEAVED = Path(__file__).with_name('interleaved.py')
TIME_OUT = 120.0
SETTLED = 1.0
"""What happens in the first second of a loop is not measured [s]."""


def environment(transport: str = '', profile: bool = False) -> dict[str, str]:
    """Return the environment of a process that is measured.

    Byte code is kept between starts, and no profile of the user's chooses the transport.
    """
    found = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **os.environ,
             'PYTHONPATH': str(ROOT), PARENT: str(os.getpid())}
    for name in (*PROFILES, 'PYTHONDONTWRITEBYTECODE'):
        found.pop(name, None)
    if transport:
        found[TRANSPORTS] = transport
    # rmw_fastrtps takes no transport from the environment where discovery ends at this machine.
    return found | wishes(found, ROOT) if profile or transport else found


@contextlib.contextmanager
def process(words: Sequence[str], env: dict[str, str],
            folder: Path = ROOT) -> Iterator[subprocess.Popen[str]]:
    """Start a process in a folder; end it."""
    started = subprocess.Popen([sys.executable, *words], cwd=folder, env=env, text=True,
                               stdout=subprocess.PIPE)
    try:
        yield started
    finally:
        started.terminate()
        try:
            started.wait(10.0)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()


def bare(*words: str, transport: str = '', profile: bool = False) -> Any:
    """Return the context of a bare process (bare.py)."""
    return process([str(BARE), *words], environment(transport, profile))


def printed_json(started: subprocess.Popen[str]) -> Any:
    """Return what a process prints as JSON before it ends."""
    out, _ = started.communicate(timeout=TIME_OUT)
    if started.returncode:
        sys.exit(f'{" ".join(map(str, started.args))} failed')
    return json.loads(out)


def refused(*words: str) -> bool:
    """Whether the system refuses what a probe asks for."""
    with process(['-m', 'dz_ros.runtime.probe', '--duration', '0.1', *words],
                 environment()) as probe:
        return bool(printed_json(probe)['refused'])


def echo(way: str, transport: str, duration: float) -> list[float]:
    """Return the round trips of a bare two-process echo [s]."""
    with bare('pong', '--way', way, transport=transport), bare(
            'ping', '--way', way, '--duration', str(duration), transport=transport) as ping:
        found = printed_json(ping)
    shared = any(name.startswith('dds.shm') for name in found['threads'])
    if way != 'plain' and shared == bool(transport):
        sys.exit(f'an echo by {transport or "shared memory"} has the threads '
                 f'{", ".join(found["threads"])}')
    if not found['round_trips_ns']:
        sys.exit(f'an echo ({way}) had no round trip in {duration:g} s: what else is running?')
    return [item * 1e-9 for item in found['round_trips_ns']]


def bare_ticks(duration: float, rate: float = 200.0) -> list[float]:
    """Return |period − T| of an absolute-deadline loop without ROS [s]."""
    with bare('ticks', '--rate', str(rate), '--duration', str(duration)) as ticking:
        woke = np.array(printed_json(ticking)['woke_ns'])
    return list(np.abs(np.diff(woke) * 1e-9 - 1.0 / rate)[round(0.5 * rate):])


def bare_loop(duration: float, folder: Path) -> dict[str, float]:
    """Return the share of a core of bare nodes that send what the loop sends, recorded."""
    recorder = ['-m', 'dz_ros.nodes.main', 'recorder_node', '--ros-args', '-p',
                f'directory:={folder}']
    words = ('--reliable', '--way', 'events')
    with process(recorder, environment(profile=True)) as recording, \
            bare('trajectory', *words, profile=True) as trajectory, \
            bare('controller', *words, profile=True) as controller, \
            bare('plant', *words, '--peers', '1', '--duration', str(duration + 3.0),
                 profile=True) as plant:
        pids = {'plant_node': plant.pid, 'controller_node': controller.pid,
                'trajectory_node': trajectory.pid, 'recorder_node': recording.pid}
        time.sleep(4.0)
        found = shares(pids, duration)
    return found


def stood_in(duration: float, folder: Path) -> Measured:
    """Return what the loop is like with a bare node in the controller's place, recorded."""
    words, env = arguments(folder), environment(profile=True)
    found = Measured()
    with contextlib.ExitStack() as stack:
        pids = {name: stack.enter_context(process(
            ['-m', 'dz_ros.nodes.main', name, *words, *more], env)).pid for name, more in (
                ('recorder_node', ('-p', f'directory:={folder}')), ('trajectory_node', ()),
                ('plant_node', ()))}
        time.sleep(2.0)     # it listens last, as the controller does
        pids['controller_node'] = stack.enter_context(
            bare('stand_in', '--reliable', '--way', 'events', profile=True)).pid
        time.sleep(3.0)
        found.shares = shares(pids, duration)
    judge(found, read_run(folder))
    return found


def arguments(folder: Path, duration: float = 0.0) -> list[str]:
    """Return the arguments of nodes of a loop recorded into `folder`; 0 s = it has no end."""
    parameters = folder.with_suffix('.yaml')
    write_parameters(load_configuration('robust', [f'loop.duration={duration}', 'loop.peers='
                     '[plant_node, controller_node, trajectory_node, recorder_node]']), parameters)
    return ['--ros-args', '--params-file', str(parameters), '--log-level', 'warn']


def interleaved(duration: float, folder: Path) -> tuple[list[float], list[float]]:
    """Return round trips of a recorded loop, and of an echo in its idle time [s].

    The echo runs in the processes of plant and controller (interleaved.py).
    """
    words, env = arguments(folder, duration + SETTLED), environment(profile=True)
    nodes = (('-m', 'dz_ros.nodes.main', 'recorder_node'),
             ('-m', 'dz_ros.nodes.main', 'trajectory_node'), (str(INTERLEAVED), 'controller_node'))
    with contextlib.ExitStack() as stack:
        for start in nodes:
            more = ('-p', f'directory:={folder}') if start[-1] == 'recorder_node' else ()
            stack.enter_context(process([*start, *words, *more], env))
        plant = stack.enter_context(process([str(INTERLEAVED), 'plant_node', *words], env))
        echoed = [item * 1e-9 for item in printed_json(plant)['round_trips_ns']]
    found = Measured()
    judge(found, read_run(folder))
    return found.round_trips, echoed[len(echoed) - len(found.round_trips):]


def shares(pids: dict[str, int], duration: float) -> dict[str, float]:
    """Return the share of a core that processes take for a while, 0 … 1 and more."""
    begin, before = time.monotonic(), {name: cpu_ns(pid) for name, pid in pids.items()}
    time.sleep(duration)
    after = {name: cpu_ns(pid) for name, pid in pids.items()}
    span = time.monotonic() - begin
    return {name: (after[name] - before[name]) * 1e-9 / span for name in pids}


@dataclass
class Measured:
    """What a recorded loop of nodes was like.

    Attributes:
        round_trips: State → command back at the plant, by the plant's clock [s].
        deviations: |period − T| of the states [s].
        too_late: Periods more than T too long.
        late: Periods more than 1 ms too long.
        samples: States.
        lost: Messages that never came to the recorder.
        unanswered: States that were never answered: the controller takes the newest only.
        skipped: Periods without a sample.
        shares: Node → share of a core.
        memory: Node → (seconds, bytes) from time to time.
    """

    round_trips: list[float] = field(default_factory=list)
    deviations: list[float] = field(default_factory=list)
    too_late: int = 0
    late: int = 0
    samples: int = 0
    lost: int = 0
    unanswered: int = 0
    skipped: int = 0
    shares: dict[str, float] = field(default_factory=dict)
    memory: dict[str, list[tuple[float, int]]] = field(default_factory=dict)

    def add(self, other: Measured) -> None:
        """Take another run of the same kind in."""
        self.round_trips += other.round_trips
        self.deviations += other.deviations
        for name in ('too_late', 'late', 'samples', 'lost', 'unanswered', 'skipped'):
            setattr(self, name, getattr(self, name) + getattr(other, name))


def loop(duration: float, directory: Path, *sets: str, memory_every: float = 0.0) -> Measured:
    """Run a loop by `dz run`, recorded, and return what it was like.

    Args:
        duration: [s]
        directory: Of the recording.
        *sets: Further ``KEY=VALUE``.
        memory_every: Interval between two looks at the memory [s]; 0 = none.
    """
    words = ['-m', 'dz_ros', 'run', '--duration', str(duration + SETTLED), '--record',
             str(directory)]
    for item in sets:
        words += ['--set', item]
    found = Measured()
    with process(words, environment()) as running:
        assert running.stdout is not None
        lines: list[str] = []
        begun: tuple[float, dict[str, int]] | None = None
        pids: dict[str, int] = {}
        look = memory_every
        for line in running.stdout:
            lines.append(line)
            seen = re.match(r't +([\d.]+) s', line)
            if seen is None:
                continue
            t = float(seen[1])
            if begun is None:
                if t < SETTLED:
                    continue
                pids = nodes_below(running.pid)
                begun = time.monotonic(), {name: cpu_ns(pid) for name, pid in pids.items()}
            elif t < duration + SETTLED - 0.5:
                span = time.monotonic() - begun[0]
                found.shares = {name: (cpu_ns(pid) - begun[1][name]) * 1e-9 / span
                                for name, pid in pids.items()}
            if memory_every and t >= look:
                look += memory_every
                for name, pid in pids.items():
                    found.memory.setdefault(name, []).append((t, resident(pid)))
        if running.wait(TIME_OUT):
            sys.exit(''.join(lines))
    judge(found, read_run(directory))
    return found


def judge(found: Measured, run: RunData) -> None:
    """Add what a recording tells."""
    period = 1.0 / float(run.configuration['loop.rate'])
    state, command = run.channels['state'], run.channels['command']
    seq, rows = first_of_each(state['seq'])
    settled = state['stamp'][rows] >= SETTLED
    trips = state['round_trip'][rows][settled]
    found.round_trips = list(trips[trips > 0.0])
    steps = np.diff(state.publish_time[rows][settled]) * 1e-9
    off = steps - period * np.diff(seq[settled])
    skips = np.rint(np.diff(state['stamp'][rows][settled]) / period) - 1.0
    found.deviations = list(np.abs(off))
    found.late = int(np.count_nonzero(off > 1e-3))
    found.too_late = int(np.count_nonzero(off > period))
    found.skipped = int(skips.sum())
    found.samples = int(np.count_nonzero(settled))
    for channel in run.channels.values():
        numbers = channel['seq'][channel['seq'] >= 0.0]
        found.lost += round(float(np.ptp(numbers))) + 1 - len(np.unique(numbers))
    found.unanswered = len(np.setdiff1d(seq, command['echo_seq']))
