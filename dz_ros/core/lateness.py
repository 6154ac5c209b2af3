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
KEPT_UP = 0.01
"""Share of skipped samples up to which a machine kept up with the loop."""


def fell_behind(samples: int, skipped: int) -> str:
    """Return as text that a machine did not keep up with the loop; '' where it did.

    Args:
        samples: Number of samples there were.
        skipped: Number of those that were never begun.
    """
    whole = samples + skipped
    if skipped <= KEPT_UP * whole:
        return ''
    return (f'the machine did not keep up: {skipped} of {whole} samples were skipped '
            f'({100.0 * skipped / whole:.3g} %)')
