# SPDX-License-Identifier: Apache-2.0
"""The recorder as a node: stores every message of the loop's topics as it was received.

Messages collect for a while and are polled together: waking up for each of them would cost as
much as all other nodes, in the very moments in which those compute. In real time they are polled
between two states of a loop of the recorder's own `loop.rate`, when the loop has its answer and
waits (``runtime/phase_offset.py``). The middleware keeps them, and when they came. A thread
writes the bytes as received (``recording/writer_thread.py``). The loop never waits for it, except
before its first sample when `loop.peers` names the recorder.
"""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import time

from rclpy.executors import SingleThreadedExecutor

from dz_ros.core.configuration import Configuration
from dz_ros.core.events import ConfigurationEvent
from dz_ros.core.safety.health import Level, Rejections, Report
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.nodes.ros import topics
from dz_ros.nodes.ros.base import LoopNode, SPIN_LIMIT
from dz_ros.nodes.ros.diagnostics import Diagnostics
from dz_ros.nodes.ros.parameters import configure
from dz_ros.nodes.ros.polling import Store
from dz_ros.recording.arrivals import Arrival, Arrivals
from dz_ros.recording.channels import CHANNELS
from dz_ros.recording.run_description import default_info, RENAMED
from dz_ros.recording.writer import RunWriter
from dz_ros.recording.writer_thread import QueuedWriter
from dz_ros.runs.history import RunHistory
from dz_ros.runtime.phase_offset import collecting_time

SERVICE_PERIOD = 0.1
"""Services, such as those of the parameters, are served this often [s]."""
MAX_WAITING_MESSAGES = 2000
"""More messages than this in the queue mean that the disk does not keep up."""
BACKLOG_BYTES = 16 * 2**20
"""What the disk refuses waits in memory up to this size, five minutes of a loop at 200 Hz."""
COLLECTING_TIMES = (0.001, 0.05)
"""In real time messages collect for times within these, and to the next middle [s]."""
TIME_PER_SAMPLE = 6e-5
"""Duration of taking what one sample sends, about [s]."""
LOCKSTEP_COLLECTING_TIME = 0.01
"""Time for which messages collect in lockstep [s]."""
SUBSCRIBER_POLL_PERIOD, SUBSCRIBER_WAIT_LIMIT = 0.01, 10.0
"""While the loop gathers, its subscribers are checked at this period, up to this time [s]."""
MAX_NODES = 64
"""Nodes whose stated configuration is kept in the run's metadata."""
QUIET_TIME = 0.2
"""The recorder ends when nothing has arrived for this long [s] …"""
DRAIN_LIMIT = 5.0
"""… and in any case this long after the signal to end [s]."""


class RecorderNode(LoopNode):
    """Recorder of one run.

    Raises:
        ConfigurationError: No directory given.
        RunExistsError: The directory exists already.
    """

    def __init__(self) -> None:
        super().__init__('recorder_node', SingleThreadedExecutor())
        self.configuration: Configuration = configure(self, 'loop')
        directory = self.given('directory', '', 'directory of the run; must not exist yet')
        if not directory:
            raise ConfigurationError('directory', directory, 'must be the directory to record to, '
                                     'one that does not exist yet')
        self._directory = Path(directory)
        info = {**default_info(), 'mode': self.configuration.loop.timing,
                'namespace': self.get_namespace()}
        place = self.get_namespace().rstrip('/')
        renamed = {self.resolve_topic_name(name): f'{place}/{name}' for name in CHANNELS
                   if self.resolve_topic_name(name) != f'{place}/{name}'}
        if renamed:
            info[RENAMED] = json.dumps(renamed)
        self._writer = QueuedWriter(RunWriter(self._directory, info, {},
                                              backlog=BACKLOG_BYTES))
        self._arrivals = Arrivals(_epoch(), time.monotonic_ns())
        self._batch: list[Arrival] = []
        self._state_ns = 0      # when the newest state came, by the wall clock
        self._tick = 0.0        # the same by the steady clock [s]
        # The first subscriber is served first: a recorder the loop waits for subscribes last.
        waited_for = self.get_name() in self.configuration.loop.peers
        self._held: list[str] = []
        self._held_until = time.monotonic() + SUBSCRIBER_WAIT_LIMIT
        for name, channel in CHANNELS.items():
            qos = channel.qos
            if self.lockstep and name != 'events':      # what topics.LOCKSTEP offers
                qos = replace(qos, history='keep_all', depth=0)
            self._writer.add_topic(self.resolve_topic_name(name), channel.type.name, qos)
            if waited_for and topics.listeners(name):
                self._held.append(name)
            else:
                self._subscribe(name)
        self._stored = 0
        self._condition = ''
        self._reported: RecordingError | None = None
        self._behind = False
        self._stated: set[str] = set()
        self._history = RunHistory(keep=0)
        self._rejections = Rejections()
        self._diagnostics = Diagnostics(self, self._report)

    def _subscribe(self, name: str) -> None:
        self.polled.subscribe(topics.TYPES[name], name, topics.everything(name, self.lockstep),
                              self._storer(name, self.resolve_topic_name(name)))

    def _subscribe_after_others(self) -> None:
        """Subscribe to the topics to which the loop's own subscribers have subscribed."""
        late = time.monotonic() > self._held_until
        for name in list(self._held):
            if late or not self.not_subscribing(name, topics.listeners(name, self.lockstep)):
                self._held.remove(name)
                self._subscribe(name)

    def _report(self) -> Report:
        report = Report()
        report.put('state', 'active')
        report.put('messages stored', self._stored, 'd')
        report.put('size [MB]', self._size(), '.2f')
        report.put('messages waiting', self._writer.pending, 'd')
        report.put('messages lost', self._writer.lost, 'd')
        report.summarize(Level.OK, 'recording')
        self._rejections.report(report, self.ignored({}))
        if self._writer.pending > MAX_WAITING_MESSAGES:
            report.summarize(Level.WARN, f'{self._writer.pending} messages wait for the disk')
        if self._writer.condition:
            report.summarize(Level.ERROR, self._writer.condition)
        elif self._writer.error is not None:
            report.summarize(Level.ERROR, str(self._writer.error))
        return report

    def _size(self) -> float:
        try:
            return sum(item.stat().st_size for item in self._directory.iterdir()) * 1e-6
        except OSError:
            return 0.0

    def _watch_disk(self) -> None:
        """Log at once what the disk refuses, what is lost by that, and its end."""
        writer, log = self._writer, self.get_logger()
        condition, error = writer.condition, writer.error
        if condition != self._condition:
            if condition:
                log.error(condition)
            elif not writer.broken:
                log.warning(f'{self._directory} is written again; messages lost meanwhile: '
                            f'{writer.lost}')
            self._condition = condition
            self._diagnostics.publish()
        if error is not None and error is not self._reported:
            self._reported = error
            if not condition:
                log.error(f'{error}; the loop goes on')
            self._diagnostics.publish()
        directory = writer.directory
        if directory != self._directory:
            log.warning(f'{self._directory} was moved to {directory} while it was recorded; the '
                        'recording goes on there')
            self._directory = directory
        behind = writer.pending > MAX_WAITING_MESSAGES
        if behind and not self._behind:
            log.warning(f'{writer.pending} messages wait for the disk, which does not keep up')
        self._behind = behind

    def _storer(self, name: str, topic: str) -> Store:
        is_event, is_state = name == 'events', name == 'state'

        def store(payload: bytes, source_ns: int, received_ns: int) -> None:
            self._batch.append((received_ns, topic, payload, source_ns))
            if is_event:
                self._keep_configuration(payload)
            elif is_state and received_ns:
                self._state_ns = received_ns

        return store

    def _take(self, timeout: float) -> int:
        """Wait for messages, hand over all that have come in the order of their arrival."""
        began_ns = time.monotonic_ns()
        taken = self.polled.poll(timeout)
        epoch_ns = _epoch()
        self._tick = (self._state_ns - epoch_ns) * 1e-9
        settled = self._arrivals.settle(self._batch, epoch_ns, began_ns, time.monotonic_ns())
        self._writer.put_all([(topic, payload, log_ns, source_ns)
                              for log_ns, topic, payload, source_ns in settled])
        self._batch.clear()
        return taken

    def _keep_configuration(self, payload: bytes) -> None:
        """Store what a node runs with in the run's metadata as well."""
        event = self.parse_event(payload)
        if not isinstance(event, ConfigurationEvent):
            return
        if event.node not in self._stated and len(self._stated) >= MAX_NODES:
            self.refuse('events', f'a configuration of more than {MAX_NODES} nodes', event.node)
            return
        self._stated.add(event.node)
        self._writer.add_metadata(f'dz_ros.node.{event.node}',
                                  {'version': event.version, 'rmw': event.rmw,
                                   'configuration': json.dumps(event.configuration)})
        self._history.add(event)
        self._writer.add_configuration(self._history.owned)

    def _pause(self) -> float:
        """Return for how long messages are to collect now [s]."""
        if self._held:
            return SUBSCRIBER_POLL_PERIOD
        if self.lockstep:
            return LOCKSTEP_COLLECTING_TIME
        return collecting_time(time.monotonic(), self._tick, self.configuration.loop.period,
                               TIME_PER_SAMPLE, *COLLECTING_TIMES)

    def run(self) -> None:
        """Record until it is to end and nothing more arrives, whatever the disk does."""
        served = 0.0
        while not self.stopping:
            if self._held:
                self._subscribe_after_others()
            self._stored += self._take(SUBSCRIBER_POLL_PERIOD if self._held else SPIN_LIMIT)
            self._watch_disk()
            time.sleep(self._pause())
            if time.monotonic() - served > SERVICE_PERIOD:
                self._executor.spin_once(timeout_sec=0.0)
                served = time.monotonic()
                self._diagnostics.publish_if_due()
        give_up = time.monotonic() + DRAIN_LIMIT
        while self._take(QUIET_TIME) and time.monotonic() < give_up:
            pass

    def close(self) -> None:
        """Write what is queued, close the file and log what was recorded.

        Raises:
            RecordingError: Not everything could be written.
        """
        summary = self._writer.close()
        log = self.get_logger()
        disorder = ''.join(f', {topic.rpartition("/")[2]}: {found.missing} missing '
                           f'{found.reordered} reordered'
                           for topic, found in summary.topics.items()
                           if found.missing or found.reordered)
        text = f'{summary.messages} messages in {summary.directory}'
        if summary.lost or not summary.complete:
            log.error(f'{text}{disorder}, {summary.lost} lost'
                      + ('' if summary.complete else '; the recording is not complete'))
        else:
            log.info(f'{text}{disorder or ", none missing"}')
        super().close()
        if self._writer.error is not None:
            raise self._writer.error


def _epoch() -> int:
    """Return the wall's time at zero of the steady clock [ns], read while nothing interrupts."""
    found = []
    for _ in range(3):
        before, wall, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        found.append((after - before, wall - (before + after) // 2))
    return min(found)[1]
