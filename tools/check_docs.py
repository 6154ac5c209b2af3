"""Check the documents: links lead somewhere, citations resolve, the map of folders is true.

- Every relative link and picture in a Markdown file exists, and so does the heading after ``#``.
- Every citation ``[nameYEAR]`` in code, configuration and documents has one entry in
  docs/references.md, and every entry there is cited.
- The map of folders in README.md names every folder of the project and of dz_ros, and no other.
"""

from collections import Counter
from pathlib import Path
import re
import subprocess
import sys

ROOT = Path(__file__).resolve().parent.parent
REFERENCES = 'docs/references.md'
LINK = re.compile(r'!?\[[^\]]*\]\(([^)\s]+)\)')
CITATION = re.compile(r'\[([a-z_]+[0-9]{4}[a-z]?(?:; ?[a-z_]+[0-9]{4}[a-z]?)*)\](?!\()')
ENTRY = re.compile(r'^@\w+\{(\w+),', re.MULTILINE)
MAP_LINE = re.compile(r'^( *)([\w.-]+)/ ', re.MULTILINE)
CITING = ('.py', '.md', '.yaml', '.cff')


def main() -> int:
    """Print every fault; return 1 if there is one."""
    files = tracked_files()
    faults = [*links(files), *citations(files), *folders(files)]
    for fault in faults:
        print(f'docs: {fault}', file=sys.stderr)
    if not faults:
        count = sum(path.suffix == '.md' for path in files)
        print(f'docs: links, citations and map of folders of {count} documents in order')
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
    return faults + [f'{REFERENCES}: nobody cites {key}' for key in sorted(set(entries) - cited)]


def folders(files: list[Path]) -> list[str]:
    """Return what the map of folders in the README lacks or invents."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    blocks = [block for block in re.findall(r'^```\w*\n(.*?)^```', text, re.M | re.S)
              if re.search(r'^dz_ros/ ', block, re.M)]
    if len(blocks) != 1:
        return ['README.md: there must be one map of folders, a code block with a line dz_ros/']
    shown = set()
    for indent, name in MAP_LINE.findall(blocks[0]):
        shown.add(f'dz_ros/{name}' if indent else name)
    real = set()
    for path in files:
        if len(path.parts) > 1:
            real.add(path.parts[0])
        if len(path.parts) > 2 and path.parts[0] == 'dz_ros':
            real.add(f'dz_ros/{path.parts[1]}')
    return ([f'README.md: the map of folders lacks {name}/' for name in sorted(real - shown)]
            + [f'README.md: the map names {name}/, which is not there'
               for name in sorted(shown - real)])


if __name__ == '__main__':
    sys.exit(main())
