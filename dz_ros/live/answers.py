# SPDX-License-Identifier: Apache-2.0
"""Requests of viewers and their answers.

An e-stop is done as soon as it is read. Other requests are handled one by one for each viewer, and
any e-stop cancels those accepted before it: an earlier reset must not undo it. An action carries
the time of its request by the server's clock; an old one is refused, since the loop has changed.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

from dz_ros.errors import DzRosError, LoopError
from dz_ros.live.access import Access
from dz_ros.live.clock import clock
from dz_ros.live.requests import finite, parse, ProtocolError, result
from dz_ros.live.viewer import Viewer

ACTIONS = frozenset(('reset', 'activate', 'deactivate', 'set', 'disturbance_pulse', 'commission'))
QUESTIONS = frozenset(('rows', 'histogram', 'axis'))
OLD = 3.0
"""An action that was asked for longer ago than this is refused [s]."""


class Answers:
    """Answers the viewers of one server, each from the source that it is shown.

    Args:
        access: Permissions.
        kinds: aiohttp's kinds of messages.
    """

    def __init__(self, access: Access, kinds: Any) -> None:
        self._access = access
        self._kinds = kinds
        self._tasks: set[asyncio.Task[None]] = set()

    def close(self) -> None:
        """Give up what is being worked on."""
        for task in list(self._tasks):
            task.cancel()

    def receive(self, viewer: Viewer, message: Any) -> None:
        """Take a request.

        Raises:
            ProtocolError: It is none, or one too many.
        """
        request = parse(message, self._kinds)
        if not viewer.budget.spend(time.monotonic()):
            raise ProtocolError('too many requests')
        what, number = request.get('do'), request.get('id')
        if not isinstance(what, str) or isinstance(number, bool) or not isinstance(number, int) \
                or not 0 <= number < 2 ** 31:
            raise ProtocolError('do and id expected')
        if what == 'estop':     # at once: nothing that is being worked on holds it up
            viewer.send(self._stop(viewer, number))
        elif what in ACTIONS or what in QUESTIONS:
            if viewer.busy:
                viewer.send(result(number, False, 'another request is being worked on'))
                return
            viewer.busy = True
            task = asyncio.create_task(self._work(viewer, what, number, request,
                                                  viewer.source.stops))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            raise ProtocolError('no such request')

    def _stop(self, viewer: Viewer, number: int) -> dict[str, Any]:
        if not viewer.may_act:
            return result(number, False, self._access.why_not(viewer.token))
        try:
            return {**result(number, True, ''), **viewer.source.estop(viewer.name)}
        except DzRosError as error:
            return result(number, False, str(error))

    async def _work(self, viewer: Viewer, what: str, number: int, request: dict[str, Any],
                    stops: int) -> None:
        """Work on a request and answer it."""
        try:
            if what in QUESTIONS:
                found = await viewer.source.ask(request)
                if isinstance(found, bytes):
                    await viewer.give(found)    # the next one when this one has left
                    return
                answer = {**result(number, True, ''), **found}
            elif not viewer.may_act:
                answer = result(number, False, self._access.why_not(viewer.token))
            else:
                self._fresh(request)
                answer = {**result(number, True, ''),
                          **await viewer.source.act(viewer.name, request, stops)}
        except DzRosError as error:
            answer = result(number, False, str(error))
        finally:
            viewer.busy = False
        viewer.send(answer)

    def _fresh(self, request: dict[str, Any]) -> None:
        """Refuse what was asked for long ago."""
        asked = finite(request.get('asked'))
        if asked is None:
            raise LoopError('not done: the request carries no time')
        age = clock() - asked
        if not abs(age) <= OLD:
            raise LoopError(f'not done: it was asked {age:.1f} s ago, more than {OLD:g} s')
