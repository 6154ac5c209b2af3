# SPDX-License-Identifier: Apache-2.0
"""Which runs a sweep consists of: axes over keys of a configuration, and a sampler.

    KEY=a:b:n         n values from a to b, both included; grid, or bounds for random and sobol
    KEY=a:b:n:log     the same, equal ratios; a, b > 0
    KEY=v1,v2,…       these values: numbers, or names as of laws

KEY is any key of a configuration; KEY[i] is one number of an array. Samplers: grid (every
combination), random (seeded, uniform) and sobol (a scrambled, seeded Sobol sequence, whose first N
points fill the box more evenly than random ones; N best a power of two).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
import hashlib
import itertools
import json
import math
import re
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError

SAMPLERS = ('grid', 'sobol', 'random')
MAX_RUNS = 10_000_000
"""More runs than this are refused."""
BLOCK = 4096
"""Points drawn at a time, a power of two, as Sobol sequences want it."""
_INDEXED = re.compile(r'(.+)\[(\d+)\]$')


@dataclass(frozen=True)
class Axis:
    """One key that varies.

    Attributes:
        key: Dotted key, or KEY[i].
        low, high: Ends of a range.
        count: Values on a grid; 0 = `values` are given.
        log: Equal ratios instead of equal steps.
        values: The values, where they are listed.
    """

    key: str
    low: float = 0.0
    high: float = 0.0
    count: int = 0
    log: bool = False
    values: tuple[Any, ...] = ()

    @classmethod
    def parse(cls, text: str) -> Axis:
        """Return the axis written as ``KEY=…``.

        Raises:
            ConfigurationError: It is not one.
        """
        key, equals, written = text.partition('=')
        key, written = key.strip(), written.strip()
        wanted = ('must be KEY=a:b:n, KEY=a:b:n:log or KEY=v1,v2,…, e.g. '
                  'controller.epsilon=0.005:0.5:40:log')
        if not equals or not key or not written:
            raise ConfigurationError('--over', text, wanted)
        if ':' not in written or ',' in written:      # a value may be package.module:Class
            return cls(key, values=tuple(_value(item) for item in written.split(',')))
        parts = written.split(':')
        if len(parts) not in (3, 4) or (len(parts) == 4 and parts[3] != 'log'):
            raise ConfigurationError('--over', text, wanted)
        try:
            low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
        except ValueError:
            raise ConfigurationError('--over', text, wanted) from None
        log = len(parts) == 4
        if not (math.isfinite(low) and math.isfinite(high)) or count < 1 or low > high \
                or (log and low <= 0.0):
            raise ConfigurationError('--over', text, 'must be finite a <= b and n >= 1, and a > 0 '
                                     'with log')
        return cls(key, low, high, count, log)

    def grid(self) -> Iterator[Any]:
        """Yield the values on a grid."""
        if self.values:
            yield from self.values
            return
        spread = np.geomspace if self.log else np.linspace
        for item in spread(self.low, self.high, self.count):
            yield float(item)

    def at(self, share: float) -> Any:
        """Return the value at a share of the axis, 0 <= share < 1."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + (self.high - self.low) * share)


@dataclass(frozen=True)
class SweepPlan:
    """A sweep: everything its numbers follow from.

    Attributes:
        base: Flat configuration that the axes change.
        axes: What varies.
        sampler: One of `SAMPLERS`.
        samples: Number of runs of random and sobol.
        seed: Of the sampler.
    """

    base: Mapping[str, Any]
    axes: tuple[Axis, ...]
    sampler: str = 'grid'
    samples: int = 0
    seed: int = 0

    def check(self) -> None:
        """Refuse what cannot be swept before anything runs.

        Raises:
            ConfigurationError: No axis, a key twice, unknown or without such an element, no
                samples, too many runs.
        """
        keys = [axis.key for axis in self.axes]
        if not keys or len(set(keys)) < len(keys):
            raise ConfigurationError('--over', keys, 'must be at least one key, each once')
        if self.sampler not in SAMPLERS:
            raise ConfigurationError('--sampler', self.sampler,
                                     f'must be one of {", ".join(SAMPLERS)}')
        if self.sampler != 'grid' and self.samples < 1:
            raise ConfigurationError('--samples', self.samples,
                                     f'must be > 0 with --sampler {self.sampler}')
        if len(self) > MAX_RUNS:
            raise ConfigurationError('--over', keys, f'{len(self)} runs are too many; at most '
                                     f'{MAX_RUNS}')
        for axis in self.axes:
            self.changes({axis.key: next(axis.grid())})
            Configuration.from_changed(self.base, _known(self.base, axis))

    def __len__(self) -> int:
        """Return the number of runs."""
        if self.sampler != 'grid':
            return self.samples
        return math.prod(len(axis.values) or axis.count for axis in self.axes)

    def points(self) -> Iterator[dict[str, Any]]:
        """Yield key → value of every run, in order; the last axis varies fastest on a grid."""
        keys = [axis.key for axis in self.axes]
        if self.sampler == 'grid':
            for values in _combinations(self.axes):
                yield dict(zip(keys, values, strict=True))
            return
        for row in itertools.islice(self._shares(), self.samples):
            yield {axis.key: axis.at(float(share)) for axis, share in zip(self.axes, row,
                                                                          strict=True)}

    def _shares(self) -> Iterator[Any]:
        """Yield samples of the unit box without end, drawn in blocks: the same as in one piece."""
        if self.sampler == 'random':
            generator = np.random.default_rng(self.seed)
            while True:
                yield from generator.random((BLOCK, len(self.axes)))
        from scipy.stats import qmc
        sobol = qmc.Sobol(len(self.axes), seed=self.seed)
        while True:
            yield from sobol.random(BLOCK)

    def changes(self, point: Mapping[str, Any]) -> dict[str, Any]:
        """Return the keys of the configuration that a point changes, KEY[i] put in place.

        Raises:
            ConfigurationError: KEY[i] of a key that is no array or is shorter.
        """
        found: dict[str, Any] = {}
        for key, value in point.items():
            match = _INDEXED.match(key)
            if match is None:
                found[key] = value
                continue
            name, place = match[1], int(match[2])
            array = found.get(name, self.base.get(name))
            if not isinstance(array, (list, tuple)) or place >= len(array):
                raise ConfigurationError('--over', key, 'has no such element; give the whole '
                                         'array in the configuration or by --set')
            found[name] = [value if i == place else item for i, item in enumerate(array)]
        return found

    def fingerprint(self) -> str:
        """Return a hash of the plan, the same for the same numbers."""
        content = json.dumps(asdict(self), sort_keys=True, default=list)
        return hashlib.sha256(content.encode()).hexdigest()[:16]


def _combinations(axes: Sequence[Axis]) -> Iterator[tuple[Any, ...]]:
    """Yield every combination of the axes' values, the last varying fastest, none kept."""
    if not axes:
        yield ()
        return
    for value in axes[0].grid():
        for others in _combinations(axes[1:]):
            yield (value, *others)


def _known(base: Mapping[str, Any], axis: Axis) -> dict[str, Any]:
    """Return the axis' own first value where it names a class, so that unknown keys are found."""
    match = _INDEXED.match(axis.key)
    if match is not None:
        return {}
    return {axis.key: base.get(axis.key, next(axis.grid()))}


def _value(text: str) -> Any:
    """Return a listed value: an integer, a number, true or false, or a name."""
    text = text.strip()
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {'true': True, 'false': False}.get(text, text)


def parse_axes(texts: Sequence[str]) -> tuple[Axis, ...]:
    """Return the axes written as ``KEY=…``."""
    return tuple(Axis.parse(text) for text in texts)
