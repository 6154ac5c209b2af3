# SPDX-License-Identifier: Apache-2.0
"""Numbers of a run as text: the metrics one below the other, the five most important."""

from __future__ import annotations

from collections.abc import Sequence

from dz_ros.cli.output import aligned
from dz_ros.core.lateness import LATE_TEXT
from dz_ros.report.view import View

Row = tuple[str, str, str]
"""Label, number, unit."""

UNKNOWN = '-'


def metric_rows(view: View) -> list[Row]:
    """Return every metric that the run has a number for."""
    rows = []
    for name, about in view.metrics.described():
        value = view.metrics.shown(name)
        if value is not None:
            rows.append((about['label'], f'{value:.5g}', _unit(view, about['unit'])))
    return rows


def five_rows(view: View) -> list[Row]:
    """Return error, effort, punctuality, losses and latency; a dash where a run has none."""
    metrics, timing = view.metrics, view.timing
    state = timing.topics.get('state')
    within = state.within if state is not None and timing.judged else None
    missing = sum(topic.sequence.missing for topic in timing.topics.values())
    latency = timing.latencies.get('publish', timing.latencies.get('log'))
    judged = latency if timing.judged else None
    period = f' of {timing.period * 1e3:g} ms' if timing.period is not None else ''
    return [
        ('max |x̃|', _number(metrics.error_max), _unit(view, 'x')),
        ('total variation of v', _number(metrics.v_variation), _unit(view, 'v/s')),
        (f'periods within {LATE_TEXT}{period}', _number(within, 100.0), '%'),
        ('messages missing, all topics', str(missing), ''),
        ('state to command, p99', _number(judged.p99 if judged else None, 1e3), 'ms'),
    ]


def window_title(view: View) -> str:
    """Return what the metrics are about."""
    begin, end = view.metrics.window
    return (f'{view.setting.plant or "unknown plant"}, {view.setting.law or "unknown law"}, '
            f'{view.setting.mode or "unknown mode"}; window {begin:g} s to {end:g} s')


def format_table(title: str, rows: Sequence[Row]) -> list[str]:
    """Return the rows below a title, a line each, numbers right-aligned."""
    return [title, *aligned(rows, (0, 2), '  ')]


def _number(value: float | None, factor: float = 1.0) -> str:
    return UNKNOWN if value is None else f'{value * factor:.4g}'


def _unit(view: View, quantity: str) -> str:
    unit = view.setting.unit(quantity)
    return '' if unit == '1' else unit
