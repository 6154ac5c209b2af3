# SPDX-License-Identifier: Apache-2.0
"""Enclosures of a plant's and a reference's own functions, rounded outward (ours).

Numbers are balls of python-flint (`arb`): every operation returns a ball that contains all results
the operands allow. A `Jet` is a truncated Taylor series of such balls in one variable τ,

    f(τ) = f_0 + f_1 τ + … + f_3 τ³,     f_j = f^(j)/j!

so that the scalar functions of plant and trajectory (`regressors`, `disturbance`, `evaluate`),
called with a jet in place of a float, enclose their values and derivatives over a whole interval.
Their `math` is replaced by one for jets (`with_jets`). Where an interval leaves a comparison open,
every way through the function is taken in turn (`Ways`), and the results are joined.

Over 300 lines: one number type, which needs all operators.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import math
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dz_ros.errors import DzRosError, MissingDependencyError

ORDER = 3
"""Highest derivative that is enclosed."""
MOST_WAYS = 64
"""Most ways through a function that are followed over one interval."""
PRECISION = 96
"""Bits of the balls' midpoints."""


class NotEnclosedError(DzRosError):
    """A function does something without an enclosure here, named in the message."""


def load_flint() -> Any:
    """Return python-flint.

    Raises:
        MissingDependencyError: It is not installed.
    """
    try:
        import flint
    except ImportError:
        raise MissingDependencyError('enclosures need python-flint: pip install '
                                     "'dz_ros[certify]'") from None
    return flint


def upper(ball: Any) -> float:
    """Return a float that no number of the ball exceeds."""
    return math.nextafter(float(ball.upper()), math.inf)


def lower(ball: Any) -> float:
    """Return a float that no number of the ball falls below."""
    return math.nextafter(float(ball.lower()), -math.inf)


class Ways:
    """The comparisons an interval leaves open, each answered both ways in turn."""

    def __init__(self) -> None:
        self._answers: list[bool] = []
        self._asked = 0
        self.branched = False

    def decide(self, certainly: bool, impossible: bool) -> bool:
        """Return the answer to a comparison; where it is open, that of this way."""
        if certainly or impossible:
            return certainly
        self.branched = True
        if self._asked == len(self._answers):
            self._answers.append(True)
        self._asked += 1
        return self._answers[self._asked - 1]

    def results(self, function: Callable[[], Any]) -> Iterator[Any]:
        """Yield what the function returns, for every way through it.

        Raises:
            NotEnclosedError: There are too many.
        """
        self._answers = []
        for _ in range(MOST_WAYS):
            self._asked = 0
            yield function()
            del self._answers[self._asked:]
            while self._answers and not self._answers[-1]:
                self._answers.pop()
            if not self._answers:
                return
            self._answers[-1] = False
        raise NotEnclosedError(f'more than {MOST_WAYS} ways through a function over one interval')


class Jet:
    """A truncated Taylor series of balls that passes for a float.

    Args:
        parts: f_0, f_1, …, at most `ORDER` + 1 balls; the rest is 0.
        ways: Answers comparisons that are open.
    """

    __slots__ = ('parts', 'ways')

    def __init__(self, parts: Sequence[Any], ways: Ways) -> None:
        self.parts = [*parts, *(parts[0] * 0,) * (ORDER + 1 - len(parts))]
        self.ways = ways

    def _other(self, value: Any) -> list[Any]:
        if isinstance(value, Jet):
            return value.parts
        zero = self.parts[0] * 0 if self.parts[0].is_finite() else type(self.parts[0])(0)
        return [zero + value, zero, zero, zero]

    def _made(self, parts: Sequence[Any]) -> Jet:
        return Jet(parts, self.ways)

    def __add__(self, other: Any) -> Jet:
        return self._made([a + b for a, b in zip(self.parts, self._other(other), strict=True)])

    __radd__ = __add__

    def __neg__(self) -> Jet:
        return self._made([-item for item in self.parts])

    def __sub__(self, other: Any) -> Jet:
        return self._made([a - b for a, b in zip(self.parts, self._other(other), strict=True)])

    def __rsub__(self, other: Any) -> Jet:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return self._made([item * other for item in self.parts])
        return self._made(_product(self.parts, other.parts))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return self._made([item / other for item in self.parts])
        a, b = self.parts, other.parts
        if b[0].contains(0):
            raise NotEnclosedError('a division by what may be 0')
        parts: list[Any] = []
        for k in range(ORDER + 1):
            parts.append((a[k] - sum((parts[j] * b[k - j] for j in range(k)), a[k] * 0)) / b[0])
        return self._made(parts)

    def __rtruediv__(self, other: Any) -> Jet:
        return self._made(self._other(other)) / self

    def __pow__(self, power: Any) -> Jet:
        if not isinstance(power, int) and power != int(power):
            raise NotEnclosedError(f'a power of {power}')
        result = self._made(self._other(1))
        for _ in range(abs(int(power))):
            result = result * self
        return result if power >= 0 else 1.0 / result

    def __lt__(self, other: Any) -> bool:
        first, second = self.parts[0], self._other(other)[0]
        return self.ways.decide(bool(first < second), bool(first >= second))

    def __gt__(self, other: Any) -> bool:
        first, second = self.parts[0], self._other(other)[0]
        return self.ways.decide(bool(first > second), bool(first <= second))

    def __le__(self, other: Any) -> bool:
        return not self > other

    def __ge__(self, other: Any) -> bool:
        return not self < other

    def __abs__(self) -> Jet:
        return self if self >= 0.0 else -self

    def __floor__(self) -> int:
        low, high = (math.floor(end(self.parts[0])) for end in (lower, upper))
        while low < high and not self < low + 1:
            low += 1
        return low

    def __mod__(self, other: float) -> Jet:
        return self - float(math.floor(self / other) * other)

    def __float__(self) -> float:
        raise NotEnclosedError('a function that this arithmetic does not know')

    def compose(self, derivative: Callable[[list[Any]], list[Any]], value: Any) -> Jet:
        """Return g(f), given g(f_0) and g' as a series in terms of those of g found so far.

        Args:
            derivative: From g_0 … g_k (padded) to the series of dg/df.
            value: g_0.
        """
        parts = [value, *(value * 0 for _ in range(ORDER))]
        slope = [self.parts[j + 1] * (j + 1) for j in range(ORDER)]
        for k in range(ORDER):
            outer = derivative(parts)
            parts[k + 1] = sum((slope[j] * outer[k - j] for j in range(k + 1)),
                               value * 0) / (k + 1)
        return self._made(parts)


def _product(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [sum((a[j] * b[k - j] for j in range(1, k + 1)), a[0] * b[k])
            for k in range(ORDER + 1)]


def _with(function: str, jets: Callable[[Jet], Jet]) -> Callable[[Any], Any]:
    """Return a function of `math` that takes jets too."""
    plain = getattr(math, function)
    return lambda x: jets(x) if isinstance(x, Jet) else plain(x)


def _sine(u: Jet) -> Jet:
    return _circular(u)[0]


def _cosine(u: Jet) -> Jet:
    return _circular(u)[1]


def _circular(u: Jet) -> tuple[Jet, Jet]:
    sine, cosine = [u.parts[0].sin()], [u.parts[0].cos()]
    for k in range(1, ORDER + 1):
        for found, other, sign in ((sine, cosine, 1), (cosine, sine, -1)):
            if len(found) == k:
                found.append(sum((u.parts[j] * other[k - j] * j for j in range(1, k + 1)),
                                 u.parts[0] * 0) * sign / k)
    return Jet(sine, u.ways), Jet(cosine, u.ways)


def _tanh(u: Jet) -> Jet:
    def slope(parts: list[Any]) -> list[Any]:
        square = _product(parts, parts)
        return [1 - square[0], *(-item for item in square[1:])]

    low, high = (type(u.parts[0])(end(u.parts[0])).tanh() for end in (lower, upper))
    return u.compose(slope, low.union(high))        # it rises: better than a wide ball's


def _exp(u: Jet) -> Jet:
    return u.compose(lambda parts: parts, u.parts[0].exp())


def _sqrt(u: Jet) -> Jet:
    if u.parts[0].contains(0) or not u.parts[0] > 0:
        raise NotEnclosedError('a square root of what may be 0')
    return u.compose(lambda parts: (0.5 / Jet(parts, u.ways)).parts, u.parts[0].sqrt())


def _atan(u: Jet) -> Jet:
    return u.compose(lambda _: (1.0 / (u * u + 1.0)).parts, u.parts[0].atan())


class _Math(SimpleNamespace):
    """A module of functions, those it lacks included: they refuse."""

    def __getattr__(self, name: str) -> Any:
        raise NotEnclosedError(f'math.{name} has no enclosure here')


MATH = _Math(
    sin=_with('sin', _sine), cos=_with('cos', _cosine), tanh=_with('tanh', _tanh),
    exp=_with('exp', _exp), sqrt=_with('sqrt', _sqrt), atan=_with('atan', _atan),
    floor=math.floor, ceil=lambda x: -math.floor(-x), fabs=abs, pi=math.pi, e=math.e,
    inf=math.inf, factorial=math.factorial, comb=math.comb, isfinite=lambda _: True,
    tan=_with('tan', lambda u: _sine(u) / _cosine(u)))
"""What stands for the module `math`."""


def with_jets(function: Callable[..., Any], known: dict[int, Any] | None = None) -> Any:
    """Return a function of dz_ros or of the user's with `math` replaced, wherever it is called."""
    if not isinstance(function, FunctionType):
        return function
    known = {} if known is None else known
    if id(function) not in known:
        scope: dict[str, Any] = {}
        known[id(function)] = made = FunctionType(
            function.__code__, scope, function.__name__, function.__defaults__,
            function.__closure__)
        for name, value in function.__globals__.items():
            if isinstance(value, ModuleType) and value.__name__ == 'math':
                value = MATH
            elif isinstance(value, FunctionType) and name in function.__code__.co_names:
                value = with_jets(value, known)
            scope[name] = value
        return made
    return known[id(function)]


def join(results: Sequence[Sequence[Jet]]) -> NDArray[np.float64]:
    """Return lower and upper ends of f^(j), j = 0 … `ORDER`, over all ways.

    Returns:
        Shape (functions, ORDER + 1, 2).
    """
    ends = np.empty((len(results[0]), ORDER + 1, 2))
    ends[:, :, 0], ends[:, :, 1] = math.inf, -math.inf
    for row in results:
        for i, jet in enumerate(row):
            for j in range(ORDER + 1):
                part = jet.parts[j] * math.factorial(j)
                if not part.is_finite():
                    raise NotEnclosedError('an enclosure without bound')
                ends[i, j, 0] = min(ends[i, j, 0], lower(part))
                ends[i, j, 1] = max(ends[i, j, 1], upper(part))
    return ends
