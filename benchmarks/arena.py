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
from dz_ros.core.laws.exact_inverse import ExactInverseGains
from dz_ros.studies.arena import Arena, Plan, run_arena
from dz_ros.studies.arena_page import conditions, format_text, HEAD, pictures, tables, verdicts
from dz_ros.studies.scenarios import IDEAL, scenarios

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
    'Apart by more than 20 %: the best rival under drift, here `neural` with 0.0041. By '
    'experiment, one thing changed at a time: neither the integration (one RK4 step a sample '
    'instead of four: the same to 4 digits) nor the seed (0 to 11: 0.0040 to 0.0048) nor the '
    'initial guess of the dead-zone (0.0041) explains 0.0052. Two things move the number by '
    'as much. First the hidden layer, of which only "12 sigmoids" is known: spread over ±15, '
    '±17, ±20 instead of ±10 they give 0.0049, 0.0054, 0.0054, and ten instead of twelve of '
    'them 0.0049. Second the window: drift (0.9 and 0.7 rad/s) beats with the reference (1 '
    'rad/s) with periods of 63 and 21 s, so that the last 10 s are a matter of luck; over the '
    'eleven windows of 10 s from 10 to 120 s the largest error of `neural` is 0.0041 to '
    '0.0058, in this one 0.0041, in the one before 0.0049; `exact_inverse k=2.5` has 0.0047 '
    'to 0.0055, `fuzzy` 0.0049 to 0.0064. So the 0.0052 is most likely that of a net spread '
    'otherwise, and a ranking of these three under drift from one window means nothing. '
    'Spread over ±16.5 the net gives both 0.0052 here and 0.0045 in the nominal scenario, as '
    'was found then, but 0.0078 at b = 0.5 (then: 0.0058), so the very net is not recovered. '
    'The number in the table is right for the laws as they stand in `dz_ros/core/laws/`.')
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
            best = best_rival(arena, scenario)
            lines.append(line(scenario, f'best rival, here `{best}`', BEST_RIVAL[scenario],
                              arena.cells[best, scenario].mean('error_max')))
    return lines


def best_rival(arena: Arena, scenario: str) -> str:
    """Return the entrant with the smallest error that is neither ours nor the ideal."""
    return next(name for name in arena.ranking(scenario)
                if name not in OURS and not name.startswith(IDEAL))


def line(scenario: str, law: str, value: float, found: float | None) -> str:
    """Return a line of it; a ratio off by more than 20 % is bold."""
    ratio = (found or 0.0) / value
    shown = f'{ratio:.2f}' if 0.8 <= ratio <= 1.2 else f'**{ratio:.2f}**'
    return f'| {scenario} | {law} | {value:g} | {found or 0.0:.4g} | {shown} |'


def write(arena: Arena) -> None:
    """Write docs/arena.md and its pictures."""
    limit = scenarios()['saturation'].members[0]['controller.v_max']
    known = ExactInverseGains()
    lines = ['# Comparison of laws', '',
             'Written by `python benchmarks/arena.py --write`; the same tables, with a page of '
             'their own, come from `dz arena --out DIR`. ' + conditions(arena), '',
             'Nobody is tuned for a scenario: gains are those of `dz_ros/core/laws/`, the same in '
             f'every row but one: under saturation `robust` is told the limit, v_max = {limit:g}. '
             '(`extended` is given it too, without effect: its `anti_windup` is off. No other law '
             'has a place for it.) `fuzzy`, `neural` and `adaptive_inverse` are rebuilt after '
             f'descriptions, not transcribed; `{IDEAL}` knows the dead-zone of the example, b_r = '
             f'{known.b_r:g} and b_l = {known.b_l:g}, and is an ideal, not a rival; under drift '
             'it goes on using these two numbers while those of the plant change, so there it is '
             'no ideal either. Scenarios are defined in `dz_ros/studies/scenarios.py`.', '']
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
