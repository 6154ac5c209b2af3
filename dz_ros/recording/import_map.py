# SPDX-License-Identifier: Apache-2.0
"""Which column of a file is which signal of a run, with factor and offset.

    stamp=time_ms*ms, x0=angle_deg*deg, xd0=wanted_deg*deg, v=percent/100-0.5

A signal is ``stamp``, ``x0`` …, ``xd0`` … or ``v``. Its column may be followed by one factor
(``*`` or ``/``, a number or a unit of `UNITS`) and then one offset (``+`` or ``-``, a number in
the signal's unit). The column is the longest name of the file that the text begins with, of a bag
the longest path; quotes around it allow any name. Nothing is evaluated: the text is matched
against regular expressions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import re

from dz_ros.errors import ConfigurationError
from dz_ros.recording.message_fields import close_names

KEY = '--map'
UNITS = {'deg': math.pi / 180.0, 'turn': 2.0 * math.pi, 'rpm': 2.0 * math.pi / 60.0,
         'um': 1e-6, 'mm': 1e-3, 'cm': 1e-2, 'inch': 0.0254, 'ns': 1e-9, 'us': 1e-6, 'ms': 1e-3,
         'percent': 1e-2, 'permille': 1e-3}
"""Name → what one of it is in the unit without prefix."""
_NUMBER = r'[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?'
_REST = re.compile(rf'\s*(?:([*/])\s*({_NUMBER}|[a-z]+))?\s*(?:([+-])\s*({_NUMBER}))?\s*$')
_ITEM = re.compile(r"""((?:"[^"]*"|'[^']*'|[^,"'])+)(?:,|$)""")


@dataclass(frozen=True)
class Source:
    """Where a signal comes from: column · factor + offset."""

    column: str
    factor: float = 1.0
    offset: float = 0.0


def split_map(text: str) -> dict[str, str]:
    """Return signal → the text behind its =.

    Raises:
        ConfigurationError: No ``signal=column``, or a signal twice.
    """
    found: dict[str, str] = {}
    for item in _ITEM.findall(text):
        name, equals, source = item.partition('=')
        name = name.strip()
        if not equals or not name or not source.strip():
            raise ConfigurationError(KEY, item.strip(), 'must be SIGNAL=COLUMN, e.g. '
                                     'x0=position_m')
        if name in found:
            raise ConfigurationError(KEY, item.strip(), f'names {name} a second time')
        found[name] = source.strip()
    if not found:
        raise ConfigurationError(KEY, text, 'must be SIGNAL=COLUMN,SIGNAL=COLUMN,…')
    return found


def signals(order: int) -> tuple[str, ...]:
    """Return the signals a run of a plant of this order may have."""
    return ('stamp', *(f'x{i}' for i in range(order)), *(f'xd{i}' for i in range(order + 1)), 'v')


def check_signals(names: Sequence[str], order: int) -> None:
    """Check that signals exist.

    Raises:
        ConfigurationError: One does not.
    """
    for name in names:
        if name not in signals(order):
            raise ConfigurationError(KEY, name, f'is no signal of a run of order {order}; there '
                                     f'are {", ".join(signals(order))}')


def parse_source(text: str, columns: Sequence[str] | None) -> Source:
    """Return what a text behind a = names.

    Args:
        text: Column, factor, offset.
        columns: Those of the file; None = not known beforehand, as in a bag.

    Raises:
        ConfigurationError: No such column, factor or offset.
    """
    quoted = re.match(r"""(["'])(.*?)\1""", text)
    if quoted:
        column, rest = quoted[2], text[quoted.end():]
    elif columns is None:
        found = re.match(r'(?:[/.~]*[A-Za-z_]\w*(?:\[[^\]]+\])?)+', text)
        column = found[0] if found else ''
        rest = text[len(column):]
    else:
        starts = sorted((name for name in columns if text.startswith(name)), key=len)
        fitting = [name for name in starts if _REST.match(text[len(name):])]
        column = (fitting or starts or [''])[-1]
        rest = text[len(column):]
    if columns is not None and column not in columns:
        raise ConfigurationError(KEY, text, 'begins with no column of the file; these are '
                                 f'{close_names(re.split("[*]", text)[0].strip(), columns)}')
    match = _REST.match(rest)
    if match is None:
        raise ConfigurationError(KEY, text, f'{rest.strip()!r} is no factor (*0.001, /60, *deg) '
                                 'with an offset (+0.5) behind it')
    factor = 1.0
    if match[1]:
        if match[2].isalpha() and match[2] not in UNITS:
            raise ConfigurationError(KEY, text, f'{match[2]} is no unit; there are '
                                     f'{", ".join(UNITS)}')
        factor = UNITS[match[2]] if match[2] in UNITS else float(match[2])
        if factor == 0.0 or not math.isfinite(factor):
            raise ConfigurationError(KEY, text, 'the factor must be a finite number, not 0')
        factor = 1.0 / factor if match[1] == '/' else factor
    offset = float(f'{match[3]}1') * float(match[4]) if match[3] else 0.0
    if not math.isfinite(offset):
        raise ConfigurationError(KEY, text, 'the offset must be a finite number')
    return Source(column, factor, offset)
