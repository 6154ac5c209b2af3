# SPDX-License-Identifier: Apache-2.0
"""What verbs print that may hold text of recordings and messages: each line stays one line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import csv
import json
from pathlib import Path
import sys
from typing import Any, TextIO, TYPE_CHECKING

from dz_ros.core.text import printable

FORMULA = ('=', '+', '-', '@')
"""What a spreadsheet takes for the begin of a formula."""

if TYPE_CHECKING:
    from dz_ros.core.dataset import RunData  # load numpy
    from dz_ros.runs.setting import Setting


def print_lines(lines: str | Iterable[str], file: TextIO | None = None) -> None:
    """Print a line, or lines, with control characters escaped.

    Args:
        lines: One line, or several; a line break within one is escaped as well.
        file: Where to; None = standard output.
    """
    for line in (lines,) if isinstance(lines, str) else lines:
        print(printable(line), file=file or sys.stdout, flush=False)


def print_json(value: Any, indent: int | None = 2, flush: bool = False) -> None:
    """Print a value as JSON with letters as they are, control characters and marks escaped."""
    text = json.dumps(value, ensure_ascii=False, indent=indent)
    if not text.isascii() or '\x7f' in text:
        text = ''.join(item if item == '\n' or item.isprintable() else json.dumps(item)[1:-1]
                       if ord(item) > 0x7f else f'\\u{ord(item):04x}' for item in text)
    print(text, flush=flush)


def write_csv(table: Mapping[str, Any], file: TextIO) -> None:
    """Write columns as CSV, floats with 17 digits, so that nothing is lost; NaN is empty.

    Names may be a recording's: a spreadsheet takes one that begins with =, +, - or @ for a
    formula, so these get a ' before them, and control characters are escaped.
    """
    form = ','.join('%d' if item.dtype.kind == 'i' else '%.17g' for item in table.values()) + '\n'
    names = [printable(name) for name in table]
    csv.writer(file, lineterminator='\n').writerow(
        [f"'{name}" if name[:1] in FORMULA else name for name in names])
    file.writelines((form % row).replace('nan', '') for row in zip(
        *(item.tolist() for item in table.values()), strict=True))


@contextmanager
def whole_file(path: Path) -> Iterator[None]:
    """Remove a new file that cannot be written as a whole; name it in the error."""
    try:
        yield
    except BaseException as error:
        path.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        raise


def note(text: str) -> None:
    """Print a note on standard error."""
    print_lines(f'dz: note: {text}', sys.stderr)


def note_run(data: RunData, name: str = 'the run') -> None:
    """Note that a run was cut off, and what else its reader found."""
    if 'cut' in data.info:
        note(f'{name} was cut off: {data.info["cut"]}')
    if 'notes' in data.info:
        note(data.info['notes'] if name == 'the run' else f'{name}: {data.info["notes"]}')


def aligned(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,),
            indent: str = '') -> list[str]:
    """Return rows as lines of columns, right-aligned but those in `left`."""
    def padded(text: str, width: int, begins: bool) -> str:
        blank = ' ' * (width - _visible(text))      # a combining mark takes no column
        return text + blank if begins else blank + text

    widths = [max(map(_visible, column)) for column in zip(*rows, strict=True)]
    return [(indent + '  '.join(padded(cell, width, place in left) for place, (cell, width)
                                in enumerate(zip(row, widths, strict=True)))).rstrip()
            for row in rows]


def _visible(text: str) -> int:
    return len(text.replace('\N{COMBINING TILDE}', ''))


def note_problems(settings: Mapping[str, Setting], allowed: Sequence[str]) -> int:
    """Note for each run why its configuration cannot be used here, and what that leaves out.

    Args:
        settings: Name → setting of a run.
        allowed: What --allow-import named.

    Returns:
        Exit code: 1 where a configuration cannot be used although modules were allowed for it.
    """
    problems = {name: item.problem for name, item in settings.items() if item.problem}
    for name, problem in problems.items():
        note(f'{name}: units, bounds and true parameters are unknown: {problem}')
    return 1 if problems and allowed else 0
