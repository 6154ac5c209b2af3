# SPDX-License-Identifier: Apache-2.0
"""Lines of progress for the program that started the controller, as JSON on standard output.

A reader that stopped reading must not stop the loop: lines that would block are dropped.
"""

from __future__ import annotations

import json
import os
import sys

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import State, Terms
from dz_ros.core.safety.health import Pace
from dz_ros.core.signals import S


class Progress:
    """Writes progress at a rate.

    Args:
        configuration: Rate of the loop, and the law's ε.
        rate: Lines a second.
        pace: Counts the late samples.
    """

    def __init__(self, configuration: Configuration, rate: float, pace: Pace) -> None:
        self._every = max(1, round(configuration.loop.rate / rate))
        self._epsilon = getattr(configuration.law.gains, 'epsilon', None)
        names = configuration.law.signal_names
        self._epsilon_at = names.index('epsilon') if 'epsilon' in names else None
        self._pace = pace
        self._realtime = configuration.loop.timing == 'realtime'
        self._line_ns = 0
        self._out = sys.stdout.fileno()
        os.set_blocking(self._out, False)

    def sample(self, state: State, terms: Terms, error: float, v: float, taken_ns: int,
               axis: str = '') -> None:
        """Write a line when it is time.

        Args:
            state: State answered.
            terms: The law's terms.
            error: x̃, unit of x.
            v: Command.
            taken_ns: When the state arrived, steady clock [ns].
            axis: Of several, the one that the numbers are of.
        """
        if self._pace.samples % self._every:
            return
        epsilon = (terms.signals[self._epsilon_at] if self._epsilon_at is not None
                   else self._epsilon)
        rate = self._every / ((taken_ns - self._line_ns) * 1e-9) if self._line_ns else None
        self._line_ns = taken_ns
        named = {'axis': axis} if axis else {}
        line = json.dumps({'t': state.stamp, **named, 'error': error, 'v': v,
                           's_over_epsilon': terms.values[S] / epsilon if epsilon else None,
                           'rate': rate, 'late': self._pace.late if self._realtime else None})
        try:
            os.write(self._out, line.encode() + b'\n')
        except OSError:
            return
