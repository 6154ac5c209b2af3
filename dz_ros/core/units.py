# SPDX-License-Identifier: Apache-2.0
"""Units of declared signals: expressions, resolved for the plant of a configuration.

    x, x^(i), x^(n), x^(n-1)    output of the plant, its derivatives; s has the unit of x^(n−1)
    v                           the actuator's unit
    Y1 … Yr                     the regressors
    W1 … Wr                     those of a law of all axes: a coupled plant's structure, if any
    1, s, rad, …                itself

joined by spaces (product), ``/`` (everything after it divides) and powers (``s^2``, ``s²``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import re
from typing import Any

_DERIVATIVE = re.compile(r'x\^\((n?)([+-]?\d*)\)')
_FACTOR = re.compile(r'(x\^\([^)]*\)|[^\s^⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)(?:\^?(-?\d+|[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?')
_WORDS = (('input gain unit', 'x^(n)/v'), ('actuator unit', 'v'), ('unit of s', 'x^(n-1)'),
          ('unit of x^(n−1)', 'x^(n-1)'), ('unit of x', 'x'), ('unit of Y_i', 'Y_i'),
          (' squared', '^2'), (' and ', ' '), ('second', 's'), (' per ', '/'))
_BRACKETS = re.compile(r'^\s*\((.*)\)\s*$')
_RAISED = str.maketrans('⁻⁰¹²³⁴⁵⁶⁷⁸⁹', '-0123456789')
_LOWERED = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')


@dataclass(frozen=True)
class Units:
    """Units of one plant, by which unit expressions are resolved; '' = unknown.

    Attributes:
        order: n.
        state: Units of x, x', …, shape (n,).
        actuator: Unit of v.
        regressors: Units of Y_1 … Y_r.
        structure: Units of the structure of a plant that serves several axes; empty = regressors.
    """

    order: int
    state: tuple[str, ...] = ()
    actuator: str = ''
    regressors: tuple[str, ...] = ()
    structure: tuple[str, ...] = ()

    @classmethod
    def of(cls, plant: Any) -> Units:
        """Return the units of a `dz_ros.core.plants.base.Plant`."""
        return cls(plant.order, plant.state_units, plant.actuator_unit, plant.regressor_units,
                   getattr(plant, 'structure_units', ()))

    def resolve(self, expression: str) -> str:
        """Return the unit as text, '1' where there is no dimension, '' where it is unknown."""
        stated = self._stated(expression)
        if stated is not None:
            return stated
        powers: dict[str, int] = {}
        return _text(powers) if self._multiply(powers, expression, 1) else ''

    def behind(self, expression: str) -> str:
        """Return the unit as it stands behind a number, ' m/s'; '' without one or not known."""
        unit = self.resolve(expression)
        return '' if unit in ('', '1') else f' {unit}'

    def resolve_words(self, text: str) -> str:
        """Return the unit of a parameter, as 'actuator unit per unit of s', for this plant.

        Where regressors Y_i have different units there is one for each, with commas between, as
        there is between the units of a list whose numbers have different ones.
        """
        if ', ' in text:
            return ', '.join(self.resolve_words(item) for item in text.split(', '))
        expression = text
        for words, meant in _WORDS:
            expression = expression.replace(words, meant)
        if 'unit' not in text or re.search("unit|'", expression):
            return text
        if 'Y_i' not in expression:
            return self.resolve(expression) or text
        found = [self.resolve(expression.replace('Y_i', f'Y{i}'))
                 for i in range(1, len(self.regressors) + 1)]
        if not found or not all(found):
            return text
        return found[0] if len(set(found)) == 1 else ', '.join(found)

    def _stated(self, atom: str) -> str | None:
        """Return the unit of one placeholder as the plant states it; None for anything else."""
        if atom == 'v':
            return self.actuator
        if atom[:1] == 'Y' and atom[1:].isdecimal():
            return dict(enumerate(self.regressors, 1)).get(int(atom[1:]), '')
        if atom[:1] == 'W' and atom[1:].isdecimal():
            return dict(enumerate(self.structure or self.regressors, 1)).get(int(atom[1:]), '')
        match = _DERIVATIVE.fullmatch('x^(0)' if atom == 'x' else atom)
        if match is None:
            return None
        i = (self.order if match[1] else 0) + int(match[2] or 0)
        if 0 <= i < len(self.state):
            return self.state[i]
        if not self.state or not self.state[0]:
            return ''
        powers = {'s': -i}
        return _text(powers) if self._multiply(powers, self.state[0], 1) else ''

    def _multiply(self, powers: dict[str, int], expression: str, sign: int) -> bool:
        """Multiply by an expression to ±1 in place; return whether all of it is known."""
        for i, part in enumerate(expression.split('/')):
            for atom, power in _FACTOR.findall(_BRACKETS.sub(r'\1', part)):
                exponent = (sign if i == 0 else -sign) * int((power or '1').translate(_RAISED))
                stated = self._stated(atom)
                if stated == '':
                    return False
                if stated is None:
                    if atom != '1':
                        powers[atom] = powers.get(atom, 0) + exponent
                elif not all(self._multiply(powers, stated, 1 if exponent > 0 else -1)
                             for _ in range(abs(exponent))):
                    return False
        return True


def _text(powers: dict[str, int]) -> str:
    """Return a product of powers, what divides behind one stroke."""
    def joined(chosen: Sequence[tuple[str, int]]) -> str:
        return ' '.join(name + ('' if power == 1 else str(power).translate(_LOWERED))
                        for name, power in chosen)

    above = joined([(name, power) for name, power in powers.items() if power > 0])
    below = joined([(name, -power) for name, power in powers.items() if power < 0])
    if not below:
        return above or '1'
    return f'{above or "1"}/({below})' if ' ' in below else f'{above or "1"}/{below}'
