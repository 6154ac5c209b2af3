"""Lines of progress for the program that started the controller, as JSON on standard output.

A reader that stopped reading must not stop the loop: the lines are dropped where they would block.
"""

from __future__ import annotations

import json
import os
import sys

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import State, Terms

LATE = 0.001
"""A state that arrives later than this after its time counts as late [s]."""


class Progress:
    """Writes one line every so many samples.

    Args:
        configuration: Rate, and the law's ε.
        rate: Lines a second.
    """

    def __init__(self, configuration: Configuration, rate: float) -> None:
        self._every = max(1, round(configuration.loop.rate / rate))
        self._epsilon = getattr(configuration.law.gains, 'epsilon', None)
        names = configuration.law.signal_names
        self._epsilon_at = names.index('epsilon') if 'epsilon' in names else None
        self._samples = 0
        self._late = 0
        self._realtime = configuration.loop.timing == 'realtime'
        self._line_ns = 0
        self._last: tuple[float, int] | None = None
        self._out = sys.stdout.fileno()
        os.set_blocking(self._out, False)

    def sample(self, state: State, terms: Terms, error: float, v: float, taken_ns: int) -> None:
        """Count a sample; write a line when it is time.

        Args:
            state: State answered.
            terms: The law's terms.
            error: x̃, unit of x.
            v: Command.
            taken_ns: When the state arrived, steady clock [ns].
        """
        if self._last is not None:
            stamp, earlier_ns = self._last
            if (taken_ns - earlier_ns) * 1e-9 - (state.stamp - stamp) > LATE:
                self._late += 1
        self._last = (state.stamp, taken_ns)
        self._samples += 1
        if self._samples % self._every:
            return
        epsilon = (terms.signals[self._epsilon_at] if self._epsilon_at is not None
                   else self._epsilon)
        rate = self._every / ((taken_ns - self._line_ns) * 1e-9) if self._line_ns else None
        self._line_ns = taken_ns
        line = json.dumps({'t': state.stamp, 'error': error, 'v': v,
                           's_over_epsilon': terms.values[0] / epsilon if epsilon else None,
                           'rate': rate, 'late': self._late if self._realtime else None})
        try:
            os.write(self._out, line.encode() + b'\n')
        except OSError:
            return
