# SPDX-License-Identifier: Apache-2.0
"""Text of unknown origin made safe to show: recordings and messages may hold anything.

A name, a reason or a label with a line break in it can forge a line of its own, an escape sequence
can repaint a terminal, a right-to-left mark can reorder what is read. `printable` shows such
characters as escapes, everywhere such a text leaves the program: terminal, log, page.
"""

from __future__ import annotations

import unicodedata

LONGEST = 300
"""Characters of a text that are shown where it is a detail of something else."""


def printable(text: object, longest: int | None = None) -> str:
    """Return a text with every character that is not visible in place escaped, as Python does.

    Control, format (bidirectional marks), separator and unassigned characters are escaped; spaces
    of any width are kept; at most `longest` characters are shown, None = all.
    """
    found = str(text)
    if longest is not None and len(found) > longest:
        found = f'{found[:longest]}…'
    if found.isprintable():
        return found
    return ''.join(item if item.isprintable() or unicodedata.category(item) == 'Zs'
                   else item.encode('unicode_escape').decode() for item in found)


def counted(number: int, word: str) -> str:
    """Return a number with its word, which takes an s but for 1."""
    return f'{number} {word}{"" if number == 1 else "s"}'


def plain(text: object, longest: int | None = None) -> str:
    r"""Return a text as `printable`, and with each $ escaped: matplotlib takes none for TeX."""
    return printable(text, longest).replace('$', r'\$')
