# SPDX-License-Identifier: Apache-2.0
"""A simulated driver with scripted faults, for tests of what must survive them (ours).

Each line of the list `driver.script` is one fault: where, what, and what it needs.

    SAMPLES none             no measurement
    SAMPLES nan              a measurement that is not finite
    SAMPLES short            a measurement with a number too few
    SAMPLES frozen           the measurement before these samples, again and again
    SAMPLES fault WORDS      the device has a fault, until it is reset after these samples
    SAMPLES raise WORDS      its code raises RuntimeError while it measures
    SAMPLES slow SECONDS     measuring takes this time
    SAMPLES deaf             commands are lost on their way, safe ones too
    SAMPLES reversed         commands act with the other sign
    open WORDS               it cannot be opened
    enable WORDS             it refuses to be enabled
    recover WORDS            it refuses to be reset

SAMPLES is one sample (`200`), some (`200-210`) or all from one on (`200-`); sample k is measured
at loop time k T. E.g. ``driver.script: ['100-120 none', '400 fault over-temperature']``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import re
import time
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.core.records import Truth
from dz_ros.core.schema import parameter
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import ConfigurationError, DriverError

REFUSALS = ('open', 'enable', 'recover')
WITH_WORDS = {'fault', 'raise', *REFUSALS}
FAULTS = ('none', 'nan', 'short', 'frozen', 'fault', 'raise', 'slow', 'deaf',
          'reversed')
_LINE = re.compile(r'(?:(\d+)(-(\d*))? +)?([a-z]+)(?: +(.*))?')


@dataclass(frozen=True)
class Fault:
    """One line of a script: what happens in samples first … last, with its words."""

    what: str
    first: int
    last: float
    words: str


def read_script(lines: Sequence[str], key: str = 'driver.script') -> tuple[Fault, ...]:
    """Return the faults of a script.

    Raises:
        ConfigurationError: A line that is none.
    """
    found = []
    for line in lines:
        match = _LINE.fullmatch(line.strip())
        what = match[4] if match else ''
        timed = match is not None and match[1] is not None
        if not match or what not in (FAULTS if timed else REFUSALS):
            raise ConfigurationError(key, line, 'a line must be SAMPLES and one of '
                                     f'{", ".join(FAULTS)}, or one of {", ".join(REFUSALS)}')
        words = match[5] or ''
        if (what in WITH_WORDS) != bool(words) and what != 'slow':
            raise ConfigurationError(key, line, f'{what} needs words' if what in WITH_WORDS
                                     else f'nothing can follow {what}')
        if what == 'slow' and not re.fullmatch(r'\d*\.?\d+(e-?\d+)?', words):
            raise ConfigurationError(key, line, 'slow needs a number of seconds')
        first = int(match[1] or 0)
        last = math.inf if match[2] == '-' else int(match[3] or first)
        if last < first:
            raise ConfigurationError(key, line, 'the last sample lies before the first')
        found.append(Fault(what, first, last, words))
    return tuple(found)


@dataclass(frozen=True)
class MockParameters:
    """Faults and capabilities of the mock."""

    script: tuple[str, ...] = parameter((), '', 'faults, one a line: SAMPLES WHAT WORDS')
    measures: int = parameter(0, '1', "how many of x, x', … it measures; 0 = all", minimum=0,
                              structural=True)
    limit: float = parameter(0.0, 'command unit', 'largest |v| it takes; 0 = any', minimum=0.0)

    def check(self, prefix: str) -> None:
        """Check the script."""
        read_script(self.script, f'{prefix}script')


class Mock(SimulatedActuator):
    """The simulated actuator with scripted faults.

    Attributes:
        sample: The sample measured next.
        given: Every command that came, as (v, t, whether safe).
        calls: Names of the lifecycle calls, in order.
    """

    name = 'mock'
    summary = 'the simulated one with scripted faults, for tests'
    Parameters = MockParameters

    def __init__(self, parameters: Any, configuration: Configuration) -> None:
        super().__init__(parameters, configuration)
        self.sample = 0
        self.given: list[tuple[float, float, bool]] = []
        self.calls: list[str] = []
        self._script = read_script(parameters.script)
        self._fault = ''
        self._before: tuple[float, ...] = ()

    @property
    def measured(self) -> int:
        """Number of the states x, x', … that it measures."""
        order = self.configuration.plant.order
        return min(self.parameters.measures, order) or order

    @property
    def limit(self) -> float:
        """Largest |v| it takes [command unit]."""
        return self.parameters.limit or super().limit

    def configure(self, configuration: Configuration) -> None:
        """Use another script from now on."""
        super().configure(configuration)
        self._script = read_script(self.parameters.script)

    def open(self) -> None:
        """Open, unless the script refuses."""
        self._refuse('open')

    def enable(self) -> None:
        """Enable, unless the script refuses."""
        self._refuse('enable')

    def disable(self) -> None:
        """Note the call."""
        self.calls.append('disable')

    def close(self) -> None:
        """Note the call."""
        self.calls.append('close')

    def command(self, v: float, t: float) -> None:
        """Take a command, unless deaf."""
        self._take(v, t, False)

    def safe(self, v: float, t: float) -> None:
        """Take the safe command, unless deaf."""
        self._take(v, t, True)

    def measure(self) -> tuple[float, ...] | None:  # type: ignore[override]
        """Measure, or follow the script, which may raise RuntimeError."""
        if slow := self._now('slow'):
            time.sleep(float(slow.words))
        if raised := self._now('raise'):
            raise RuntimeError(raised.words)
        if self._now('none') is not None:
            return None
        x = super().measure()[:self.measured]
        if self._now('nan') is not None:
            return (*x[:-1], math.nan)
        if self._now('short') is not None:
            return x[:-1]
        if self._now('frozen') is not None:
            return self._before or x
        self._before = x
        return x

    def advance(self, t: float, seq: int) -> Truth:
        """Go on to the next sample."""
        truth = super().advance(t, seq)
        self.sample = seq + 1
        return truth

    def fault(self) -> str:
        """Return the scripted fault, until it is left by `recover`."""
        if fault := self._now('fault'):
            self._fault = fault.words
        return self._fault

    def recover(self) -> None:
        """Leave the fault, unless the script refuses."""
        self._refuse('recover')
        self._fault = ''

    def _take(self, v: float, t: float, safe: bool) -> None:
        self.given.append((v, t, safe))
        if self._now('deaf') is None:
            super().command(v if self._now('reversed') is None else -v, t)

    def _now(self, what: str) -> Fault | None:
        return next((item for item in self._script if item.what == what
                     and item.first <= self.sample <= item.last), None)

    def _refuse(self, name: str) -> None:
        """Note a call; refuse it where the script does."""
        self.calls.append(name)
        for item in self._script:
            if item.what == name:
                raise DriverError(item.words)
