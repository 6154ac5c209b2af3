# SPDX-License-Identifier: Apache-2.0
"""The sections of a report: numbers, timing, data, guarantee, provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dz_ros.core.lateness import LATE_TEXT
from dz_ros.core.units import Units
from dz_ros.report import page
from dz_ros.report.event_text import event_text
from dz_ros.report.guarantee import guarantee
from dz_ros.report.plots import number
from dz_ros.report.plots_timing import backwards, milliseconds, shown_latencies
from dz_ros.report.view import View
from dz_ros.runs.metrics import Metrics
from dz_ros.runs.timing import Spread

MODES = {
    'offline': 'computed offline, no messages and no clock',
    'realtime': 'made in real time over topics',
    'lockstep': 'made in lockstep over topics: a step happens when its messages have arrived',
}
MOST_EVENTS = 200
OLDEST_LISTED = 5
"""Age of a command up to which each is listed [samples]."""


def mode_text(view: View) -> str:
    """Return how a run was made, as text."""
    mode = view.setting.mode
    return MODES.get(mode, f'made in mode {mode}' if mode else 'unknown how it was made')


def one_line(view: View) -> str:
    """Return what was run, in a sentence."""
    setting = view.setting
    rate = '' if not setting.period else f' at {1.0 / setting.period:g} Hz'
    return (f'Plant {setting.plant or "unknown"} (order {setting.order}), law '
            f'{setting.law or "unknown"}, trajectory {setting.trajectory or "unknown"}; '
            f'{view.rows.duration:.4g} s{rate}; {mode_text(view)}.')


def notes(view: View, other: View | None) -> str:
    """Return what a reader must know before the numbers."""
    found = []
    if other is not None:
        made = 'was simulated offline with the same configuration' if (
            other.setting.mode == 'offline') else f'is another one, {mode_text(other)}'
        found.append(f'The run without dead-zone {made}.')
    if view.timing.note:
        found.append(f'No timing is judged: this run was {view.timing.note}.')
    noise = view.setting.configuration.noise if view.setting.configuration else ()
    if any(noise):
        found.append('x̃ is that of the measured state: measurement noise is part of it.')
    if 'terms' not in view.run.channels:
        found.append('The run has no terms of the law: s is computed from the measured state '
                     'where λ is known, estimates and parts of v are missing.')
    if not view.setting.simulated:
        found.append('There is no truth in this run: the true dead-zone and parameters are '
                     'unknown.')
    if view.rows.restarts:
        found.append(f'The plant restarted {view.rows.restarts} time(s); the longest stretch '
                     'is shown.')
    return ''.join(page.paragraph(item, 'note') for item in found)


def metric_cell(view: View, name: str, metadata: Mapping[str, str]) -> str:
    """Return one metric of one run with its unit."""
    value = view.metrics.shown(name)
    if value is None:
        never = name == 'settling_time' or (name == 'recovery_time' and view.disturbed)
        return 'never' if never else '–'
    unit = view.setting.unit(metadata['unit'])
    return number(value, unit)


def metric_rows(views: Sequence[View]) -> list[list[str]]:
    """Return label, one cell a run, sentence for every metric any run has."""
    return [[metadata['label'], *(metric_cell(view, name, metadata) for view in views),
             metadata['sentence']]
            for name, metadata in Metrics.described()
            if name == 'settling_time'
            or any(getattr(view.metrics, name) is not None for view in views)
            or (name == 'recovery_time' and any(view.disturbed for view in views))]


def numbers(view: View, other: View | None) -> str:
    """Return the table of metrics."""
    views = [view] if other is None else [view, other]
    head = ['quantity', 'this run'] if other is None else [
        'quantity', 'with dead-zone', 'without dead-zone']
    begin, end = view.metrics.window
    caption = (f'Window {begin:.4g} to {end:.4g} s, {view.metrics.samples} samples; settled means '
               f'|x̃| < {number(view.metrics.tolerance, view.setting.unit("x"))}.')
    if other is not None and other.metrics.window != view.metrics.window:
        caption += ' Without dead-zone: {:.4g} to {:.4g} s.'.format(*other.metrics.window)
    return page.table([*head, 'what it is'], metric_rows(views), caption,
                      range(1, 1 + len(views)))


def _spread(spread: Spread | None) -> list[str]:
    """Return p50, p99, p99.9, max in ms."""
    if spread is None:
        return ['–'] * 4
    return [f'{1e3 * value:.3f}' for value in
            (spread.p50, spread.p99, spread.p999, spread.maximum)]


def timing(view: View) -> str:
    """Return the tables of periods and latencies."""
    t = view.timing
    rows = []
    for name, topic in t.topics.items():
        shown = topic.deviation or topic.period
        counts = [topic.within, topic.late, topic.too_late]
        rows.append([name, topic.clock, *_spread(shown),
                     *('–' if value is None else
                       f'{100.0 * value:.4g} %' if place == 0 else str(value)
                       for place, value in enumerate(counts))])
    if not any(topic.period for topic in t.topics.values()):
        return ''
    judged = any(topic.deviation for topic in t.topics.values())
    what = '|period − T| [ms]' if judged else 'period [ms]'
    parts = [page.table(
        ['topic', 'clock', 'p50', 'p99', 'p99.9', 'max', f'within {LATE_TEXT}', 'late',
         'too late'], rows,
        f'{what}, T = {milliseconds(t.period)}; late: more than {LATE_TEXT} too long, too late: '
        'more than one whole period too long.', range(2, 9))]
    latencies = shown_latencies(t)
    found = [[title, str(spread.count), *_spread(spread),
              *('–' if count is None else str(count) for count in t.late(key))]
             for key, title, spread in latencies]
    if found:
        parts.append(page.table(
            ['latency', 'answers', 'p50', 'p99', 'p99.9', 'max', 'late', 'too late'], found,
            f'How long a state waited for its command [ms]; late: more than {LATE_TEXT}, too '
            f'late: more than T.{backwards(latencies)}', range(1, 8)))
    if t.samples_late:
        parts.append(page.paragraph(f'Age of the newest command when a state was measured: '
                                    f'{ages(t.samples_late)}.'))
    if t.speed is not None:
        parts.append(page.paragraph(f'Loop time over wall time: {t.speed:.4g}.'))
    return ''.join(parts)


def ages(late: Mapping[int, int]) -> str:
    """Return as text how old the newest command was, from its number of samples late → cases."""
    found = [f'{1 + samples} sample{"s" if samples else ""} in {cases} case'
             f'{"" if cases == 1 else "s"}' for samples, cases in late.items()
             if samples < OLDEST_LISTED]
    older = [cases for samples, cases in late.items() if samples >= OLDEST_LISTED]
    if older:
        found.append(f'more than {OLDEST_LISTED} samples in {sum(older)}, at most '
                     f'{1 + max(late)}')
    return ', '.join(found)


def data(view: View) -> str:
    """Return what the channels hold and what they lack."""
    rows = [[name, str(count.messages),
             '–' if count.first is None else f'{count.first} … {count.last}', str(count.missing),
             str(count.repeated), str(count.reordered), str(count.unreadable),
             str(view.rows.missing.get(name, '–'))] for name, count in view.rows.counts.items()]
    parts = [page.table(['channel', 'messages', 'seq', 'missing', 'repeated', 'reordered',
                         'unreadable', 'states without'], rows,
                        'Missing: a seq that no message carries; never published, or lost.',
                        range(1, 8))]
    for count, what in ((view.rows.carried, "reference(s) brought to a state's stamp by their "
                         'own derivatives.'),
                        (view.rows.not_finite, 'state(s) with a number that is not finite.')):
        if count:
            parts.append(page.paragraph(f'{count} {what}'))
    if view.frozen:
        parts.append(page.paragraph('Adaptation was frozen: ' + ', '.join(
            f'{name.replace("_", " ")} in {count} sample(s)'
            for name, count in view.frozen.items()) + '.'))
    return ''.join(parts)


def promised(view: View) -> str:
    """Return what the theorem promises of the run and what it does not."""
    found = guarantee(view)
    parts = [page.paragraph(found.statement)]
    if found.covered:
        parts.append(page.paragraph(f'Robust gain: {found.covered}'))
    if found.bounds is not None:
        worst = view.metrics.state_error_max
        parts.append(page.table(
            ['error', 'bound of Ω_ε', 'largest in the window'],
            [[f'x̃_{i + 1}', number(bound, view.setting.unit(f'x^({i})')),
              number(worst[i], view.setting.unit(f'x^({i})'))]
             for i, bound in enumerate(found.bounds)],
            '|x̃_i| ≤ 2^(i−1) λ^(i−n) ε', (1, 2)))
    for heading, items in (('Assumptions that do not hold', found.broken),
                           ('Not covered by the theorem, and present here', found.beyond)):
        if items:
            parts.append(page.paragraph(f'{heading}:'))
            parts.append(page.bullets(items))
    return ''.join(parts)


def configuration(view: View) -> str:
    """Return the table of every key as run."""
    flat = view.setting.flat
    if not flat:
        return page.paragraph('The run carries no configuration.')
    c = view.setting.configuration
    units = Units.of(c.plant) if c else None
    known = {key: (units.resolve_words(item.unit), item.spec.description)
             for key, item in c.declared().items()} if c and units else {}
    rows = [[key, str(value), *known.get(key, ('', ''))] for key, value in sorted(flat.items())]
    return page.folded(f'{len(rows)} keys', page.table(['key', 'value', 'unit', 'meaning'], rows))


def provenance(view: View) -> str:
    """Return what made the run, and what happened while it was made."""
    parts = []
    if view.run.info:
        parts.append(page.table(['what', 'value'], [[key, str(value)] for key, value in
                                                    sorted(view.run.info.items())]))
    if view.run.events:
        start = view.run.events[0][0]
        shown = view.run.events[:MOST_EVENTS]
        parts.append(page.table(
            ['time [s]', 'node', 'event'],
            [[f'{(at - start) * 1e-9:.3f}', node, event_text(what)] for at, node, what in shown],
            f'Events, {len(shown)} of {len(view.run.events)}; time since the first.', (0,)))
    return ''.join(parts)
