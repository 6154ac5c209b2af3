# SPDX-License-Identifier: Apache-2.0
"""Description of a run: host, versions, time, configuration.

Stored as MCAP metadata records, which hold text by name:

    dz_ros.info            mode, plant, law, host, seed, started, versions
    dz_ros.configuration   flat: every dotted key as JSON; loop, plant, controller, trajectory: the
                           keys of each section as YAML
    dz_ros.summary         what the recorder got, written when the run ends

A cut file has no checksum over these records, so each carries its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
import json
import platform
from typing import Any
import zlib

import yaml

from dz_ros.core.renamed import current_keys
from dz_ros.errors import RecordingError

PREFIX = 'dz_ros.'
INFO = f'{PREFIX}info'
RENAMED = 'renamed'
"""Key of the info: JSON of topic → the name it has in a loop without remapping; absent = none."""
CONFIGURATION = f'{PREFIX}configuration'
SUMMARY = f'{PREFIX}summary'
_CHECKSUM = 'crc32'


def default_info() -> dict[str, str]:
    """Return what this process knows: started (now, UTC), host, platform, versions."""
    from dz_ros.version import version
    return {'started': datetime.now(timezone.utc).isoformat(timespec='milliseconds'),
            'host': platform.node(), 'platform': platform.platform(),
            'python': f'{platform.python_implementation()} {platform.python_version()}',
            'dz_ros': version()}


def configuration_info(configuration: Mapping[str, Any]) -> dict[str, str]:
    """Return plant, law and seed of a configuration, as far as it names them."""
    keys = {'plant': 'plant.model', 'law': 'controller.law', 'seed': 'loop.seed'}
    return {name: str(configuration[key]) for name, key in keys.items() if key in configuration}


def pack_configuration(configuration: Mapping[str, Any]) -> dict[str, str]:
    """Return a configuration of dotted keys as the text of a metadata record.

    Raises:
        RecordingError: A value that is no number, text, truth value or list of these.
    """
    sections: dict[str, dict[str, Any]] = {}
    for key, value in configuration.items():
        section, _, name = key.partition('.')
        sections.setdefault(section, {})[name] = value
    try:
        texts = {section: yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
                 for section, values in sections.items()}
        return {'flat': json.dumps(dict(configuration)), **texts}
    except (TypeError, ValueError, yaml.YAMLError) as error:
        raise RecordingError(f'configuration cannot be stored: {error}') from None


def unpack_configuration(record: Mapping[str, str]) -> dict[str, Any]:
    """Return the dotted keys of a metadata record of `pack_configuration`.

    Raises:
        ValueError: It is another record.
    """
    try:
        flat = json.loads(record.get('flat', ''))
    except RecursionError:
        raise ValueError('configuration is nested too deeply') from None
    if not isinstance(flat, dict):
        raise ValueError('configuration is not a mapping')
    return current_keys(flat)


def renamed_topics(info: Mapping[str, str]) -> dict[str, str]:
    """Return topic → its name in a loop without remapping, from the description of a run."""
    try:
        found = json.loads(info.get(RENAMED, '{}'))
    except (ValueError, RecursionError):
        return {}
    if not isinstance(found, dict):
        return {}
    return {name: plain for name, plain in found.items() if isinstance(plain, str)}


def sendable(text: str) -> str:
    """Return the text with what UTF-8 cannot hold (undecodable bytes of a name) replaced."""
    return text.encode('utf-8', 'replace').decode()


def sealed(record: Mapping[str, str]) -> dict[str, str]:
    """Return the record with a checksum over its names and texts."""
    return {**record, _CHECKSUM: _checksum(record)}


def unsealed(record: Mapping[str, str]) -> dict[str, str]:
    """Return the record without its checksum.

    Raises:
        ValueError: The checksum is missing or does not fit.
    """
    rest = {name: text for name, text in record.items() if name != _CHECKSUM}
    if record.get(_CHECKSUM) != _checksum(rest):
        raise ValueError('checksum does not fit')
    return rest


def _checksum(record: Mapping[str, str]) -> str:
    """Return the CRC-32 of the record in eight hexadecimal digits."""
    return f'{zlib.crc32(json.dumps(sorted(record.items())).encode()):08x}'
