# SPDX-License-Identifier: Apache-2.0
"""A commissioning as the live page shows it, and what viewers ask of it.

The program that makes the steps (`dz driver commission --live`) has started this process and holds
the other end of a pair of sockets. What it shows is sent to every viewer as it is; of what viewers
ask only what can be done now goes back.
"""

from __future__ import annotations

from collections.abc import Mapping
import json
import socket
from typing import Any

from dz_ros.errors import ConfigurationError, LoopError

LARGEST = 1 << 20
"""Longest message [bytes]."""
MAX_MESSAGES = 100
"""Most messages taken at once."""
MAX_VALUES = 20
"""Most limits that a viewer may give."""
GONE = 'the program that makes the steps has ended'


class Commissioning:
    """The steps, seen from the page.

    Args:
        descriptor: This process's end of the pair of sockets.

    Attributes:
        shown: The newest overview; empty = none yet.
        stopped: Whether the e-stop was pressed in the page and not reset since.

    Raises:
        ConfigurationError: It is no such end.
    """

    def __init__(self, descriptor: int) -> None:
        try:
            self._socket = socket.socket(fileno=descriptor)
        except OSError as error:
            raise ConfigurationError('commissioning', descriptor, 'must be the socket of dz '
                                     f'driver commission ({error.strerror})') from None
        self.shown: dict[str, Any] = {}
        self.stopped = False
        self._gone = False

    @property
    def title(self) -> str:
        """What it is about, in a few words."""
        return f'commissioning of {self.shown.get("device", "a device")}'

    def news(self) -> list[dict[str, Any]]:
        """Return the messages for viewers that have come since the last time."""
        found: list[dict[str, Any]] = []
        while not self._gone and len(found) < MAX_MESSAGES:
            try:
                text = self._socket.recv(LARGEST, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except OSError:
                text = b''
            if not text:
                self._gone = True
                self.shown = {**self.shown, 'running': '', 'question': '', 'problem': GONE,
                              'gone': True}
                found.append(self.shown)
                break
            message = json.loads(text)
            if message['kind'] == 'commissioning':
                self.shown = message
            found.append(message)
        return found

    def estop(self) -> None:
        """Pass a press of the e-stop on; no step begins until `stopped` is cleared.

        Raises:
            LoopError: The other end does not take it.
        """
        self.stopped = True
        self._send({'do': 'estop'})

    def ask(self, request: Mapping[str, Any], pressed: bool) -> str:
        """Pass a request of a viewer on; return what was asked.

        Args:
            request: `what`: ``step`` with `step` and `values`, ``answer`` with `yes`, ``end``.
            pressed: Whether the e-stop is pressed.

        Raises:
            LoopError: It cannot be done now, and why.
        """
        what = request.get('what')
        if self._gone or not self.shown:
            raise LoopError(GONE if self._gone else 'the steps are not known yet')
        if not self.shown.get('guided'):
            raise LoopError('the steps go on by themselves (--yes)')
        if pressed and not (what == 'end' or (what == 'answer' and request.get('yes') is False)):
            raise LoopError('the e-stop is pressed: reset first')
        if what == 'answer':
            if not self.shown.get('question'):
                raise LoopError('nothing is asked')
            self._send({'do': 'answer', 'yes': request.get('yes') is True})
            return 'it may move' if request.get('yes') is True else 'it may not move'
        if self.shown.get('running'):
            raise LoopError(f'step {self.shown["running"]} is being made')
        if what == 'end':
            self._send({'do': 'end'})
            return 'ended'
        if what != 'step':
            raise LoopError('a step, an answer or the end is expected')
        return self._step(request.get('step'), request.get('values'))

    def _step(self, name: Any, values: Any) -> str:
        step = next((item for item in self.shown['steps'] if item['step'] == name), None)
        if step is None:
            raise LoopError('no such step')
        if step['lacking']:
            raise LoopError(f'step {step["lacking"]} has not been done')
        given = values if isinstance(values, dict) and len(values) <= MAX_VALUES else {}
        self._send({'do': 'step', 'step': name, 'values': given})
        self.shown = {**self.shown, 'running': name}    # until the other end states it
        return f'step {name} begins'

    def _send(self, message: Mapping[str, Any]) -> None:
        """Send a message.

        Raises:
            LoopError: The other end does not take it.
        """
        try:
            self._socket.send(json.dumps(message).encode(),
                              socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except OSError as error:
            raise LoopError(f'{GONE} or does not answer ({error.strerror})') from None
