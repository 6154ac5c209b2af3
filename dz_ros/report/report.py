# SPDX-License-Identifier: Apache-2.0
"""The report of a run: one self-contained HTML page and its pictures as PNG files.

A report is derived: it may be written again over an older one. Everything is computed before the
first file is touched, so an error leaves what was there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.report import page, plots, plots_law, plots_timing, sections
from dz_ros.report.style import Picture
from dz_ros.report.verdict import judge
from dz_ros.report.view import View

PAGE = 'report.html'
"""File name of the page."""

PICTURES = ('tracking', 'error', 'command', 'error_without', 'command_without', 'filtered_error',
            'estimates', 'parts', 'dead_zone', 'states', 'periods', 'latencies')
"""Every picture a report may have, in order, by file name without ending."""


def pictures(view: View, other: View | None = None,
             left_out: list[str] | None = None) -> list[Picture]:
    """Return the pictures of a run that it has data for, in order, by the figures of the paper.

    Args:
        view: The run.
        other: The run without dead-zone, for the paper's Figs. 5 and 6.
        left_out: Takes the names of pictures whose numbers no axes can hold, with the reason.
    """
    left_out = [] if left_out is None else left_out

    def figure(number: int) -> str:
        return f' (Fig. {number} of the paper)'

    makers: list[tuple[Callable[..., Picture | None], tuple[object, ...], str]] = [
        (plots.tracking, (view,), figure(2)), (plots.error, (view,), figure(3)),
        (plots.command, (view,), figure(4))]
    if other is not None:
        makers += [
            (plots.error, (other, 'error_without', view), f' without dead-zone{figure(5)}'),
            (plots.command, (other, 'command_without', view), f' without dead-zone{figure(6)}')]
    makers += [(maker, (view,), '') for maker in (
        plots.filtered, plots_law.estimates, plots_law.parts, plots_law.dead_zone, plots.states,
        plots_timing.periods, plots_timing.latencies)]
    found = []
    for maker, arguments, suffix in makers:
        try:
            picture = maker(*arguments)
        except (ValueError, OverflowError) as error:    # of matplotlib
            left_out.append(f'{maker.__name__}: {error}')
            continue
        if picture is not None:
            found.append(Picture(picture.name, picture.title + suffix, picture.caption,
                                 picture.alt, picture.figure))
    return found


def write_report(run: RunData, out: Path, *, without_dead_zone: RunData | None = None,
                 title: str = 'Run', window: tuple[float, float] | None = None,
                 pulse: float | None = None, tolerance: float | None = None,
                 progress: Callable[[int, int, str], None] = lambda *_: None
                 ) -> Path:
    """Write the report of a run, one page and its pictures; return the path of the page.

    An older report in the directory `out` is replaced; window, pulse, tolerance: `View.of`;
    `progress` is called with the number of pictures drawn, of all, and the next one.

    Raises:
        RecordingError: The run has no two states.
        ConfigurationError: A window or tolerance that is not one, or `out` cannot be written.
        MissingDependencyError: matplotlib is not installed.
    """
    if out.exists() and not out.is_dir():       # known before anything is drawn
        raise ConfigurationError('out', str(out), 'must be a directory that can be written: it is '
                                 'a file')
    view = View.of(run, window=window, pulse=pulse, tolerance=tolerance)
    other = None if without_dead_zone is None else looked_at_alike(without_dead_zone, view)
    drawn: list[tuple[Picture, bytes]] = []
    left_out: list[str] = []
    found = pictures(view, other, left_out)
    for done, picture in enumerate(found):
        progress(done, len(found), picture.title)
        try:
            drawn.append((picture, picture.png()))
        except RecordingError as error:
            left_out.append(str(error))
    progress(len(found), len(found), '')
    files = {f'{picture.name}.png': data for picture, data in drawn}
    files[PAGE] = compose(view, other, drawn, title, left_out).encode()
    stale = [f'{name}.png' for name in PICTURES if f'{name}.png' not in files]
    write_files(out, files, stale)
    return out / PAGE


def looked_at_alike(run: RunData, view: View) -> View:
    """Return another run, looked at over the same window where it has samples there."""
    found = View.of(run, tolerance=view.metrics.tolerance)
    begin, end = view.metrics.window
    if found.rows.t[0] > begin + 1e-9 or found.rows.t[-1] < end - 1e-9:
        return found
    return View.of(run, window=view.metrics.window, tolerance=view.metrics.tolerance)


def compose(view: View, other: View | None, drawn: Iterable[tuple[Picture, bytes]],
            title: str, left_out: Sequence[str] = ()) -> str:
    """Return the page of a run as HTML; `left_out` are pictures that could not be drawn."""
    timed = {'periods', 'latencies'}
    images = [(picture.name in timed, page.image(picture, data)) for picture, data in drawn]
    lead = (page.paragraph(sections.one_line(view), 'soft') + judge(view).html()
            + sections.notes(view, other))
    return page.page(title, lead, [
        ('Numbers', sections.numbers(view, other)),
        ('Pictures', ''.join(html for timing, html in images if not timing)
         + (page.bullets([f'Not drawn: {item}' for item in left_out]) if left_out else '')),
        ('Timing', sections.timing(view) + ''.join(html for timing, html in images if timing)),
        ('Gaps and losses', sections.data(view)),
        ('What is guaranteed', sections.promised(view)),
        ('Configuration', sections.configuration(view)),
        ('Provenance', sections.provenance(view)),
    ])


def write_files(out: Path, files: dict[str, bytes], stale: Iterable[str] = ()) -> None:
    """Write derived files into a directory, replacing older ones, and remove stale ones.

    Raises:
        ConfigurationError: The directory cannot be made or written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            part = out / f'{name}.part'
            part.write_bytes(data)
            part.replace(out / name)
        for name in stale:
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise ConfigurationError('out', str(out), 'must be a directory that can be written: '
                                 f'{error.strerror or error}') from error
