"""The comparison of laws for the documents: every law in every scenario, from fixed seeds.

    python benchmarks/arena.py            print the tables
    python benchmarks/arena.py --write    write docs/arena.md and its pictures

The numbers do not hang on the machine or on the number of its cores.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from dz_ros.core.compiled import available
from dz_ros.studies.arena import Arena, Plan, run_arena
from dz_ros.studies.arena_page import conditions, format_text, HEAD, pictures, tables, verdicts

ROOT = Path(__file__).resolve().parent.parent

EXPECTED = {
    'nominal': {'pd': .37, 'pid': .125, 'adaptive': .052, 'sliding': .014,
                'sliding_integral': .005, 'exact_inverse k=2.5': .0053,
                'adaptive_inverse': .0070, 'fuzzy': .0042, 'neural': .0045, 'wang2004': .0084,
                'robust': .00062},
    'drift': {'wang2004': .0085, 'robust': .0006}, 'b=0.5': {'wang2004': .038, 'robust': .0018},
    'b=2': {'wang2004': .0065, 'robust': .0004}, 'noise': {'wang2004': .0091, 'robust': .0014},
    'saturation': {'wang2004': .0085, 'robust': .0006},
    'delay 1': {'wang2004': .0085, 'robust': .0006},
    'delay 2': {'wang2004': .0085, 'robust': .0007},
    'b=2, delay 1': {'wang2004': .0065, 'robust': .0004},
}
"""max|x̃| found when the laws were designed, by programs that share no code with this one."""
BEST_RIVAL = {'nominal': .0042, 'drift': .0052, 'b=0.5': .0058, 'b=2': .0045, 'noise': .0056,
              'saturation': .0045, 'delay 1': .0045}
"""The same of the best rival of each scenario."""
NOTE = (
    'Apart by more than 20 %: the best rival under drift. Here it is `neural`, 0.0041 with the '
    'hidden layer that seed 0 draws; seeds 0 to 7 give 0.0040 to 0.0048. The next ones are '
    '`exact_inverse k=2.5` with 0.0055 and `fuzzy` with 0.0060. The 0.0052 was not said to be of '
    'which law; a hidden layer drawn otherwise might explain it, which cannot be checked. For the '
    'laws as they stand in `dz_ros/core/laws/` the number in the table is right.')
OURS = ('robust', 'wang2004', 'extended')


def main() -> int:
    """Compare all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help='write documents and pictures')
    parser.add_argument('-j', '--jobs', type=int, default=0, help='processes')
    arguments = parser.parse_args()
    if not available():
        print('numba is not installed: this takes an hour instead of minutes')
    arena = run_arena(Plan.of(), arguments.jobs,
                      progress=lambda done, total, name: print(f'{done}/{total} {name}',
                                                               file=sys.stderr, flush=True))
    print(format_text(arena), conditions(arena), *verdicts(arena), *expected(arena), sep='\n')
    if arguments.write:
        write(arena)
    return 0


def expected(arena: Arena) -> list[str]:
    """Return the Markdown table of designed for and found."""
    lines = ['| scenario | law | designed for | found | ratio |', '|---|---|---|---|---|']
    for scenario, laws in EXPECTED.items():
        for law, value in laws.items():
            lines.append(line(scenario, f'`{law}`', value,
                              arena.cells[law, scenario].mean('error_max')))
        if scenario in BEST_RIVAL:
            best = next(name for name in arena.ranking(scenario) if name not in OURS)
            lines.append(line(scenario, f'best rival, here `{best}`', BEST_RIVAL[scenario],
                              arena.cells[best, scenario].mean('error_max')))
    return lines


def line(scenario: str, law: str, value: float, found: float | None) -> str:
    """Return a line of it; a ratio off by more than 20 % is bold."""
    ratio = (found or 0.0) / value
    shown = f'{ratio:.2f}' if 0.8 <= ratio <= 1.2 else f'**{ratio:.2f}**'
    return f'| {scenario} | {law} | {value:g} | {found or 0.0:.4g} | {shown} |'


def write(arena: Arena) -> None:
    """Write docs/arena.md and its pictures."""
    lines = ['# Comparison of laws', '',
             'Written by `python benchmarks/arena.py --write`; the same tables, with a page of '
             'their own, come from `dz arena --out DIR`. ' + conditions(arena), '',
             'Nobody is tuned for a scenario: gains are those of `dz_ros/core/laws/`, the same in '
             'every row. `fuzzy`, `neural` and `adaptive_inverse` are rebuilt after descriptions, '
             'not transcribed; `exact_inverse` knows the dead-zone and is an ideal, not a rival. '
             'Scenarios are defined in `dz_ros/studies/scenarios.py`.', '']
    for picture in pictures(arena):
        (ROOT / 'docs' / 'images' / f'arena_{picture.name}.png').write_bytes(picture.png())
        lines += [f'![{picture.alt}](images/arena_{picture.name}.png)', '', picture.caption, '']
    lines += ['## Where another law is better', '', *(f'- {item}' for item in verdicts(arena)),
              '', '## Scenarios', '']
    for name, summary, rows in tables(arena):
        lines += [f'### {name}', '', f'{summary}.', '',
                  '| ' + ' | '.join(HEAD).replace('|x̃|', 'x̃').replace('|v|', 'v') + ' |',
                  '|' + '---|' * len(HEAD), *(f'| {" | ".join(row)} |' for row in rows), '']
    lines += ['## Against what the laws were designed for', '',
              'Largest error, and what separate programs gave when the laws were designed; more '
              'than 20 % apart is bold.', '', *expected(arena), '', NOTE, '']

    (ROOT / 'docs' / 'images').mkdir(exist_ok=True)
    (ROOT / 'docs' / 'arena.md').write_text('\n'.join(lines), encoding='utf-8')


if __name__ == '__main__':
    sys.exit(main())
