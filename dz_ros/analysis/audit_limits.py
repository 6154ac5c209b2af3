"""What the limits of the section ``safety`` make of the law's commands, derived again.

A command leaves the controller through one gate (`dz_ros.core.safety.gate`); its ramp and rate
begin at the safe command whenever the law takes over, which is at the first command, after a
sample in which the law was not asked, and after a gap. A sample in which it was not asked carries
the safe command, with terms of zero, and leaves the memory alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dz_ros.analysis.audit_decisions import column
from dz_ros.analysis.audit_result import Integers, Tally
from dz_ros.analysis.audit_samples import Samples
from dz_ros.analysis.audit_steps import Outputs
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.records import Status, TERM_NAMES
from dz_ros.core.safety.gate import OutputGate

Flags = NDArray[np.bool_]


def resting(run: RunData, samples: Samples, rows: Integers) -> Flags:
    """Return which samples say that the law was not asked."""
    bits = column(run.channels.get('terms'), 'status', samples.terms[rows])
    sane = np.where((bits >= 0.0) & (bits < 256.0), bits, 0.0).astype(np.int64)
    return (sane & int(Status.INACTIVE)) > 0


def compare_resting(run: RunData, samples: Samples, rows: Integers, c: Configuration,
                    tally: Tally) -> None:
    """Compare samples in which the law was not asked with the safe command."""
    wanted = {'command': {'v': c.safety.safe_command},
              'terms': {**dict.fromkeys(TERM_NAMES, 0.0), 'v_extra': c.safety.safe_command,
                        'dt': 0.0, 'status': float(Status.INACTIVE)}}
    for name, fields in wanted.items():
        channel = run.channels.get(name)
        at = rows[getattr(samples, name)[rows] >= 0]
        if channel is None or not len(channel):
            continue
        for label, value in fields.items():
            tally.add(f'{name}.{label}', at, channel[label][getattr(samples, name)[at]],
                      np.full(len(at), value))


class Limits:
    """The gate of a controller, carried from part to part of a run."""

    def __init__(self) -> None:
        self._gate: OutputGate | None = None

    def rest(self) -> None:
        """Take note that the law was not asked."""
        self._gate = None

    def apply(self, samples: Samples, rows: Integers, outputs: Outputs,
              c: Configuration) -> Outputs:
        """Return the steps with their commands as they leave the controller."""
        limits = c.safety
        if not (limits.command_limit or limits.rate_limit or limits.ramp):
            self._gate = None
            return outputs
        if self._gate is not None:
            self._gate.settings = limits
        v = outputs.v.copy()
        for i, row in enumerate(rows.tolist()):
            stamp = float(samples.stamp[row])
            if self._gate is None or samples.seq[row] == 0 or not samples.follows[row]:
                self._gate = OutputGate(limits, c.loop.period)
                self._gate.start(stamp)
            if outputs.done[i]:
                v[i] = self._gate.let_out(float(v[i]), stamp)
        return replace(outputs, v=v)
