# SPDX-License-Identifier: Apache-2.0
"""Write the tables of docs/notation.md that follow from declared signals.

    python tools/signal_tables.py

What stands between the two marks is replaced; `make docs` fails where it is not what this writes.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
import re
import sys

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from dz_ros.core.laws import LAWS  # noqa: E402
from dz_ros.core.records import Command, Reference, State, Terms, Truth  # noqa: E402
from dz_ros.core.signals import Role, Signal  # noqa: E402

DOCUMENT = ROOT / 'docs' / 'notation.md'
BEGIN, END = '<!-- signals: written by tools/signal_tables.py -->', '<!-- end of signals -->'


def tables() -> str:
    """Return the tables, for order 2 and one regressor; a row stands for all of its index."""
    topics = {'reference': Reference.fields(2), 'state': State.fields(2),
              'command': Command.fields(), 'terms': Terms.fields(()), 'truth': Truth.fields()}
    publishers: dict[Signal, list[str]] = {}
    for name, law in sorted(LAWS.all().items()):
        for item in law(None, 2, 1).signals:
            if item.role is not Role.MEMORY:
                publishers.setdefault(item, []).append(name)
    return '\n'.join([
        '| topic | field | symbol | unit | role | meaning |', '|---|---|---|---|---|---|',
        *(f'| all | {cells(item)} |' for item in topics['terms'][:2]),
        *(f'| `{topic}` | {cells(item)} |' for topic, fields in topics.items()
          for item in first_of_index(fields[2:])), '',
        'The signals that laws add to `terms`; those whose memory is more than that publish it as '
        'well, as it was before', 'the step, under names that end in `_before`:', '',
        '| field | symbol | unit | role | meaning | laws |', '|---|---|---|---|---|---|',
        *(f'| {cells(item)} | {", ".join(f"`{name}`" for name in publishers[item])} |'
          for item in first_of_index(publishers))])


def first_of_index(signals: Iterable[Signal]) -> list[Signal]:
    """Return signals, of those that differ in an index only the first one."""
    found: dict[tuple[str, ...], Signal] = {}
    for item in signals:
        key = tuple(re.sub(r'\d+', 'i', text) for text in (item.name, item.unit, item.meaning))
        found.setdefault(key, item)
    return list(found.values())


def cells(item: Signal) -> str:
    """Return field, symbol, unit, role, meaning of a row."""
    symbol = item.symbol.replace('*', r'\*')
    return f'`{item.name}` | {symbol} | {item.unit} | {item.role.value} | {item.meaning}'


def written(text: str) -> str:
    """Return the document with its tables replaced.

    Raises:
        ValueError: It has not the two marks.
    """
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    if END not in rest:
        raise ValueError(f'{DOCUMENT}: {BEGIN} and {END} must be in it')
    return f'{before}{BEGIN}\n\n{tables()}\n\n{END}{after}'


def main() -> int:
    """Write the document."""
    DOCUMENT.write_text(written(DOCUMENT.read_text(encoding='utf-8')), encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
