"""The recorder as a node: stores every message of the loop's topics as it was received.

Callbacks only put the received bytes into a queue; a thread of its own writes them (the twin
without ROS is ``recording/queued.py``). It records whatever there is and never holds up the loop,
except that the loop's first sample waits for it when `loop.peers` names it.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import time

from rcl_interfaces.msg import ParameterDescriptor

from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError, MessageError
from dz_ros.nodes import topics
from dz_ros.nodes.base import LoopNode
from dz_ros.nodes.parameters import configure
from dz_ros.recording.cdr import decode_string
from dz_ros.recording.channels import CHANNELS
from dz_ros.recording.queued import QueuedWriter
from dz_ros.recording.writer import default_info, RunWriter

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
        super().__init__('recorder_node')
        self.configuration: Configuration = configure(self, 'loop')
        directory = self.declare_parameter('directory', '', ParameterDescriptor(
            read_only=True, description='directory of the run; must not exist yet')).value
        if not directory:
            raise ConfigurationError('directory', directory, 'must be the directory to record to, '
                                     'one that does not exist yet')
        self._received = 0
        self._received_at = 0.0
        info = {**default_info(), 'mode': self.configuration.loop.timing,
                'namespace': self.get_namespace()}
        self._path = Path(directory)
        self._writer = QueuedWriter(RunWriter(self._path, info, {}))
        # Log times advance with the steady clock: a step of the wall clock must not reorder a run.
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        for name, channel in CHANNELS.items():
            topic = self.resolve_topic_name(name)
            self._writer.add_topic(topic, channel.type.name, channel.qos)
            self.create_subscription(topics.TYPES[name], topic, self._storer(name, topic),
                                     topics.everything(name, self.lockstep), raw=True)

    def _storer(self, name: str, topic: str) -> Callable[[bytes, dict[str, int]], None]:
        """Return the callback that stores a topic's messages."""
        put, epoch_ns = self._writer.put, self._epoch_ns
        is_event = name == 'events'

        def store(payload: bytes, info: dict[str, int]) -> None:
            now_ns = time.monotonic_ns()
            put(topic, payload, now_ns + epoch_ns, info['source_timestamp'])
            self._received += 1
            self._received_at = now_ns * 1e-9
            if is_event:
                self._keep_configuration(payload)

        return store

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

    def run(self) -> None:
        """Record until told to end and nothing more arrives, or until the disk refuses."""
        while not self.stopping and self._writer.error is None:
            self._executor.spin_once(timeout_sec=0.05)
        told = time.monotonic()
        while time.monotonic() < min(told + DRAIN_LIMIT, max(told, self._received_at) + QUIET):
            self._executor.spin_once(timeout_sec=QUIET)

    def close(self) -> None:
        """Write what is queued, close the file and say what was recorded."""
        summary = self._writer.close()
        self.get_logger().info(f'{self._path}: {summary}')
        super().close()
