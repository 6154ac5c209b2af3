# SPDX-License-Identifier: Apache-2.0
"""The comparison as tables: for a terminal, as Markdown for the documents, as one HTML page."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from pathlib import Path

from dz_ros.core.text import counted
from dz_ros.report import page
from dz_ros.report.report import write_files
from dz_ros.report.style import Picture
from dz_ros.runs.metrics import window_length
from dz_ros.studies.arena import Arena, Cell
from dz_ros.studies.arena_pictures import best_and_worst, overview, scatter
from dz_ros.studies.scenarios import yardstick

PAGE, TABLE = 'arena.html', 'arena.csv'
"""File names."""
HEAD = ('law', 'max |x̃|', 'RMS x̃', 'TV of v per s', 'v above 10 Hz', 'peak |v|', 'recovery s',
        'within Ω_ε', 'lost')
NAMES = ('error_max', 'error_rms', 'v_variation', 'v_highpass', 'v_peak_run')
REFERENCE = 'robust_eso'
"""The entrant with which the others are compared."""
OURS = ('robust_eso', 'robust', 'extended')
"""Laws that are ours; `extended` is the paper's law with our switches."""
COMPARED = {'error_max': 'max |x̃|', 'v_variation': 'TV of v per s', 'v_highpass': 'v above 10 Hz',
            'v_peak_run': 'peak |v|', 'recovery_time': 'recovery s'}
"""Numbers of `beaten`, with their titles."""
BEATEN = ('scenario', 'number', REFERENCE, 'least', 'its number', 'its max |x̃|', 'also less')
NEAR = 1.05
"""Numbers whose ratio is below this count as equal."""


def table_row(name: str, cell: Cell, disturbed: bool) -> list[str]:
    """Return a cell as texts, in the order of `HEAD`."""
    return [name, *(number(cell.mean(item)) for item in NAMES),
            recovery(cell) if disturbed else '',
            'yes' if cell.within else 'no',
            f'{cell.lost} of {len(cell.rows)}' if cell.lost else '0']


def number(value: float | None) -> str:
    """Return four significant digits, a dash for nothing."""
    return '–' if value is None else f'{value:.4g}'


def recovery(cell: Cell) -> str:
    """Return the mean recovery time, or how many members never recovered."""
    found = cell.values('recovery_time')
    missing = len(cell.rows) - len(found)
    return f'never in {missing} of {len(cell.rows)}' if missing else number(sum(found)
                                                                            / len(found))


def tables(arena: Arena) -> Iterator[tuple[str, str, list[list[str]]]]:
    """Yield (scenario, what it is, its rows by ascending error)."""
    for name, scenario in arena.plan.scenarios.items():
        column = arena.column(name)
        disturbed = any('plant.disturbance_pulse' in member for member in scenario.members)
        yield name, scenario.summary, [table_row(entrant, column[entrant], disturbed)
                                       for entrant in arena.ranking(name)]


def beaten(arena: Arena) -> list[list[str]]:
    """Return where another law is better than the recommended, in the columns of `BEATEN`.

    A line for each scenario and number in which some law is; by a ratio of at least `NEAR`, and
    not lost. A small effort with a large error is no win: the error stands beside it.
    """
    if REFERENCE not in arena.plan.entrants:
        return []
    found = []
    for name in arena.plan.scenarios:
        column = arena.column(name)
        for key, title in COMPARED.items():
            own = column[REFERENCE].mean(key)
            if own is None:
                continue
            rivals = sorted((value, law) for law, cell in column.items()
                            if law != REFERENCE and not cell.lost
                            and (value := cell.mean(key)) is not None and value * NEAR < own)
            if rivals:
                value, law = rivals[0]
                found.append([name, title, number(own), law, number(value),
                              number(column[law].mean('error_max')),
                              ', '.join(law for _, law in rivals[1:])])
    return found


def where_better(begin: str, count: int, first: int, near: int,
                 beaten: Sequence[Sequence[str]]) -> list[str]:
    """Return in Markdown where the recommended law has the smallest error, and where not.

    Args:
        begin: First words of the sentence.
        count: Number of scenarios.
        first: In how many it has the smallest error.
        near: In how many more within `NEAR` of the smallest.
        beaten: Of the rest scenario, better law, how many times smaller its error is.
    """
    sentence = (f'{begin} has the smallest error in {first} of {count} scenarios'
                + (f', and is within {100 * (NEAR - 1):.0f} % of the smallest in {near} more'
                   if near else ''))
    if not beaten:
        return [f'{sentence}.']
    return [f'{sentence}; another law is better in {len(beaten)}:', '',
            '| scenario | better law | error, times smaller |', '|---|---|---|',
            *(f'| {name} | `{law}` | {times} |' for name, law, times in beaten)]


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]], left: Container[int] = (0,)
            ) -> list[str]:
    """Return a table as lines of text of equal columns."""
    widths = [max(_width(row[i]) for row in (head, *rows)) for i in range(len(head))]
    return ['  '.join(_pad(item, width, place in left) for place, (item, width)
                      in enumerate(zip(row, widths, strict=True))).rstrip()
            for row in (list(head), *rows)]


def format_beaten(arena: Arena) -> str:
    """Return where another law is better, as a table for a terminal."""
    if REFERENCE not in arena.plan.entrants or len(arena.plan.entrants) < 2:
        return ''
    rows = beaten(arena)
    return '\n'.join([f'Where another law is better than {REFERENCE}:',
                      *(aligned(BEATEN, rows, (0, 1, 3, 6)) if rows else ['nowhere'])])


def format_text(arena: Arena) -> str:
    """Return the tables for a terminal."""
    blocks = []
    for name, summary, rows in tables(arena):
        lines = aligned(HEAD, rows)
        blocks.append('\n'.join([f'{name}: {summary}', *(f'  {line}' for line in lines)]))
    return '\n\n'.join(blocks)


def _width(text: str) -> int:
    return len(text.replace('\N{COMBINING TILDE}', ''))


def _pad(text: str, width: int, left: bool) -> str:
    blank = ' ' * (width - _width(text))
    return text + blank if left else blank + text


def conditions(arena: Arena) -> str:
    """Return the conditions of the runs, as text."""
    bounds, window = yardstick(), window_length(arena.plan.duration)
    noisy = any(sum('loop.seed' in member for member in item.members) > 1
                for item in arena.plan.scenarios.values())
    seeds = f', {counted(arena.plan.seeds, "seed")} of the noise' if noisy else ''
    return (f'{counted(arena.plan.runs, "run")} of {arena.plan.duration:g} s of the example at '
            f'200 Hz, {counted(len(arena.plan.entrants), "law")}, '
            f'{counted(len(arena.plan.scenarios), "scenario")}{seeds}; numbers over the last '
            f'{window:g} s, of the true state, but peak |v| over the whole run. Ω_ε is that of '
            f"the paper's law for all laws: |x̃| ≤ {bounds[0]:g}, |x̃'| ≤ {bounds[1]:g}. "
            'Means over seeds or pulses; TV is the total variation of v.')


def pictures(arena: Arena) -> list[Picture]:
    """Return the comparison's pictures.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    return [item for item in (overview(arena), scatter(arena), best_and_worst(arena))
            if item is not None]


def compose(arena: Arena, drawn: list[tuple[Picture, bytes]]) -> str:
    """Return the whole page as HTML."""
    laws = page.table(['law', 'what it is', 'keys'], [
        [item.name, item.summary, ', '.join(f'{key}: {value}'
                                            for key, value in item.changes.items())]
        for item in arena.plan.entrants.values()])
    return page.page('Comparison of laws', page.paragraph(conditions(arena), 'soft'), [
        ('Where another law is better', _beaten_html(arena)),
        ('Pictures', ''.join(page.image(picture, data) for picture, data in drawn)),
        ('Scenarios', ''.join(page.table(HEAD, rows, f'{name}: {summary}', range(1, len(HEAD)))
                              for name, summary, rows in tables(arena))),
        ('Laws', laws),
    ])


def _beaten_html(arena: Arena) -> str:
    """Return where another law is better, as HTML."""
    if REFERENCE not in arena.plan.entrants:
        return page.paragraph(f'{REFERENCE}, with which the others are compared, is not among '
                              'these laws.')
    if len(arena.plan.entrants) < 2:
        return page.paragraph('No other law takes part.')
    return page.table(BEATEN, beaten(arena), numbers=(2, 4, 5))


def write_arena(arena: Arena, out: Path) -> Path:
    """Write page, pictures and CSV into a directory; return the path of the page.

    Raises:
        ConfigurationError: The directory cannot be written.
        MissingDependencyError: matplotlib is not installed.
    """
    drawn = [(picture, picture.png()) for picture in pictures(arena)]
    write_files(out, {**{f'{picture.name}.png': data for picture, data in drawn},
                      TABLE: arena.csv().encode(), PAGE: compose(arena, drawn).encode()})
    return out / PAGE
