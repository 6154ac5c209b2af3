# SPDX-License-Identifier: Apache-2.0
"""Declared signals: name, unit, meaning and role of every number that is published or recorded.

Labels, units, plots, layouts, the columns of the live page and the tables of docs/notation.md
follow from the declarations here, in `dz_ros.core.records` and in each law's `Law.signals`.
Units are expressions of `dz_ros.core.units`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
import enum
from functools import lru_cache
import re


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
        unit: Expression of `dz_ros.core.units`; '' = unknown.
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


@lru_cache(maxsize=1024)
def theta(number: int) -> Signal:
    """Return θ̂ of a regressor, counted from 1."""
    return Signal(f'theta{number}', f'v/Y{number}', f'a_{number}/(b m)', Role.ESTIMATE,
                  f'θ̂_{number}')


def estimates(count: int) -> tuple[Signal, ...]:
    """Return θ̂_1 … θ̂_r, φ̂ of (14)."""
    return (*(theta(i + 1) for i in range(count)), PHI)


def before(memory: Iterable[Signal]) -> tuple[Signal, ...]:
    """Return the signals that publish a law's memory before the step."""
    return tuple(map(_before, memory))


@lru_cache(maxsize=1024)
def _before(item: Signal) -> Signal:
    """Return the signal that publishes one of them."""
    return replace(item, name=item.name + BEFORE, role=Role.MEMORY,
                   meaning=f'{item.meaning}, before the step')


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
