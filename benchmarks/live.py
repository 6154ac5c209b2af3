# SPDX-License-Identifier: Apache-2.0
"""The live page: what it costs, how late it is, and whether the loop notices it.

    python benchmarks/live.py [--quick] [--turns N] [--soak] [--write]

One loop of nodes at 200 Hz, recorded, with its page. Stretches without a viewer and with five take
turns within that one run, so that both meet the same machine. A viewer is a WebSocket that takes
every sample of every topic; its delay is from the publishing of a state, by DDS's time-stamp, to
the row's arrival. `--soak` adds ten minutes with five viewers and looks at the server's memory;
`--write` puts the table into docs/looking.md.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Sequence
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.machine import describe  # noqa: E402
from benchmarks.speed_kit.processes import cpu_ns, nodes_below, resident  # noqa: E402
from benchmarks.speed_kit.rows import brief, markdown, Row, say, show, spread  # noqa: E402
from benchmarks.speed_kit.running import environment, process  # noqa: E402
from dz_ros.live.history import HEAD  # noqa: E402
from dz_ros.recording.reader import read_run  # noqa: E402

VIEWERS = 5
SETTLED = 4.0
"""What happens so soon after the start, or after a change of viewers, is not measured [s]."""
SHARE, DELAY, GROWTH = 15.0, 100.0, 2.0
"""Targets: % of a core, ms, MB in ten minutes."""


async def watch(address: str, seconds: float) -> None:
    """Be five viewers for a while; print their delays [s] and what they missed as JSON."""
    import aiohttp

    base, _, token = address.partition('#')
    origin = base.rstrip('/')
    delays: list[float] = []
    missed = 0

    async def look(session: Any) -> None:
        nonlocal missed
        async with session.ws_connect(base + 'ws', headers={'Origin': origin},
                                      max_msg_size=0) as ws:
            await ws.send_json({'hello': 1, 'token': token, 'seconds': 0})
            until = time.monotonic() + seconds
            width, last = 0, -1.0
            async for message in ws:
                now = time.time()
                if message.type is aiohttp.WSMsgType.TEXT:
                    found = json.loads(message.data)
                    if found['kind'] == 'hello':
                        width = len(found['columns'])
                elif width:
                    rows = np.frombuffer(message.data, '<f8', offset=HEAD.size).reshape(-1, width)
                    if len(rows):
                        delays.extend((now - rows[:, 2]).tolist())
                        missed += int(rows[0, 0] - last - 1.0) if last >= 0.0 else 0
                        last = float(rows[-1, 0])
                if time.monotonic() > until:
                    return

    async with aiohttp.ClientSession() as session:
        await asyncio.gather(*(look(session) for _ in range(VIEWERS)))
    print(json.dumps({'delays': delays, 'missed': missed}))


def viewers(address: str, seconds: float) -> subprocess.Popen[str]:
    """Start five viewers, in a process that stands back behind everything measured."""
    return subprocess.Popen(
        ['nice', '-n', '10', sys.executable, str(Path(__file__)), '--watch', address,
         '--seconds', str(seconds)], stdout=subprocess.PIPE, text=True, cwd=ROOT,
        env=environment())


class Stretch:
    """A part of the run: when it was, how many viewers there were, what the server took."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.begin = self.end = 0.0
        self.share = 0.0


def run(folder: Path, seconds: float, counts: Sequence[int]) -> tuple[
        list[Stretch], Any, list[float], int, list[tuple[float, int]]]:
    """Return the stretches of a run with so many viewers each, and what it and they tell.

    That is its recording, delays [s], rows missed, the server's memory.
    """
    total = 10.0 + len(counts) * (seconds + 2.0 * SETTLED)
    words = ['-m', 'dz_ros', 'run', 'robust', '--duration', str(total + 600.0), '--record',
             str(folder / 'run'), '--live', '--quiet']
    stretches, delays, missed, memory = [], [], 0, []
    with process(words, environment()) as loop:
        assert loop.stdout is not None
        address = ''
        while not address:
            line = loop.stdout.readline()
            if 'live page:' in line:
                address = line.split()[-1]
        time.sleep(SETTLED)
        server = nodes_below(loop.pid)['live_node']
        for count in counts:
            stretch = Stretch(count)
            watching = viewers(address, seconds + 2.0 * SETTLED) if stretch.count else None
            time.sleep(SETTLED)
            stretch.begin, before = time.time(), cpu_ns(server)
            while time.time() < stretch.begin + seconds:
                time.sleep(min(10.0, seconds))
                memory.append((time.time(), resident(server)))
            stretch.end = time.time()
            stretch.share = (cpu_ns(server) - before) * 1e-9 / (stretch.end - stretch.begin)
            if watching is not None:
                found = json.loads(watching.communicate(timeout=120.0)[0])
                delays += found['delays']
                missed += found['missed']
            stretches.append(stretch)
            say(f'{stretch.count} viewers: {100.0 * stretch.share:.1f} % of a core, '
                f'{resident(server) / 1e6:.0f} MB')
    return stretches, read_run(folder / 'run'), delays, missed, memory


def pooled(data: Any, stretches: Sequence[Stretch], count: int) -> tuple[list[float], list[float]]:
    """Return round trips and |period − T| of the stretches with so many viewers [s]."""
    state = data.channels['state']
    published = state.publish_time * 1e-9
    trips, periods = [], []
    for stretch in stretches:
        if stretch.count == count:
            inside = (published >= stretch.begin) & (published < stretch.end)
            found = state['round_trip'][inside]
            trips += found[found > 0.0].tolist()
            follows = np.diff(state['seq'][inside]) == 1.0
            periods += np.abs(np.diff(published[inside])[follows] - 0.005).tolist()
    return trips, periods


def rows(folder: Path, seconds: float, turns: int) -> list[Row]:
    """Return the figures of alternating stretches."""
    stretches, data, delays, missed, _ = run(folder, seconds, (0, VIEWERS) * turns)
    trips = {count: pooled(data, stretches, count)[0] for count in (0, VIEWERS)}
    periods = {count: pooled(data, stretches, count)[1] for count in (0, VIEWERS)}
    shares = {count: 100.0 * float(np.mean([item.share for item in stretches
                                            if item.count == count])) for count in (0, VIEWERS)}
    delay = spread(delays, 1e3)
    found = [Row('server with 5 viewers, 200 Hz, all topics', shares[VIEWERS], SHARE,
                 '% of a core', detail=f'{shares[0]:.1f} % without a viewer'),
             Row('from publishing to arrival, p99', delay['p99'], DELAY, 'ms',
                 detail=f'{brief(delay, "ms")}; {len(delays)} rows'),
             Row('rows missed by viewers', missed, 0.0, '')]
    for name, values in (('round trip', trips), ('|period − T|', periods)):
        none, five = (spread(values[count], 1e6) for count in (0, VIEWERS))
        for share in ('p50', 'p99'):
            found.append(Row(f'{name} with 5 viewers over 0, {share}', five[share] / none[share],
                             detail=f'0: {brief(none)}; 5: {brief(five)}' if share == 'p50'
                             else ''))
    late = {count: sum(item > 1e-3 for item in periods[count]) for count in periods}
    found.append(Row('states late by more than 1 ms with 5 viewers',
                     100.0 * late[VIEWERS] / len(periods[VIEWERS]), unit='%',
                     detail=f'{late[0]} of {len(periods[0])} with 0, {late[VIEWERS]} of '
                     f'{len(periods[VIEWERS])} with 5'))
    return found


def soak(folder: Path, seconds: float = 600.0) -> list[Row]:
    """Return how the server's memory grows over ten minutes with five viewers."""
    _, _, delays, missed, memory = run(folder, seconds, (VIEWERS,))
    first = next(size for when, size in memory if when >= memory[0][0] + 0.1 * seconds)
    return [Row(f"{seconds / 60.0:.0f} min: growth of the server's memory since minute one",
                (memory[-1][1] - first) / 1e6, GROWTH, 'MB',
                detail=f'{first / 1e6:.1f} → {memory[-1][1] / 1e6:.1f} MB'),
            Row(f'{seconds / 60.0:.0f} min: rows missed by viewers', missed, 0.0, '',
                detail=f'{len(delays)} rows')]


def write(found: Sequence[Row]) -> None:
    """Put the table into docs/looking.md."""
    path = ROOT / 'docs' / 'looking.md'
    begin, end = '<!-- live figures: benchmarks/live.py -->', '<!-- end of live figures -->'
    text = path.read_text(encoding='utf-8')
    head, _, rest = text.partition(begin)
    table = [f'Measured on {describe("ros-rclpy", "aiohttp", "numpy")}:', '', *markdown(found)]
    path.write_text(f'{head}{begin}\n' + '\n'.join(table) + f'\n{end}' + rest.partition(end)[2],
                    encoding='utf-8')


def main() -> int:
    """Print the table; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='short turns')
    parser.add_argument('--turns', type=int, default=3, help='stretches of each kind')
    parser.add_argument('--soak', action='store_true', help='ten minutes as well')
    parser.add_argument('--write', action='store_true', help='into docs/looking.md')
    parser.add_argument('--watch', help=argparse.SUPPRESS)
    parser.add_argument('--seconds', type=float, default=20.0, help='of a stretch')
    arguments = parser.parse_args()
    if arguments.watch:
        asyncio.run(watch(arguments.watch, arguments.seconds))
        return 0
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(describe('ros-rclpy', 'aiohttp', 'numpy'))
    with tempfile.TemporaryDirectory() as name:
        seconds, turns = (5.0, 1) if arguments.quick else (arguments.seconds, arguments.turns)
        found = rows(Path(name) / 'turns', seconds, turns)
        if arguments.soak:
            found += soak(Path(name) / 'soak')
    if arguments.write:
        write(found)
    return show(found)


if __name__ == '__main__':
    sys.exit(main())
