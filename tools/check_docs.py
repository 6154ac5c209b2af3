# SPDX-License-Identifier: Apache-2.0
"""Check the documents: links lead somewhere, citations resolve, the map of folders is true.

- Every relative link and picture in a Markdown file exists, and so does the heading after ``#``.
- Every citation ``[nameYEAR]`` in code, configuration and documents has one entry in
  docs/references.md, and every entry there is cited.
- Every ``mathematics.md §n`` in code and documents is a heading of docs/mathematics.md.
- The tables of signals in docs/notation.md are what tools/signal_tables.py writes.
- docs/index.md lists every document in docs/.
- Every file of this project that a document names is there.
- No retired word of docs/terms.md is used (tools/retired_words.py).
- The tables of folders in docs/architecture.md name every folder of the project and of dz_ros, and
  no other.
"""

from collections import Counter
from pathlib import Path
import re
import subprocess
import sys

import retired_words

ROOT = Path(__file__).resolve().parent.parent
REFERENCES = 'docs/references.md'
INDEX, MATHEMATICS, NOTATION = 'docs/index.md', 'docs/mathematics.md', 'docs/notation.md'
LINK = re.compile(r'!?\[[^\]]*\]\(([^)\s]+)\)')
CITATION = re.compile(r'\[([a-z_]+[0-9]{4}[a-z]?(?:; ?[a-z_]+[0-9]{4}[a-z]?)*)\](?!\()')
ENTRY = re.compile(r'^@\w+\{(\w+),', re.MULTILINE)
MAP, INSIDE, BESIDE = 'docs/architecture.md', 'Folders of `dz_ros/`:', 'Beside `dz_ros/`:'
MAP_LINE = re.compile(r'^\| `([\w.-]+)/` \|', re.MULTILINE)
SECTION = re.compile(r'§\d+')
CITING = ('.py', '.md', '.yaml', '.cff')


def main() -> int:
    """Print every fault; return 1 if there is one."""
    files = tracked_files()
    words, waiting = retired_words.faults(ROOT, files)
    faults = [*links(files), *index(files), *citations(files), *folders(files), *sections(files),
              *signals(files), *named(files), *words]
    for fault in faults:
        print(f'docs: {fault}', file=sys.stderr)
    if not faults:
        count = sum(path.suffix == '.md' for path in files)
        print(f'docs: links, citations, words, sections, tables and map of {count} documents in '
              'order')
    for folder, count in waiting.items():
        if count:
            print(f'docs: note: {folder}: {count} retired words')
    return 1 if faults else 0


def tracked_files() -> list[Path]:
    """Return the project's files, relative to its root: what git knows, or would take."""
    done = subprocess.run(['git', 'ls-files', '--cached', '--others', '--exclude-standard'],
                          cwd=ROOT, capture_output=True, text=True, check=False)
    names = done.stdout.splitlines() if done.returncode == 0 else [
        str(path.relative_to(ROOT)) for path in ROOT.rglob('*')]
    return sorted(Path(name) for name in set(names)
                  if (ROOT / name).is_file() and not name.startswith('.'))


def links(files: list[Path]) -> list[str]:
    """Return the links that lead nowhere."""
    faults = []
    for path in files:
        if path.suffix != '.md':
            continue
        text = without_code((ROOT / path).read_text(encoding='utf-8'))
        for target in LINK.findall(text):
            if re.match(r'[a-z]+:', target):
                continue
            name, _, heading = target.partition('#')
            aim = (ROOT / path).parent / name if name else ROOT / path
            if not aim.exists():
                faults.append(f'{path}: {target} does not exist')
            elif heading and heading not in anchors(aim):
                faults.append(f'{path}: {target}: no such heading')
    return faults


def index(files: list[Path]) -> list[str]:
    """Return the documents that the index lacks."""
    text = (ROOT / INDEX).read_text(encoding='utf-8')
    listed = {match[1] for match in re.finditer(r'^([\w/]+)$', text, re.MULTILINE)}
    names = [path.relative_to('docs').with_suffix('').as_posix() for path in files
             if path.parts[0] == 'docs' and path.suffix == '.md']
    return [f'{INDEX}: lacks {name}' for name in names if name not in listed | {'index'}]


def named(files: list[Path]) -> list[str]:
    """Return the files of this project that documents name and that are not there."""
    stems = {path.stem for path in files if path.parts[0] == 'test'}
    folders = {path.parts[0] for path in files if len(path.parts) > 1} | {
        path.parts[1] for path in files if path.parts[0] == 'dz_ros' and len(path.parts) > 2}
    faults = []
    for path in files:
        if path.suffix != '.md':
            continue
        text = (ROOT / path).read_text(encoding='utf-8')
        faults += [f'{path}: there is no {name}.py in test/'
                   for name in re.findall(r'`(test_\w+)(?:\.py)?`', text) if name not in stems]
        faults += [f'{path}: there is no {name}'
                   for name in re.findall(r'`((?:\w+/)+\w+\.(?:py|md|yaml|c|h|js))`', text)
                   if name.partition('/')[0] in folders
                   and not any((ROOT / folder / name).exists() for folder in ('', 'dz_ros'))
                   and not (ROOT / path.parent / name).exists()]
    return faults


def without_code(text: str) -> str:
    """Return the text without code blocks and quoted code."""
    return re.sub(r'`[^`\n]*`', '', re.sub(r'^```.*?^```', '', text, flags=re.M | re.S))


def anchors(path: Path) -> set[str]:
    """Return the anchors of a document's headings as web pages name them."""
    headings = re.findall(r'^#+ +(.+?) *#*$', path.read_text(encoding='utf-8'), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


def citations(files: list[Path]) -> list[str]:
    """Return citations without entry, entries given twice or never cited."""
    entries = Counter(ENTRY.findall((ROOT / REFERENCES).read_text(encoding='utf-8')))
    faults = [f'{REFERENCES}: {key} is given {count} times'
              for key, count in entries.items() if count > 1]
    cited = set()
    for path in files:
        if path.suffix not in CITING or str(path) == REFERENCES or path.parts[0] == 'test':
            continue
        for number, line in enumerate((ROOT / path).read_text(encoding='utf-8').splitlines(), 1):
            for group in CITATION.findall(line):
                for key in re.split('; ?', group):
                    cited.add(key)
                    if key not in entries:
                        faults.append(f'{path}:{number}: [{key}] is not in {REFERENCES}')
    return faults + [f'{REFERENCES}: nothing cites {key}' for key in sorted(set(entries) - cited)]


def sections(files: list[Path]) -> list[str]:
    """Return the sections of docs/mathematics.md that are mentioned and not there."""
    text = (ROOT / MATHEMATICS).read_text(encoding='utf-8') if Path(MATHEMATICS) in files else ''
    headings = set(re.findall(r'^## (\d+)\.', text, re.MULTILINE))
    faults = []
    for path in files:
        if path.suffix not in CITING or path.name == 'check_docs.py':
            continue
        text = (ROOT / path).read_text(encoding='utf-8')
        for found in SECTION.finditer(text):
            for number in re.findall(r'§(\d+)', found[0]):
                if number not in headings:
                    line = text.count('\n', 0, found.start()) + 1
                    faults.append(f'{path}:{line}: {MATHEMATICS} has no section {number}')
    return faults


def signals(files: list[Path]) -> list[str]:
    """Return whether the tables of signals are old."""
    if Path(NOTATION) not in files:
        return []
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    from signal_tables import written
    text = (ROOT / NOTATION).read_text(encoding='utf-8')
    return [] if written(text) == text else [
        f'{NOTATION}: old tables of signals: python tools/signal_tables.py']


def folders(files: list[Path]) -> list[str]:
    """Return what the tables of folders lack or invent."""
    if Path(MAP) not in files:
        return [f'{MAP}: is missing, which has the tables of folders']
    text = (ROOT / MAP).read_text(encoding='utf-8')
    inside, found, beside = text.partition(INSIDE)[2].partition(BESIDE)
    if not found:
        return [f'{MAP}: there must be two tables of folders, after {INSIDE!r} and {BESIDE!r}']
    shown = {f'dz_ros/{name}' for name in MAP_LINE.findall(inside)}
    shown |= {'dz_ros', *MAP_LINE.findall(beside)}
    real = set()
    for path in files:
        if len(path.parts) > 1:
            real.add(path.parts[0])
        if len(path.parts) > 2 and path.parts[0] == 'dz_ros':
            real.add(f'dz_ros/{path.parts[1]}')
    return ([f'{MAP}: lacks the folder {name}/' for name in sorted(real - shown)]
            + [f'{MAP}: the folder {name}/ is not there'
               for name in sorted(shown - real)])


if __name__ == '__main__':
    sys.exit(main())
