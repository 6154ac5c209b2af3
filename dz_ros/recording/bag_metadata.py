# SPDX-License-Identifier: Apache-2.0
"""rosbag2's ``metadata.yaml``: written as version 9 (Jazzy) for one MCAP file, read as any.

The same fields in the same order as rosbag2_storage writes them; compression is left empty
because the chunks inside the MCAP file are compressed, not the file or its messages. What is read
is a description by another program; where the two differ the storage decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
import errno
import os
from pathlib import Path
from typing import Any

import yaml

from dz_ros.files.yaml12 import parse, parse_file, YamlError

FILE_NAME = 'metadata.yaml'
_NO_MESSAGE = 2**63 - 1
"""Start of a bag without messages."""
VERSIONS = range(1, 10)
"""Versions of metadata.yaml there are."""
_ROOT = 'rosbag2_bagfile_information'
# What rosbag2 wrote before metadata version 9: the numbers of rmw/types.h.
_NUMBERS = {'history': {1: 'keep_last', 2: 'keep_all'},
            'reliability': {1: 'reliable', 2: 'best_effort'},
            'durability': {1: 'transient_local', 2: 'volatile'}}


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
    """Write metadata.yaml so that it is there whole or not at all; never over another one.

    Raises:
        OSError: It cannot be written, or is there.
    """
    if (directory / FILE_NAME).exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
    temporary = directory / f'{FILE_NAME}.tmp'
    try:
        temporary.write_text(to_yaml({_ROOT: dict(contents)}),
                             encoding='utf-8')
        temporary.replace(directory / FILE_NAME)
    except OSError:
        with suppress(OSError):
            temporary.unlink()
        raise


def read_metadata(directory: Path) -> tuple[dict[str, Any], str]:
    """Return the contents of metadata.yaml, and why there are none.

    Returns:
        ``rosbag2_bagfile_information``, {} where there is none; what is wrong with it, '' where it
        is right or is not there.
    """
    path = directory / FILE_NAME
    try:
        if not path.is_file():
            return {}, ''
        contents = parse_file(path, aliases=True)
    except (OSError, YamlError) as error:
        return {}, f'it cannot be read: {getattr(error, "strerror", None) or error}'
    found = contents.get(_ROOT) if isinstance(contents, dict) else None
    return (found, '') if isinstance(found, dict) and found else ({}, f'it has no {_ROOT}')


def read_qos(profiles: Any) -> list[dict[str, Any]]:
    """Return the profiles of a topic's publishers with their policies as text.

    Args:
        profiles: A list, or the text of one, as rosbag2 of any version writes it; what is none
            has no profiles.
    """
    if isinstance(profiles, str):
        try:
            profiles = parse(profiles, aliases=True)
        except YamlError:
            profiles = None
    return [{**item, **{policy: _word(policy, item.get(policy)) for policy in _NUMBERS}}
            for item in profiles if isinstance(item, dict)] if isinstance(profiles, list) else []


def _word(policy: str, value: Any) -> str:
    """Return a policy's value as text, '' where it is not given."""
    if isinstance(value, str):
        return value
    return _NUMBERS[policy].get(value, '') if type(value) is int else ''
