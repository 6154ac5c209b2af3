# SPDX-License-Identifier: Apache-2.0
"""Observers of states that are not measured, one class a file."""

from __future__ import annotations

from dz_ros.core.observers.base import Observer
from dz_ros.core.observers.difference import Difference
from dz_ros.core.observers.levant import Levant
from dz_ros.core.observers.luenberger import Luenberger
from dz_ros.core.observers.tracking import Tracking

__all__ = ['OBSERVERS', 'Observer']

OBSERVERS: dict[str, type[Observer]] = {item.name: item for item in (
    Tracking, Luenberger, Levant, Difference)}
"""Name in configurations → class."""
