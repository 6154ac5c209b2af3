# SPDX-License-Identifier: Apache-2.0
"""``dz report --serve``: recorded runs in the browser, by the page of a running loop."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
import signal

from dz_ros.cli.output import note
from dz_ros.cli.progress import stage
from dz_ros.core.dataset import RunData
from dz_ros.report.axes import failures, tables
from dz_ros.report.compare import Comparison


def serve(axes: Mapping[str, Mapping[str, RunData]], comparisons: Mapping[str, Comparison],
          host: str, port: int) -> int:
    """Serve runs until Ctrl-C; print the address first.

    Args:
        axes: Axis → name → run of this axis; one axis is called '' and has no summary.
        comparisons: Axis → the same runs, for the summary.
        host: Address of the page.
        port: Its port; 0 = the first free one.

    Raises:
        DzRosError: A run has nothing to show, or the server cannot start.
    """
    from dz_ros.live.access import Access
    from dz_ros.live.recorded_source import Recorded, RecordedAxes
    from dz_ros.live.server import Server

    with stage('preparing the page'):
        recorded = Recorded(axes['']) if '' in axes else RecordedAxes(
            axes, failures(comparisons), tables(comparisons))
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
