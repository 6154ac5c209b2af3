# SPDX-License-Identifier: Apache-2.0
"""``dz report --serve``: recorded runs in the browser, by the page of a running loop."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
import signal

from dz_ros.cli.output import note
from dz_ros.cli.progress import stage
from dz_ros.core.dataset import RunData


def serve(runs: Mapping[str, RunData], host: str, port: int) -> int:
    """Serve runs until Ctrl-C; print the address first.

    Raises:
        DzRosError: A run has nothing to show, or the server cannot start.
    """
    from dz_ros.live.access import Access
    from dz_ros.live.recorded_source import Recorded
    from dz_ros.live.server import Server

    with stage('preparing the page'):
        recorded = Recorded(runs)
    for problem in recorded.problems:
        note(problem)
    server = Server(recorded, Access(host, actions=False))

    async def work() -> None:
        ended = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, ended.set)
        address = await server.start(port)
        print(f'recorded run: {address}  (Ctrl-C ends)', flush=True)
        waiting = asyncio.create_task(ended.wait())
        while not waiting.done():
            server.publish()        # drops viewers that do not read
            await asyncio.wait([waiting], timeout=1.0)
        await server.close()

    asyncio.run(work())
    return 0
