"""The comparison as tables: for a terminal, as Markdown for the documents, as one HTML page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from dz_ros.analysis import page
from dz_ros.analysis.report import write_files
from dz_ros.analysis.style import Picture
from dz_ros.studies.arena import Arena, Cell
from dz_ros.studies.arena_pictures import best_and_worst, scatter
from dz_ros.studies.scenarios import yardstick

PAGE, TABLE = 'arena.html', 'arena.csv'
"""File names."""
HEAD = ('law', 'max |x̃|', 'RMS x̃', 'TV of v per s', 'v above 10 Hz', 'peak |v|', 'recovery s',
        'within Ω_ε', 'lost')
NAMES = ('error_max', 'error_rms', 'v_variation', 'v_highpass', 'v_peak_run')
REFERENCE = 'robust'
"""The entrant the others are held against."""
NEAR = 1.05
"""Numbers whose ratio is below this count as equal."""


def table_row(name: str, cell: Cell, kicked: bool) -> list[str]:
    """Return a cell as texts, in the order of `HEAD`."""
    return [name, *(number(cell.mean(item)) for item in NAMES),
            recovery(cell) if kicked else '',
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
        kicked = any('plant.kick' in member for member in scenario.members)
        yield name, scenario.summary, [table_row(entrant, column[entrant], kicked)
                                       for entrant in arena.ranking(name)]


def verdicts(arena: Arena) -> list[str]:
    """Return in plain words, a scenario each, where another law is better than the recommended."""
    if REFERENCE not in arena.plan.entrants or len(arena.plan.entrants) < 2:
        return []
    found = []
    for name in arena.plan.scenarios:
        column = arena.column(name)
        parts = [part for key, word in (
            ('error_max', 'max |x̃|'), ('v_variation', 'total variation'),
            ('v_highpass', 'v above 10 Hz'), ('v_peak_run', 'peak |v|'),
            ('recovery_time', 'recovery')) if (part := _better(column, key, word))]
        found.append(f'{name}: ' + ('; '.join(parts) if parts
                                    else f'no law is better than {REFERENCE} in any number'))
    return found


def _better(column: Mapping[str, Cell], key: str, word: str) -> str:
    """Return who has a smaller number than the reference, by more than `NEAR`; '' if nobody."""
    own = column[REFERENCE].mean(key)
    if own is None:
        return ''
    rivals = {name: value for name, cell in column.items() if name != REFERENCE and not cell.lost
              and (value := cell.mean(key)) is not None and value * NEAR < own}
    if not rivals:
        return ''
    listed = ', '.join(
        f'{name} {number(rivals[name])}' + (
            '' if key == 'error_max' else f' (error {number(column[name].mean("error_max"))})')
        for name in sorted(rivals, key=lambda item: rivals[item]))
    return f'{word} {number(own)} of {REFERENCE} is beaten by {listed}'


def format_text(arena: Arena) -> str:
    """Return the tables for a terminal."""
    blocks = []
    for name, summary, rows in tables(arena):
        widths = [max(_width(row[i]) for row in (HEAD, *rows)) for i in range(len(HEAD))]
        lines = ['  '.join(_pad(item, width, place == 0) for place, (item, width)
                           in enumerate(zip(row, widths, strict=True))).rstrip()
                 for row in (list(HEAD), *rows)]
        blocks.append('\n'.join([f'{name}: {summary}', *(f'  {line}' for line in lines)]))
    return '\n\n'.join(blocks)


def _width(text: str) -> int:
    return len(text.replace('\N{COMBINING TILDE}', ''))


def _pad(text: str, width: int, left: bool) -> str:
    blank = ' ' * (width - _width(text))
    return text + blank if left else blank + text


def conditions(arena: Arena) -> str:
    """Return one sentence: what was run and how to run it again."""
    bounds = yardstick()
    return (f'{arena.plan.runs} runs of {arena.plan.duration:g} s of the example at 200 Hz, '
            f'{len(arena.plan.entrants)} laws, {len(arena.plan.scenarios)} scenarios, '
            f'{arena.plan.seeds} seeds; numbers over the last 10 s, of the true state, but peak '
            "|v| over the whole run. Ω_ε is that of the paper's law for everybody: "
            f"|x̃| ≤ {bounds[0]:g}, |x̃'| ≤ {bounds[1]:g}. "
            'Means over seeds or kicks; TV is the total variation of v.')


def pictures(arena: Arena) -> list[Picture]:
    """Return the comparison's pictures.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    return [item for item in (scatter(arena), best_and_worst(arena)) if item is not None]


def compose(arena: Arena, drawn: list[tuple[Picture, bytes]]) -> str:
    """Return the whole page as HTML."""
    beaten = verdicts(arena)
    laws = page.table(['law', 'what it is', 'keys'], [
        [item.name, item.summary, ', '.join(f'{key}: {value}'
                                            for key, value in item.changes.items())]
        for item in arena.plan.entrants.values()])
    return page.page('Comparison of laws', page.paragraph(conditions(arena), 'soft'), [
        ('Where another law is better', page.bullets(beaten) if beaten else ''),
        ('Pictures', ''.join(page.image(picture, data) for picture, data in drawn)),
        ('Scenarios', ''.join(page.table(HEAD, rows, f'{name}: {summary}', range(1, len(HEAD)))
                              for name, summary, rows in tables(arena))),
        ('Laws', laws),
    ])


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
