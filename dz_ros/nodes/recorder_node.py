"""The recorder as a node: stores every message of the loop's topics as it was received.

Messages are let collect for a while and taken together: waking up for each of them would cost as
much as all other nodes, in the very moments in which those compute. In real time they are taken
between two states of a loop of the recorder's own `loop.rate`, when the loop has its answer and
waits (``runtime/aside.py``). The middleware keeps them, and when they came. A thread of its own
writes the bytes as received (the twin without ROS is ``recording/queued.py``). It records whatever
there is and never holds up the loop, except that the loop's first sample waits for it when
`loop.peers` names it.
"""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import time

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import SingleThreadedExecutor

from dz_ros.core.configuration import Configuration
from dz_ros.core.safety.health import Level, Report
from dz_ros.errors import ConfigurationError, MessageError
from dz_ros.nodes import topics
from dz_ros.nodes.base import LoopNode, SPIN_LIMIT
from dz_ros.nodes.diagnosing import Diagnosing
from dz_ros.nodes.parameters import configure
from dz_ros.nodes.taking import Store, Taker
from dz_ros.recording.arrivals import Arrival, Arrivals
from dz_ros.recording.cdr import decode_string
from dz_ros.recording.channels import CHANNELS
from dz_ros.recording.description import default_info
from dz_ros.recording.queued import QueuedWriter
from dz_ros.recording.writer import RunWriter
from dz_ros.runtime.aside import turn

SERVE = 0.1
"""Services, such as those of the parameters, are served this often [s]."""
BEHIND = 2000
"""More messages than this in the queue mean that the disk does not keep up."""
LEAST, MOST = 0.001, 0.05
"""In real time messages are let collect for times within these, and to the next middle [s]."""
TAKING = 6e-5
"""To take what one sample sends takes about so long [s]."""
LOCKSTEP = 0.01
"""In lockstep messages are let collect for so long [s]."""
GATHER, HOLD = 0.01, 10.0
"""While the loop gathers, it is looked so often who listens, for so long at most [s]."""
QUIET = 0.2
"""The recorder ends when nothing has arrived for this long [s] …"""
DRAIN_LIMIT = 5.0
"""… and in any case this long after it was told to end [s]."""


class RecorderNode(LoopNode):
    """Recorder of one run.

    Raises:
        ConfigurationError: No directory given.
        RunExistsError: The directory exists already.
    """

    def __init__(self) -> None:
        super().__init__('recorder_node', SingleThreadedExecutor())
        self.configuration: Configuration = configure(self, 'loop')
        directory = self.declare_parameter('directory', '', ParameterDescriptor(
            read_only=True, description='directory of the run; must not exist yet')).value
        if not directory:
            raise ConfigurationError('directory', directory, 'must be the directory to record to, '
                                     'one that does not exist yet')
        self._directory = Path(directory)
        self._taker = Taker(self)
        info = {**default_info(), 'mode': self.configuration.loop.timing,
                'namespace': self.get_namespace()}
        self._writer = QueuedWriter(RunWriter(self._directory, info, {}))
        self._arrivals = Arrivals(_epoch(), time.monotonic_ns())
        self._batch: list[Arrival] = []
        self._state_ns = 0      # when the newest state came, by the wall clock
        self._beat = 0.0        # the same by the steady clock [s]
        # Who listens first is served first: where the loop waits for the recorder, it comes last.
        waited_for = self.get_name() in self.configuration.loop.peers
        self._held: list[str] = []
        self._held_until = time.monotonic() + HOLD
        for name, channel in CHANNELS.items():
            qos = channel.qos
            if self.lockstep and name != 'events':      # what topics.LOCKSTEP offers
                qos = replace(qos, history='keep_all', depth=0)
            self._writer.add_topic(self.resolve_topic_name(name), channel.type.name, qos)
            if waited_for and topics.listeners(name):
                self._held.append(name)
            else:
                self._listen(name)
        self._stored = 0
        self._diagnosing = Diagnosing(self, self._report)

    def _listen(self, name: str) -> None:
        """Have a topic's messages taken from now on."""
        topic = self.resolve_topic_name(name)
        self._taker.subscribe(topics.TYPES[name], topic, topics.everything(name, self.lockstep),
                              self._storer(name, topic))

    def _listen_after_others(self) -> None:
        """Listen to the topics that those of the loop who hear them have begun to listen to."""
        late = time.monotonic() > self._held_until
        for name in list(self._held):
            if late or not self.deaf(name, topics.listeners(name, self.lockstep)):
                self._held.remove(name)
                self._listen(name)

    def _report(self) -> Report:
        """Return how the recorder is."""
        report = Report()
        report.put('state', 'active')
        report.put('messages stored', self._stored, 'd')
        report.put('size [MB]', self._size(), '.2f')
        report.put('messages waiting', self._writer.pending, 'd')
        report.put('messages lost', self._writer.lost, 'd')
        report.say(Level.OK, 'recording')
        if self._writer.pending > BEHIND:
            report.say(Level.WARN, f'{self._writer.pending} messages wait for the disk')
        if self._writer.error is not None:
            report.say(Level.ERROR, str(self._writer.error))
        return report

    def _size(self) -> float:
        """Return what is on the disk so far [MB]."""
        try:
            return sum(item.stat().st_size for item in self._directory.iterdir()) * 1e-6
        except OSError:
            return 0.0

    def _storer(self, name: str, topic: str) -> Store:
        """Return the callback that stores a topic's messages."""
        is_event, is_state = name == 'events', name == 'state'

        def store(payload: bytes, source_ns: int, received_ns: int) -> None:
            self._batch.append((received_ns, topic, payload, source_ns))
            if is_event:
                self._keep_configuration(payload)
            elif is_state and received_ns:
                self._state_ns = received_ns

        return store

    def _take(self, timeout: float) -> int:
        """Wait for messages, hand over all that have come in the order of their coming."""
        began_ns = time.monotonic_ns()
        taken = self._taker.take_all(timeout)
        epoch_ns = _epoch()
        self._beat = (self._state_ns - epoch_ns) * 1e-9
        settled = self._arrivals.settle(self._batch, epoch_ns, began_ns, time.monotonic_ns())
        self._writer.put_all([(topic, payload, log_ns, source_ns)
                              for log_ns, topic, payload, source_ns in settled])
        self._batch.clear()
        return taken

    def _keep_configuration(self, payload: bytes) -> None:
        """Store what a node says it runs with in the run's metadata as well."""
        try:
            event = json.loads(decode_string(payload))
        except (MessageError, ValueError):
            return
        if not isinstance(event, dict) or event.get('event') != 'configuration':
            return
        configuration = event.get('configuration', {})
        self._writer.add_metadata(f'dz_ros.node.{event.get("node", "")}',
                                  {'version': str(event.get('version', '')),
                                   'rmw': str(event.get('rmw', '')),
                                   'configuration': json.dumps(configuration)})
        owned = {key: value for key, value in configuration.items()
                 if key.partition('.')[0] in event.get('owns', ())}
        self._writer.add_configuration(owned)

    def _pause(self) -> float:
        """Return for how long messages are let collect now [s]."""
        if self._held:
            return GATHER
        if self.lockstep:
            return LOCKSTEP
        return turn(time.monotonic(), self._beat, self.configuration.loop.period, TAKING, LEAST,
                    MOST)

    def run(self) -> None:
        """Record until told to end and nothing more arrives, or until the disk refuses."""
        served = 0.0
        while not self.stopping and self._writer.error is None:
            if self._held:
                self._listen_after_others()
            self._stored += self._take(GATHER if self._held else SPIN_LIMIT)
            time.sleep(self._pause())
            if time.monotonic() - served > SERVE:
                self._executor.spin_once(timeout_sec=0.0)
                served = time.monotonic()
                self._diagnosing.look()
        if self._writer.error is not None:
            self._diagnosing.publish()
        give_up = time.monotonic() + DRAIN_LIMIT
        while self._take(QUIET) and time.monotonic() < give_up:
            pass

    def close(self) -> None:
        """Write what is queued, close the file and say what was recorded.

        Raises:
            RecordingError: Not everything could be written.
        """
        summary = self._writer.close()
        disorder = ''.join(f', {topic.rpartition("/")[2]}: {found.missing} missing '
                           f'{found.reordered} reordered'
                           for topic, found in summary.topics.items()
                           if found.missing or found.reordered)
        self.get_logger().info(f'{summary.messages} messages in {summary.directory}'
                               f'{disorder or ", none missing"}')
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
