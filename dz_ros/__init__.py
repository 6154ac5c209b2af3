# SPDX-License-Identifier: Apache-2.0
"""Robust adaptive control of plants behind an actuator with an unknown dead-zone, on ROS 2.

``import dz_ros as dz`` gives scripts and notebooks the functions of `dz_ros.api`; they are
imported at first use, so that this import loads neither numpy nor ROS.
"""

from __future__ import annotations

TYPE_CHECKING = False       # typing takes as long to import as all of Python's start
if TYPE_CHECKING:
    from typing import Any

__all__ = ['AxesComparison', 'Comparison', 'Configuration', 'DzRosError', 'Findings', 'Law',
           'Plant', 'Run', 'Trajectory', 'check', 'compare', 'from_control', 'load', 'parameter',
           'read', 'simulate', 'sweep', 'to_control']


def __getattr__(name: str) -> Any:
    """Return a function or class of `dz_ros.api`."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from dz_ros import api

    return getattr(api, name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted([*globals(), *__all__])
