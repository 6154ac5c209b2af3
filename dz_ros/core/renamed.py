# SPDX-License-Identifier: Apache-2.0
"""Public names of earlier versions and the names they have now.

Recordings and events keep the names of the version that made them. They are translated where they
enter: events in `dz_ros.core.events.parse`, stored configurations in
`dz_ros.recording.run_description.unpack_configuration`. A name that a user types is not
translated: the error names the new one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

KEYS: Mapping[str, str] = {'plant.kick': 'plant.disturbance_pulse'}
"""Configuration keys, earlier → now."""
ACTIONS: Mapping[str, str] = {'kick': 'disturbance_pulse'}
"""Values of `ActionEvent.action`, earlier → now."""
OPTIONS: Mapping[str, str] = {'--kick': '--pulse'}
"""Options of ``dz``, earlier → now."""


def current_keys(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted keys by their present names; a present name wins over an earlier one."""
    found = {KEYS.get(key, key): value for key, value in flat.items()}
    return {key: flat.get(key, value) for key, value in found.items()}
