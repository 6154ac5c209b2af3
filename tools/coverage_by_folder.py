# SPDX-License-Identifier: Apache-2.0
"""Print how much of each folder of dz_ros a coverage measurement ran, and the least covered files.

    python tools/coverage_by_folder.py DATA

DATA is what `make coverage` wrote, with the data of every process beside it (DATA.*).
"""

from collections import defaultdict
import json
from pathlib import Path
import sys
import tempfile

import coverage

LEAST = 15
"""So many files are named."""


def main(data):
    """Print the table; return an exit code."""
    measured = coverage.Coverage(data_file=data)
    if list(Path(data).parent.glob(f'{Path(data).name}.*')):
        measured.combine([str(Path(data).parent)], keep=False)
        measured.save()
    measured.load()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / 'coverage.json'
        measured.json_report(outfile=str(report))
        files = json.loads(report.read_text(encoding='utf-8'))['files']
    sums = defaultdict(lambda: [0, 0, 0, 0])
    for name, found in files.items():
        for place, key in enumerate(('covered_lines', 'num_statements', 'covered_branches',
                                     'num_branches')):
            for folder in {str(Path(name).parent), 'all'}:
                sums[folder][place] += found['summary'][key]
    print(f'{"folder":40} {"lines":>14} {"branches":>14}')
    for folder, (lines, of_lines, branches, of_branches) in sorted(sums.items()):
        print(f'{folder:40} {share(lines, of_lines):>14} {share(branches, of_branches):>14}')
    least = sorted((found['summary']['percent_covered'], name) for name, found in files.items())
    print(f'\nleast covered, of {len(files)} files:')
    for percent, name in least[:LEAST]:
        missing = files[name]['missing_lines']
        print(f'{percent:5.1f} %  {name}: {len(missing)} lines, {ranges(missing)}')
    return 0


def share(part, whole):
    """Return e.g. '90 of 100 90 %'."""
    return f'{part}/{whole} {100.0 * part / whole if whole else 100.0:3.0f} %'


def ranges(numbers):
    """Return the first of these numbers, those in a row as 3-7."""
    found = []
    for number in numbers:
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    text = [f'{a}' if a == b else f'{a}-{b}' for a, b in found]
    return ', '.join(text[:12]) + (' …' if len(text) > 12 else '')


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
