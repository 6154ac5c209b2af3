# SPDX-License-Identifier: Apache-2.0
"""Declared signals: name, unit, meaning and role of every number that is published or recorded.

Labels, units, plots, layouts, the columns of the live page and the tables of docs/notation.md
follow from the declarations here, in `dz_ros.core.records` and in each law's `Law.signals`.

A unit is an expression, resolved by `Units` for the plant of a configuration:

    x, x^(i), x^(n), x^(n-1)    output of the plant, its derivatives; s has the unit of x^(n−1)
    v                           the actuator's unit
    Y1 … Yr                     the regressors
    W1 … Wr                     those of a law of all axes: a coupled plant's structure, if any
    1, s, rad, …                itself

joined by spaces (product), ``/`` (everything after it divides) and powers (``s^2``, ``s²``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
import enum
import re
from typing import Any


class Role(enum.Enum):
    """What a signal is for."""

    TERM = 'term of v'
    ESTIMATE = 'estimate'
    GUARD = 'guard'
    MEMORY = 'memory'
    """The law's memory before the step, published to recompute a recording; not plotted."""
    INDEX = 'index'
    """Counts and stamps by which messages are joined; not plotted."""
    OTHER = 'other'


@dataclass(frozen=True)
class Signal:
    """One declared number.

    Attributes:
        name: Label in messages, files and tables.
        unit: Expression as above; '' = unknown.
        meaning: A few words; the legend of a term of v.
        role: What it is for.
        symbol: Letters of plots, ``_i`` a subscript: 'θ̂_1'; '' = the name.
    """

    name: str
    unit: str
    meaning: str
    role: Role = Role.OTHER
    symbol: str = ''

    @property
    def label(self) -> str:
        """Text of legends: a term's meaning, else the symbol, else the name."""
        if self.role is Role.TERM:
            return self.meaning
        return self.symbol or self.name.replace('_', ' ')


def names(signals: Iterable[Signal]) -> tuple[str, ...]:
    """Return the names of signals."""
    return tuple(item.name for item in signals)


def places(signals: Iterable[Signal], *wanted: str) -> tuple[int, ...]:
    """Return the place of each name among signals, ValueError where there is none."""
    known = names(signals)
    return tuple(known.index(name) for name in wanted)


TERMS = (
    Signal('s', 'x^(n-1)', 'filtered error (8)'),
    Signal('s_eps', 'x^(n-1)', 'distance of s from the layer (11)', symbol='s_ε'),
    Signal('u_fd', 'x^(n)', 'feed-forward of the reference (17)', symbol='u_fd'),
    Signal('v_damping', 'v', 'damping', Role.TERM, '−k_d s'),
    Signal('v_feed_forward', 'v', 'feed-forward', Role.TERM, 'φ̂ u_fd'),
    Signal('v_regressor', 'v', 'regressor', Role.TERM, 'Yᵀθ̂'),
    Signal('v_robust', 'v', 'robust', Role.TERM, '−k* sat(s/ε)'),
    Signal('v_extra', 'v', 'extra', Role.TERM, 'v_extra'),
)
"""What every law reports of a step, before its status and its own signals; 0 where a kernel does
not write it. The terms of v sum up to v."""

TERM_NAMES = names(TERMS)

STATUS = len(TERMS)
"""Place of the law's status bits in the buffer a law's kernel writes; its signals follow."""

S, S_EPS, U_FD, V_DAMPING, V_FEED_FORWARD, V_REGRESSOR, V_ROBUST, V_EXTRA = places(
    TERMS, 's', 's_eps', 'u_fd', 'v_damping', 'v_feed_forward', 'v_regressor', 'v_robust',
    'v_extra')

PHI = Signal('phi', 'v/x^(n)', '1/(b m)', Role.ESTIMATE, 'φ̂')
BEFORE = '_before'
"""Ending of the names of the memory before the step."""
_THETA = re.compile(r'theta([1-9][0-9]{0,2})', re.ASCII)


def theta(number: int) -> Signal:
    """Return θ̂ of a regressor, counted from 1."""
    return Signal(f'theta{number}', f'v/Y{number}', f'a_{number}/(b m)', Role.ESTIMATE,
                  f'θ̂_{number}')


def estimates(count: int) -> tuple[Signal, ...]:
    """Return θ̂_1 … θ̂_r, φ̂ of (14)."""
    return (*(theta(i + 1) for i in range(count)), PHI)


def before(memory: Iterable[Signal]) -> tuple[Signal, ...]:
    """Return the signals that publish a law's memory before the step."""
    return tuple(replace(item, name=item.name + BEFORE, role=Role.MEMORY,
                         meaning=f'{item.meaning}, before the step') for item in memory)


def declared(wanted: Iterable[str], known: Iterable[Signal] = ()) -> tuple[Signal, ...]:
    """Return the signals of a message's names, those of `known` first.

    A recording may come without its law: `TERMS`, θ̂_i, φ̂ and the memory before a step have
    reserved names, anything else has no unit then.
    """
    found = {item.name: item for item in (*TERMS, PHI, *known)}
    return tuple(found.get(name) or _reserved(name) for name in wanted)


def _reserved(name: str) -> Signal:
    """Return the signal of a name that nothing declares."""
    match = _THETA.fullmatch(name)
    if match:
        return theta(int(match[1]))
    return Signal(name, '', '', Role.MEMORY if name.endswith(BEFORE) else Role.OTHER)


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
