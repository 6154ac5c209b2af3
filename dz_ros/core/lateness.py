# SPDX-License-Identifier: Apache-2.0
"""What counts as late, for every count, table, log line and picture.

`dz_ros.runtime.deadlines`, which imports the standard library alone, and the live page have it
too; a test holds them to this one.
"""

from __future__ import annotations

LATE = 1e-3
"""Anything later than this after its deadline is late [s]."""
LATE_TEXT = f'{1e3 * LATE:g} ms'
"""The same as text."""
LATE_COUNT = f'late by more than {LATE_TEXT}'
"""Name of the count of late samples in diagnostics."""
