"""rosbag2's ``metadata.yaml``, version 9 (Jazzy), for a bag of one MCAP file.

The same fields in the same order as rosbag2_storage writes them; compression is left empty
because the chunks inside the MCAP file are compressed, not the file or its messages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

FILE_NAME = 'metadata.yaml'
_NO_MESSAGE = 2**63 - 1
"""Start of a bag without messages."""


@dataclass(frozen=True)
class BagTopic:
    """One topic of a bag: name, type, its publishers' QoS as rosbag2 writes it, type hash."""

    name: str
    type_name: str
    qos: Sequence[Mapping[str, Any]]
    type_hash: str


def make_metadata(file_name: str, topics: Sequence[tuple[BagTopic, int]], start_ns: int | None,
                  end_ns: int, custom_data: Mapping[str, str]) -> dict[str, Any]:
    """Return the contents of ``rosbag2_bagfile_information``.

    Args:
        file_name: Name of the MCAP file beside metadata.yaml.
        topics: Topics with their numbers of messages.
        start_ns: Log time of the first message [ns since the epoch]; None = no message.
        end_ns: Log time of the last one.
        custom_data: Free texts.
    """
    start = {'nanoseconds_since_epoch': _NO_MESSAGE if start_ns is None else start_ns}
    duration = {'nanoseconds': 0 if start_ns is None else end_ns - start_ns}
    count = sum(number for _, number in topics)
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        'duration': duration,
        'starting_time': start,
        'message_count': count,
        'topics_with_message_count': [
            {'topic_metadata': {'name': topic.name, 'type': topic.type_name,
                                'serialization_format': 'cdr',
                                'offered_qos_profiles': [dict(item) for item in topic.qos],
                                'type_description_hash': topic.type_hash},
             'message_count': number} for topic, number in topics],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file_name],
        'files': [{'path': file_name, 'starting_time': dict(start), 'duration': dict(duration),
                   'message_count': count}],
        'custom_data': dict(custom_data) or None,
        'ros_distro': 'jazzy',
    }


def to_yaml(contents: Any) -> str:
    """Return contents as YAML text, blocks only, keys in the order given."""
    return str(yaml.safe_dump(contents, sort_keys=False, allow_unicode=True,
                              default_flow_style=False))


def write_metadata(directory: Path, contents: Mapping[str, Any]) -> None:
    """Write metadata.yaml so that it is there whole or not at all.

    Raises:
        OSError: It cannot be written.
    """
    temporary = directory / f'{FILE_NAME}.tmp'
    temporary.write_text(to_yaml({'rosbag2_bagfile_information': dict(contents)}),
                         encoding='utf-8')
    temporary.replace(directory / FILE_NAME)


def read_metadata(directory: Path) -> dict[str, Any] | None:
    """Return what metadata.yaml says of the bag; None where there is none that can be read."""
    try:
        text = (directory / FILE_NAME).read_text(encoding='utf-8')
        contents = yaml.safe_load(text)['rosbag2_bagfile_information']
    except (OSError, ValueError, TypeError, KeyError, RecursionError, yaml.YAMLError):
        return None
    return contents if isinstance(contents, dict) else None
