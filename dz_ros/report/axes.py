# SPDX-License-Identifier: Apache-2.0
"""Pages of runs of several axes: a summary with a column for each axis, and a page for each.

OUT/report.html          verdict, numbers side by side, differences of the configurations
OUT/compare_….png        its pictures, one line for each axis
OUT/AXIS/report.html     the report of that axis, as of a run of it alone

Of several runs with the same axes:

OUT/comparison.html          numbers of all runs, keys of the configurations that differ
OUT/AXIS/comparison.html     the comparison of that axis, with its pictures beside it
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from html import escape
from pathlib import Path

from dz_ros.core.axes import gathered, spoken
from dz_ros.core.dataset import RunData
from dz_ros.report import page, sections
from dz_ros.report.compare import compare, Comparison, overlaid, QUANTITIES, write_comparison
from dz_ros.report.compare import PAGE as COMPARISON_PAGE
from dz_ros.report.report import PAGE, PICTURES, write_files, write_report
from dz_ros.report.verdict import judge
from dz_ros.runs.axes import same_axes

NO_STEP: Callable[[int, int, str], None] = lambda *_: None  # noqa: E731
Table = tuple[str, list[str], list[list[str]]]
"""Heading, head and rows of a table of texts, the first column of which names the rows."""


def compare_axes(runs: Mapping[str, RunData], *, window: tuple[float, float] | None = None,
                 pulse: float | None = None) -> dict[str, Comparison]:
    """Return axis → comparison of at least two runs with the same axes; one axis is called ''.

    The arguments are those of `dz_ros.report.compare.compare`.

    Raises:
        ConfigurationError: As of `compare`.
        RecordingError: The runs have not the same axes, or one has no two states.
    """
    return {axis: compare(named, window=window, pulse=pulse)
            for axis, named in same_axes(runs).items()}


def failures(comparisons: Mapping[str, Comparison]) -> list[str]:
    """Return why runs failed, a line for each run, axis and reason; the arguments of `tables`."""
    return [f'{f"{name}, " if len(comparison.views) > 1 else ""}axis {axis}: {failure}'
            for axis, comparison in comparisons.items()
            for name, view in comparison.views.items() for failure in judge(view).failures]


def tables(comparisons: Mapping[str, Comparison]) -> list[Table]:
    """Return the tables of a summary: numbers, a column an axis, and keys that differ.

    Of several runs the numbers of each quantity are below each other, and the keys are those in
    which the runs differ; of one run those in which its axes differ.

    Args:
        comparisons: Axis → the same runs, one or more.
    """
    names = list(next(iter(comparisons.values())).views)
    views = [comparison.views[name] for comparison in comparisons.values() for name in names]
    rows = [['window', *('{:.4g} to {:.4g} s'.format(*view.metrics.window) for view in views)],
            *(row[:-1] for row in sections.metric_rows(views))]
    if len(names) == 1:
        alone = Comparison(dict(zip(comparisons, views, strict=True)))
        return [('Numbers', ['quantity', *comparisons], rows),
                ('What differs', ['key', *comparisons], alone.differences())]
    numbers = [[label, name, *cells[place::len(names)]] for label, *cells in rows
               for place, name in enumerate(names)]
    found: dict[tuple[str, ...], list[str]] = {}
    for axis, comparison in comparisons.items():
        for row in comparison.differences():
            found.setdefault(tuple(row), []).append(axis)
    differing = [[key, 'all' if len(axes) == len(comparisons) else ', '.join(axes), *texts]
                 for (key, *texts), axes in sorted(found.items())]
    return [('Numbers', ['quantity', 'run', *comparisons], numbers),
            ('What differs', ['key', 'axes', *names], differing)]


def write_comparisons(comparisons: Mapping[str, Comparison], out: Path, *, title: str,
                      progress: Callable[[int, int, str], None] = NO_STEP) -> Path:
    """Write the summary of runs of several axes and the comparison of each; return its path.

    Of one axis its comparison alone is written, there. Older ones in the directories are replaced.

    Args:
        comparisons: Axis → comparison, as of `compare_axes`.
        out: Directory of the summary.
        title: Of the summary.
        progress: As of `write_axes_report`.

    Raises:
        ConfigurationError: A directory cannot be written.
        MissingDependencyError: matplotlib is not installed.
    """
    for done, (axis, comparison) in enumerate(comparisons.items()):
        progress(done, len(comparisons), axis)
        path = write_comparison(comparison, out / axis if len(comparisons) > 1 else out,
                                title=f'axis {axis}: {title}' if axis else title)
    if len(comparisons) == 1:
        return path
    (_, head, numbers), (_, keys, differing) = tables(comparisons)
    lead = ''.join(page.paragraph(f'{name}, {spoken(axes)}: {text}', 'soft')
                   for name in next(iter(comparisons.values())).views
                   for text, axes in gathered(
                       (axis, sections.one_line(comparison.views[name]))
                       for axis, comparison in comparisons.items()).items())
    content = page.page(title, lead + _links('Comparisons', comparisons, COMPARISON_PAGE), [
        ('Numbers', page.table(head, numbers, numbers=range(2, len(head)))
         + page.paragraph('– where a run has no data for it.', 'soft')),
        ('What differs', page.table(keys, differing) if differing else
         page.paragraph('The configurations are the same.')),
    ])
    # What a comparison of one axis left there.
    write_files(out, {COMPARISON_PAGE: content.encode()},
                [f'compare_{name}.png' for name, *_ in QUANTITIES])
    return out / COMPARISON_PAGE


def _links(what: str, axes: Iterable[str], file: str) -> str:
    """Return the links to the pages of the axes."""
    links = ''.join(f'<li><a href="{escape(name, quote=True)}/{file}">{page.text(name)}</a></li>'
                    for name in axes)
    return f'<p>{what} of the axes:</p><ul>{links}</ul>'


def write_axes_report(runs: Mapping[str, RunData], out: Path, *,
                      without_dead_zone: Mapping[str, RunData | None],
                      title: str = 'Run', window: tuple[float, float] | None = None,
                      pulse: float | None = None,
                      progress: Callable[[int, int, str], None] = NO_STEP) -> Path:
    """Write the summary and the reports of all axes; return the path of the summary.

    Older reports in the directories are replaced.

    Args:
        runs: Axis → its run.
        out: Directory of the summary.
        without_dead_zone: Axis → the run without dead-zone; None = there is none.
        title: Of the summary.
        window: As of `View.of`.
        pulse: As of `View.of`.
        progress: Called with the number of axes done, of all, and the next one.

    Raises:
        RecordingError: An axis has no two states.
        ConfigurationError: A window that is none, or a directory that cannot be written.
        MissingDependencyError: matplotlib is not installed.
    """
    comparison = compare(runs, window=window, pulse=pulse)
    each = {name: Comparison({title: view}) for name, view in comparison.views.items()}
    (_, head, numbers), (_, keys, differing) = tables(each)
    lead = (''.join(f'<p class="fault">{page.text(failure)}</p>' for failure in failures(each))
            or page.paragraph(f'No failure in {len(each)} axes.'))
    drawn = [(picture, picture.png()) for picture in overlaid(comparison)]
    content = page.page(title, lead + _links('Reports', runs, PAGE), [
        ('Numbers', page.table(head, numbers, numbers=range(1, len(head)))),
        ('Pictures', ''.join(page.image(picture, data) for picture, data in drawn)),
        ('Verdicts', ''.join(page.folded(f'axis {name}', judge(view).html())
                             for name, view in comparison.views.items())),
        ('Configurations', page.table(keys, differing, 'keys in which the axes differ')
         if differing else page.paragraph('The axes have the same configuration.')),
    ])
    for done, (name, run) in enumerate(runs.items()):
        progress(done, len(runs), name)
        write_report(run, out / name, without_dead_zone=without_dead_zone[name],
                     title=f'{title}, axis {name}', window=window, pulse=pulse)
    files = {f'{picture.name}.png': data for picture, data in drawn}
    # What a report of one axis left there goes too.
    stale = [*(f'compare_{name}.png' for name, *_ in QUANTITIES),
             *(f'{name}.png' for name in PICTURES)]
    write_files(out, {**files, PAGE: content.encode()},
                [name for name in stale if name not in files])
    return out / PAGE
