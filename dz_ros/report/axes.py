# SPDX-License-Identifier: Apache-2.0
"""The report of a run of several axes: a summary with a column for each, and a page for each.

OUT/report.html          verdict, numbers side by side, differences of the configurations
OUT/compare_….png        its pictures, one line for each axis
OUT/AXIS/report.html     the report of that axis, as of a run of it alone
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path

from dz_ros.core.dataset import RunData
from dz_ros.report import page
from dz_ros.report.compare import compare, overlaid, QUANTITIES
from dz_ros.report.report import PAGE, write_files, write_report
from dz_ros.report.verdict import judge


def write_axes_report(runs: Mapping[str, RunData], out: Path, *,
                      without_dead_zone: Mapping[str, RunData | None],
                      title: str = 'Run', window: tuple[float, float] | None = None,
                      pulse: float | None = None,
                      progress: Callable[[int, int, str], None] = lambda *_: None) -> Path:
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
    heads = list(runs)
    verdicts = {name: judge(view) for name, view in comparison.views.items()}
    failures = [f'axis {name}: {failure}' for name, verdict in verdicts.items()
                for failure in verdict.failures]
    lead = (''.join(f'<p class="fault">{page.text(failure)}</p>' for failure in failures)
            or page.paragraph(f'No failure in {len(heads)} axes.'))
    links = ''.join(f'<li><a href="{escape(name, quote=True)}/{PAGE}">{page.text(name)}</a></li>'
                    for name in heads)
    differing = comparison.differences()
    drawn = [(picture, picture.png()) for picture in overlaid(comparison)]
    content = page.page(title, lead + f'<p>Reports of the axes:</p><ul>{links}</ul>', [
        ('Numbers', page.table(['', *heads], comparison.rows(),
                               numbers=range(1, len(heads) + 1))),
        ('Pictures', ''.join(page.image(picture, data) for picture, data in drawn)),
        ('Verdicts', ''.join(page.folded(f'axis {name}', verdict.html())
                             for name, verdict in verdicts.items())),
        ('Configurations', page.table(['', *heads], differing,
                                      'keys in which the axes differ') if differing
         else page.paragraph('The axes have the same configuration.')),
    ])
    for done, (name, run) in enumerate(runs.items()):
        progress(done, len(runs), name)
        write_report(run, out / name, without_dead_zone=without_dead_zone[name],
                     title=f'{title}, axis {name}', window=window, pulse=pulse)
    files = {f'{picture.name}.png': data for picture, data in drawn}
    write_files(out, {**files, PAGE: content.encode()},
                [f'compare_{name}.png' for name, *_ in QUANTITIES
                 if f'compare_{name}.png' not in files])
    return out / PAGE
