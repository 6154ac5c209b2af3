# SPDX-License-Identifier: Apache-2.0
"""Retired words of docs/terms.md in documents, package, configurations, launch files and tests.

The last column of the table in docs/terms.md lists them; one in backquotes is matched as it is
written, any other whatever its case. Of Python the docstrings, comments, texts and names are read;
of other files everything. A name such as `heard_at` or `isHeard` is read as its parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from functools import cache
import io
from pathlib import Path
import re
import tokenize

TERMS = 'docs/terms.md'
SUFFIXES = ('.py', '.md', '.yaml', '.js', '.html', '.css')
FOLDERS = ('dz_ros', 'config', 'launch', 'docs', 'test')
DOCUMENTS = ('README.md', 'CONTRIBUTING.md')
CONSTANTS = frozenset(('MOST', 'KEPT', 'EVERY', 'PATIENCE'))
MODULES = frozenset(('telling', 'steering', 'taking', 'stated', 'aside', 'clockwork', 'measures',
                     'counterpart', 'guarded', 'hosting', 'queued', 'recorded'))
"""Names of files that do not say what is inside."""
NOT_YET: tuple[str, ...] = ()
"""Folders and documents that are not in order yet: their faults are counted, not refused."""
ALLOWED: tuple[tuple[str, str, str], ...] = (
    ('docs/serial.md', 'anew', 'a message of drivers/serial/link.py'),
    ('docs/terms.md', '', 'lists them'),
    ('docs/references.md', '', 'titles of other authors'),
    ('dz_ros/drivers/cia402/connection.py', 'listener', 'a class of canopen'),
    ('dz_ros/live/server.py', 'listen*', 'sockets listen'),
    ('dz_ros/runtime/claim.py', 'listen*', 'sockets listen'),
    ('dz_ros/recording/output_file.py', 'tell', 'a method of files'),
    ('dz_ros/recording/writer.py', 'tell', 'a method of files'),
    ('dz_ros/core/renamed.py', 'kick*', 'the earlier names themselves'),
    ('test/cli/test_cli_show.py', 'kick', 'the earlier names themselves'),
    ('test/test_old_recordings.py', 'kick', 'the earlier names themselves'),
    ('test/tools/test_tools.py', '', 'files with retired words, to be found'),
)
"""Path, pattern of words ('' = all), reason."""


def faults(root: Path, files: Iterable[Path]) -> tuple[list[str], Counter[str]]:
    """Return the faults, and the number of them in each folder that is not in order yet."""
    wanted = patterns((root / TERMS).read_text(encoding='utf-8'))
    found: list[str] = []
    counted: Counter[str] = Counter()
    for path in files:
        name = path.as_posix()
        if path.suffix not in SUFFIXES or 'vendor' in path.parts or not (
                path.parts[0] in FOLDERS or name in DOCUMENTS):
            continue
        text = (root / path).read_text(encoding='utf-8')
        if path.suffix == '.py' and path.stem in MODULES:
            text += f'\n# {path.stem}\n'
            faulty = [(1, f'a file called {path.stem}')]
        else:
            faulty = []
        faulty += [(line, word) for line, word in used(text, path.suffix, wanted)
                   if not allowed(name, word)]
        folder = next((item for item in NOT_YET if name == item or name.startswith(f'{item}/')),
                      None)
        if folder is not None:
            counted[folder] += len(faulty)
        else:
            found += [f'{name}:{line}: {word!r}: see {TERMS}' for line, word in faulty]
    return found, counted


def allowed(name: str, word: str) -> bool:
    """Return whether a file may use a word."""
    return any(name == path and fnmatch(word.lower(), exempt or '*')
               for path, exempt, _ in ALLOWED)


def patterns(page: str) -> tuple[re.Pattern[str], ...]:
    """Return a pattern for each retired word of the page."""
    found = []
    for line in page.splitlines():
        cells = re.split(r'(?<!\\)\|', line)
        if len(cells) != 6 or cells[4].strip() in ('not', '---'):
            continue
        for word in filter(None, (item.strip() for item in cells[4].split(','))):
            exact = word.startswith('`')
            body = r'[\s]+'.join(map(re.escape, word.strip('`').split()))
            found.append(re.compile(rf'(?<![A-Za-z]){body}(?![A-Za-z])', 0 if exact else re.I))
    return tuple(found)


def used(text: str, suffix: str, wanted: tuple[re.Pattern[str], ...]) -> Iterator[tuple[int, str]]:
    """Yield (line, word) of each retired word in a file's text."""
    for line, piece in python_pieces(text) if suffix == '.py' else [(1, text)]:
        for start, word in inside(piece, wanted):
            yield line + piece.count('\n', 0, start), word


@cache
def inside(piece: str, wanted: tuple[re.Pattern[str], ...]) -> tuple[tuple[int, str], ...]:
    """Return (place, word) of each retired word of a piece; most names are used many times."""
    constant = ((0, piece),) if piece in CONSTANTS else ()
    shown = parted(piece)
    if any_of(wanted).search(shown) is None:
        return constant
    return constant + tuple((match.start(), match.group()) for pattern in wanted
                            for match in pattern.finditer(shown))


@cache
def any_of(wanted: tuple[re.Pattern[str], ...]) -> re.Pattern[str]:
    """Return one pattern that finds something where one of several does."""
    return re.compile('|'.join(pattern.pattern for pattern in wanted), re.I)


def parted(text: str) -> str:
    """Return a text of the same length whose names are parted at _, and at capitals by case."""
    return re.sub(r'(?<=[A-Za-z])_(?=[A-Za-z])', ' ', text)


def python_pieces(text: str) -> Iterator[tuple[int, str]]:
    """Yield (line, text) of names, and of comments and texts that follow each other as one."""
    joined: list[str] = []
    begin, kind = 1, 0
    texts = {tokenize.STRING, *(getattr(tokenize, name) for name in ('FSTRING_MIDDLE',)
                                if hasattr(tokenize, name))}
    silent = {tokenize.NL, tokenize.INDENT, tokenize.DEDENT}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        now = tokenize.STRING if token.type in texts else token.type
        if now in silent or (now == tokenize.NEWLINE and kind == tokenize.COMMENT):
            continue
        if now not in (tokenize.STRING, tokenize.COMMENT) or now != kind:
            if joined:
                yield begin, '\n'.join(joined)
            joined, begin = [], token.start[0]
        kind = now
        if now == tokenize.NAME:
            yield token.start[0], re.sub(r'(?<=[a-z])(?=[A-Z])', '_', token.string)
        elif now == tokenize.STRING:
            joined.append(token.string[1:-1] if token.type == tokenize.STRING else token.string)
        elif now == tokenize.COMMENT:
            joined.append(token.string.lstrip('# '))
    if joined:
        yield begin, '\n'.join(joined)
