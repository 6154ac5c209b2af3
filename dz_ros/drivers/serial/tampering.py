# SPDX-License-Identifier: Apache-2.0
"""Tampering with the states of an emulated device: a line that repeats, a device that lies (ours).

Works on the frames that the device sends, so that the device in Python and a program are treated
the same. The device itself goes on meanwhile; the mode that it is really in is reported.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
import math

from dz_ros.drivers.serial.framing import pack, Receiver
from dz_ros.drivers.serial.protocol import decode, FrameError, Info, Mode, State

REPLAYED = 500
"""States that are replayed unless the fault gives another number."""

FAULTS: Mapping[str, str] = {
    'repeat': 'for S s the last state is sent in place of each new one',
    'replay': 'for S s the last VALUE states (500) are sent again and again in place of new '
              'ones',
    'double': 'for S s each state is sent twice',
    'clock': 'for S s the clock of the states stands still',
    'echo': 'for S s the echo of the states stands still',
    'unsent': 'for S s the states echo a command that was never sent',
    'mode': 'for S s the states report mode VALUE (2)',
    'swap': 'for S s another device, just started, is at the port',
}
"""Name of each fault → what happens."""
OTHER_NAME = 'another device'


def _lie(change: Callable[[State, State, float], State]
         ) -> Callable[[State, list[State], int, float], list[State]]:
    """Return the fault that changes one field of each state: (state, last one before, value)."""
    return lambda state, before, count, value: [change(state, before[-1], value)]  # noqa: ARG005


_STATES: Mapping[str, Callable[[State, list[State], int, float], list[State]]] = {
    'repeat': _lie(lambda _state, before, _value: before),
    'replay': lambda _state, before, count, _value: [before[count % len(before)]],
    'double': lambda state, _before, _count, _value: [state, state],
    'clock': _lie(lambda state, before, _value: replace(state, time_us=before.time_us)),
    'echo': _lie(lambda state, before, _value: replace(state, echo=before.echo)),
    'unsent': _lie(lambda state, _before, _value: replace(state,
                                                          echo=(state.echo + 10 ** 6) % 2 ** 32)),
    'mode': _lie(lambda state, _before, value: replace(
        state, mode=Mode.SAFE if math.isnan(value) else Mode(int(value)))),
}


class Tampering:
    """Changes frames on their way from the device, by the faults that happen.

    Args:
        moved: Called with each mode that the device is really in, when it changes.
    """

    def __init__(self, moved: Callable[[Mode], None]) -> None:
        self._moved = moved
        self._mode: Mode | None = None
        self._receiver = Receiver()
        self._before: deque[State] = deque(maxlen=REPLAYED)
        self._count = 0

    def pass_on(self, data: bytes, happening: Mapping[str, float]) -> bytes:
        """Return what of the device's bytes goes over the line.

        Args:
            data: What the device sends.
            happening: Name of each fault that happens now → its value, NaN = none given.
        """
        sent = b''
        for body in self._receiver.feed(data):
            try:
                frame = decode(body)
            except FrameError:
                sent += pack(body)      # of a program that speaks otherwise
                continue
            if isinstance(frame, State):
                sent += b''.join(pack(state.body()) for state in self._states(frame, happening))
            elif isinstance(frame, Info) and 'swap' in happening:
                sent += pack(replace(frame, name=OTHER_NAME).body())
            else:
                sent += pack(body)
        return sent

    def _states(self, state: State, happening: Mapping[str, float]) -> list[State]:
        if state.mode is not self._mode:
            self._mode = state.mode
            self._moved(state.mode)
        name = next((name for name in _STATES if name in happening), '')
        if not name or not self._before:
            self._before.append(state)
            self._count = 0
            return [state]
        value = happening[name]
        before = list(self._before)
        if name == 'replay' and not math.isnan(value):
            before = before[-max(int(value), 1):]
        self._count += 1
        return _STATES[name](state, before, self._count - 1, value)
