# SPDX-License-Identifier: Apache-2.0
"""Inputs of a controller in a run, sample by sample: state answered and reference used.

The terms of each command name both. Fed in this order to a controller that waits for its
reference, the same law meets the same numbers again, however the messages overtook each other on
their way into the log. A reference that was used for another state than it was meant for keeps its
stamp, so that the controller brings it on, and freezes, as it did; its seq becomes that state's.
Without terms in the run, commands name the states, and the reference is
the one of the state's stamp.

The run is streamed; the three messages of a sample must lie within `WINDOW` answers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

from dz_ros.core.loop.controller import SNAP
from dz_ros.core.records import Reference, State
from dz_ros.errors import MessageError, RecordingError
from dz_ros.recording.axes_cdr import decode_axes
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import ARRAY
from dz_ros.recording.run_source import Source

WINDOW = 1000
"""Messages of a topic kept while what belongs to them has not come."""
_SAME_REFERENCE = -1
_NEEDED = {'state': {'echo_stamp', 'round_trip'}, 'reference': {'xd0'},
           'terms': {'reference_seq', 'echo_seq'}, 'command': {'echo_seq'}}
"""Topic → what its labels must name."""


class Exchange(NamedTuple):
    """One sample: the state that was answered, and the reference used, with the state's seq."""

    state: State
    reference: Reference


class Exchanges:
    """The samples of one run.

    Args:
        source: The run.
        namespace: Whose loop, where the run holds several; None = the only one.

    Attributes:
        count: Samples yielded so far.
        missing: Answers without the state or the reference they name: those are not in the run.
        carried: References that were used at another stamp than their own.
        foreign: Messages that are no records of such a loop, as another program may publish.

    Raises:
        RecordingError: The run cannot be read, or lacks one of the topics needed.
    """

    def __init__(self, source: Source, namespace: str | None = None) -> None:
        topics = source.recorded_topics()
        arrays = {name for name, topic in topics.items() if topic.type_name == ARRAY.name}
        places = sorted(name[:-len('state')] for name in arrays if name.endswith('/state'))
        if namespace is not None:
            places = [place for place in places if place.strip('/') == namespace.strip('/')]
        if len(places) != 1:
            raise RecordingError(f'{source.path} holds {"several loops" if places else "no state"}'
                                 f': {", ".join(places or topics) or "no topic at all"}')
        answers = 'terms' if f'{places[0]}terms' in arrays else 'command'
        self._names = {f'{places[0]}{name}': name for name in ('state', 'reference', answers)}
        for topic in self._names:
            if topic not in arrays:
                raise RecordingError(f'{source.path} has no topic {topic}, which is needed to '
                                     'repeat what its controller did')
        self._source = source
        self._codecs: dict[str, ArrayCodec] = {}
        self._states: dict[int, State] = {}
        self._references: dict[int, Reference] = {}
        self._queue: deque[tuple[int, int]] = deque()
        self._last: int | None = None
        self._reason = ''
        self.count = self.missing = self.carried = self.foreign = 0

    def __iter__(self) -> Iterator[Exchange]:
        """Yield them in the order in which they were answered.

        Raises:
            RecordingError: The run cannot be read further, or none of its messages is a record.
        """
        for batch in self._source.batches():
            for message in batch:
                name = self._names.get(message.topic)
                if name is not None:
                    self._take(name, message.payload)
                    yield from self._ready(len(self._queue) > WINDOW)
        while self._queue:
            yield from self._ready(True)
        if self.foreign and not self.count:
            raise RecordingError(self._reason)

    def _ready(self, give_up: bool) -> Iterator[Exchange]:
        """Yield the samples that are complete; give up on the first that is not, if asked to."""
        while self._queue:
            seq, used = self._queue[0]
            if seq != self._last:       # a repeated state is answered again, by the same command
                found = self._find(seq, used)
                if found is not None:
                    self._last = seq
                    self.count += 1
                    yield found
                elif give_up:
                    self.missing += 1
                    give_up = False
                else:
                    return
            self._queue.popleft()

    def _take(self, name: str, payload: bytes) -> None:
        """Keep what is needed of a message."""
        try:
            numbers = self._decode(name, payload)
            if name == 'state':
                state = State.from_numbers(numbers)
                _keep(self._states, state.seq, state)
            elif name == 'reference':
                reference = Reference.from_numbers(numbers)
                _keep(self._references, reference.seq, reference)
            else:
                labels = self._codecs[name].labels
                used = (int(numbers[labels.index('reference_seq')]) if name == 'terms'
                        else _SAME_REFERENCE)
                self._queue.append((int(numbers[labels.index('echo_seq')]), used))
        except (ValueError, OverflowError) as error:    # a seq that is not a number, too
            self.foreign += 1
            self._reason = self._reason or f'{self._source.path}: {name}: {error}'

    def _decode(self, name: str, payload: bytes) -> tuple[float, ...]:
        """Return the numbers of a message."""
        codec = self._codecs.get(name)
        if codec is None:
            axes, labels, _ = decode_axes(payload)
            if axes:
                raise MessageError(f'message of axes {", ".join(axes)}; the commands of a loop '
                                   'of one axis can be repeated')
            if not _NEEDED[name] <= set(labels) or labels[:2] != ('seq', 'stamp'):
                raise MessageError(f'message carries {", ".join(labels) or "no names"}')
            codec = self._codecs[name] = ArrayCodec(labels)
        return codec.decode(payload)

    def _find(self, seq: int, reference_seq: int) -> Exchange | None:
        """Return the sample, its reference as meant for this state; None where one lacks."""
        state = self._states.get(seq)
        if state is None:
            return None
        if reference_seq == _SAME_REFERENCE:
            used = next((item for item in self._references.values()
                         if abs(item.stamp - state.stamp) < SNAP), None)
        else:
            used = self._references.get(reference_seq)
        if used is None:
            return None
        del self._states[seq]
        self.carried += abs(used.stamp - state.stamp) >= SNAP
        return Exchange(state, used._replace(seq=state.seq))


def _keep(kept: dict[int, Any], seq: int, item: Any) -> None:
    """Keep a record; forget the oldest where there are too many."""
    kept.pop(seq, None)
    kept[seq] = item
    if len(kept) > WINDOW:
        del kept[next(iter(kept))]
