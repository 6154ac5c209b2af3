"""What the controller decides before its law, derived again from the stamps in the log.

The reference within a nanosecond of the state's stamp is used as it is, any other is brought there
by its own derivatives; adaptation advances by the interval since the step before where that lies
in [T/2, 2T], by T in the first step, and not at all behind a reference older than 2T
(`dz_ros.core.controller`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.audit_result import Integers
from dz_ros.analysis.audit_samples import Samples
from dz_ros.core.configuration import Configuration
from dz_ros.core.controller import accepted_interval, SNAP
from dz_ros.core.dataset import Channel, RunData
from dz_ros.core.records import Reference, Status

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Decided:
    """What the controller decides before the law, derived from stamps, one entry a step.

    Attributes:
        x_d: References at the states' stamps.
        dt: Accepted intervals [s].
        status: Status bits of the controller, without those of the law.
        known: Whether the interval could be derived, shape (N,).
        carried: Whether the reference was brought to another stamp, shape (N,).
    """

    x_d: list[tuple[float, ...]]
    dt: list[float]
    status: Array
    known: Flags
    carried: Flags


def decide(run: RunData, samples: Samples, rows: Integers, c: Configuration) -> Decided:
    """Derive reference, interval and status of samples as the controller does."""
    period = c.loop.period
    references = run.channels.get('reference')
    at = samples.reference[rows]
    stamp = samples.stamp[rows]
    width = c.plant.order + 1
    if references is None or not len(references):
        table, moved = np.full((len(rows), width), np.nan), np.full(len(rows), np.nan)
    else:
        table = references.values[at][:, 2:2 + width]
        moved = np.where(at >= 0, stamp - references['stamp'][at], np.nan)
    with np.errstate(invalid='ignore'):
        carried = np.abs(moved) >= SNAP
        late = carried & (np.abs(moved) > 2.0 * period)
    x_d = [tuple(row) for row in table.tolist()]
    if references is not None:
        for i in np.flatnonzero(carried).tolist():
            own = Reference(0, float(references['stamp'][at[i]]), x_d[i])
            x_d[i] = own.at(float(stamp[i])).x_d
    follows = samples.follows[rows]
    first = samples.seq[rows] == 0
    earlier = samples.stamp[np.maximum(rows - 1, 0)]
    told = column(run.channels.get('terms'), 'dt', samples.terms[rows])
    bits = column(run.channels.get('terms'), 'status', samples.terms[rows])
    dt = np.array([accepted_interval(before, now, period) for before, now in zip(
        earlier.tolist(), stamp.tolist(), strict=True)], dtype=float)
    dt = np.where(first, period, np.where(follows, dt, told))
    status = np.where(dt > 0.0, 0, int(Status.BAD_INTERVAL)) + late * int(Status.STALE_REFERENCE)
    # What switched the controller off is not among the inputs: taken as recorded.
    sane = np.where((bits >= 0.0) & (bits < 256.0), bits, 0.0).astype(np.int64)
    inactive = sane & int(Status.INACTIVE)
    # So is the freeze where a limit holds the command back; that it does is compared apart.
    limits = c.safety
    frozen = np.where((told == 0.0) & ~late & (inactive == 0) & (
        limits.command_limit + limits.rate_limit + limits.ramp > 0.0),
        sane & int(Status.SATURATED), 0)
    dt[late | (inactive > 0) | (frozen > 0)] = 0.0
    return Decided(x_d, dt.tolist(), (status + inactive + frozen).astype(float), first | follows,
                   carried)


def column(channel: Channel | None, label: str, rows: Integers) -> Array:
    """Return one column at some rows; NaN where there is no row."""
    if channel is None or not len(channel):
        return np.full(len(rows), np.nan)
    return np.where(rows >= 0, channel[label][rows], np.nan)


