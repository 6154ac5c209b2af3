# SPDX-License-Identifier: Apache-2.0
"""The live page as the operator of a commissioning.

live_node serves the page as it serves that of a loop, from the first step to the last. A pair of
sockets joins it to this process: messages of JSON, what the page shows one way
(`nodes/parts/live_commissioning.py`), what its viewers ask the other way. The e-stop of the page
comes by it at once, and by the e-stop's topic as well. Where the page ends, the device is stopped.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
import json
import math
import os
import queue
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from types import TracebackType
from typing import Any

from dz_ros.cli.driver.commission_state import Operator
from dz_ros.cli.driver.identify_moves import CLEAR, NOTHING_MOVED
from dz_ros.cli.options import namespace_name
from dz_ros.cli.output import print_lines
from dz_ros.cli.processes import ask_to_end, ParameterFiles, start_node, wait_or_kill
from dz_ros.core.configuration import Configuration
from dz_ros.errors import DriverError, LoopError
from dz_ros.files.configurations import format_parameters
from dz_ros.identification.commissioning import StepLog
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.runs.metrics import jsonable
from dz_ros.runtime.os_signals import stop_on_signals

PRESSED = 'e-stop pressed in the page'
GONE = 'the live page has ended'
SHOWN = 0.1
"""Moves are shown this often [s]."""
LARGEST = 1 << 16
"""Longest message of the page [bytes]."""
PAGE_TIMEOUT = 5.0
"""A page that does not read for this long misses a message [s]."""
POLL = 0.1
"""A signal is noticed within this while the page is waited for [s]."""


class PageOperator(Operator):
    """Starts the page, asks in it whether the device may move, and takes its e-stop.

    Args:
        arguments: Of the verb: address, namespace, --yes.
        c: The configuration.
        log: The steps so far.
    """

    def __init__(self, arguments: argparse.Namespace, c: Configuration, log: StepLog) -> None:
        super().__init__(arguments.yes)
        self._arguments, self._log = arguments, log
        self._shown: dict[str, Any] = {
            'kind': 'commissioning', 'guided': not self.yes, 'device': c.make_driver().name,
            'folder': str(log.folder), 'limits': {}, 'values': {}, 'running': '', 'question': '',
            'problem': ''}
        self._requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._stop = ''
        self._shown_at = -math.inf
        self._files = ParameterFiles()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket = ours
        name = namespace_name(arguments.namespace)
        page = self._files.add_parameters({
            'host': arguments.host, 'port': arguments.port, 'commissioning': theirs.fileno()})
        words = ['--ros-args', '--params-file', self._files.add(format_parameters(c)),
                 '--params-file', page, *(['-r', f'__ns:=/{name}'] if name else [])]
        try:
            self._process: subprocess.Popen[str] = start_node(
                'live_node', words, inherited=(theirs.fileno(),), stdout=subprocess.PIPE,
                text=True, errors='replace')
        finally:
            theirs.close()

    def __enter__(self) -> PageOperator:
        threading.Thread(target=self._print, name='page', daemon=True).start()
        threading.Thread(target=self._receive, name='requests of the page', daemon=True).start()
        self._show()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        ask_to_end(self._process)
        wait_or_kill(self._process)
        self._socket.close()
        self._files.__exit__(kind, error, trace)

    def offer(self, limits: Mapping[str, str], values: Mapping[str, Any]) -> None:
        """Show which limits are asked, name → unit, and the values known."""
        self._show(limits=dict(limits), values={name: values[name] for name in limits
                                                if name in values})

    def next_request(self) -> tuple[str, dict[str, Any]] | None:
        """Wait for the page; return a step to be made and its values, None = it is to end.

        Raises:
            LoopError: The page has ended by itself.
        """
        with stop_on_signals() as stopping:
            while not stopping.reason:
                try:
                    request = self._requests.get(timeout=POLL)
                except queue.Empty:
                    continue
                if request['do'] == 'gone':
                    raise LoopError(GONE)
                if request['do'] == 'end':
                    return None
                values = request.get('values')
                return request['step'], values if isinstance(values, dict) else {}
        return None

    def failed(self, words: str) -> None:
        """Show why a step could not be made, or was not done."""
        self._show(problem=words)

    # What the steps call.

    def confirm(self, text: str) -> None:
        """Ask in the page whether the device may move; what was pressed before it counts.

        Raises:
            DriverError: It may not, or the e-stop is pressed.
        """
        print_lines(text)
        if not self.yes:
            while not self._answers.empty():
                self._answers.get()
            self._show(question=f'{text}. {CLEAR}')
            print_lines('confirm it in the page')
            try:
                allowed = self._confirmed()
            finally:
                self._show(question='')
            if not allowed and not self._stop:
                raise DriverError(NOTHING_MOVED)
        if self._stop:
            raise DriverError(f'{self._stop}: {NOTHING_MOVED}')

    def _confirmed(self) -> bool:
        with stop_on_signals() as stopping:
            while not (stopping.reason or self._stop):
                try:
                    return self._answers.get(timeout=POLL)
                except queue.Empty:
                    pass
            if stopping.reason:
                self._requests.put({'do': 'end'})
        return False

    def watch(self, moves: Experiment) -> str:
        """Show how far the moves are, some times a second; return why to stop."""
        now = time.monotonic()
        if now - self._shown_at >= SHOWN:
            self._shown_at = now
            repeat = f' {moves.repeat + 1} of {moves.plan.repeats}' if moves.repeat >= 0 else ''
            self._send({'kind': 'moves', 'text': f'{moves.kind}{repeat}, {moves.position:+.4g} '
                        'from where it stood'}, 0.0)
        return self._stop

    def stopped(self) -> str:
        """Return why the device must not move, '' = it may."""
        return self._stop

    def begun(self, step: str) -> None:
        """Show that a step runs."""
        self._show(running=step, problem='')

    def ended(self) -> None:
        """Show what came of it."""
        self._show(running='')

    # The pair of sockets.

    def _show(self, **changed: Any) -> None:
        self._shown.update(changed)
        self._send({**self._shown, 'steps': self._log.overview()})

    def _send(self, message: Mapping[str, Any], patience: float = PAGE_TIMEOUT) -> None:
        """Send a message, unless the page does not read for that long [s]; moves never wait."""
        text = json.dumps(jsonable(dict(message))).encode()
        try:
            if patience:
                select.select((), (self._socket,), (), patience)
            self._socket.send(text, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except OSError:
            pass

    def _receive(self) -> None:
        """Take what the page sends; its end is an e-stop."""
        try:
            while text := self._socket.recv(LARGEST):
                request = json.loads(text)
                if request['do'] == 'estop':
                    self._stop = PRESSED
                elif request['do'] == 'answer':
                    self._answers.put(bool(request['yes']))
                else:
                    self._stop = ''
                    self._requests.put(request)
        except (OSError, ValueError):
            pass
        finally:
            self._stop = GONE
            self._requests.put({'do': 'gone'})
            if self._shown['running'] == 'loop':    # as Ctrl-C, which ends it in order
                os.kill(os.getpid(), signal.SIGINT)

    def _print(self) -> None:
        """Print the address of the page, and what its node logs."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            print_lines(line.rstrip('\n'))
            sys.stdout.flush()
