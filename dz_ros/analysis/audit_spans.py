"""Which configuration held for which commands, and whether its law can be computed here.

The controller states its configuration when it starts and whenever its gains change: an event with
the seq of the first command it holds for and the law's memory before that command. Off line there
are no events: the run's own configuration holds from the first sample on.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import json
from typing import Any

import numpy as np

from dz_ros.analysis.audit_result import Span
from dz_ros.analysis.audit_samples import Samples
from dz_ros.analysis.setting import state_columns
from dz_ros.core.configuration import Configuration, SECTIONS
from dz_ros.core.dataset import RunData
from dz_ros.core.records import Terms
from dz_ros.errors import DzRosError


@dataclass(frozen=True)
class Part:
    """A span with what is needed to compute its law.

    Attributes:
        span: What is said of it.
        flat: Dotted key → value, as stated.
        configuration: The configuration; None where there is none or it cannot be used here.
        memory: The law's memory before the first command; None = not stated.
    """

    span: Span
    flat: Mapping[str, Any]
    configuration: Configuration | None
    memory: tuple[float, ...] | None


@dataclass(frozen=True)
class Statement:
    """A configuration event of a controller.

    Attributes:
        time: Log time [ns].
        seq: First command it holds for.
        node: Who states it.
        version: Version of dz_ros.
        memory: The law's memory before that command; None = not stated.
        flat: Dotted key → value.
    """

    time: int
    seq: int
    node: str
    version: str
    memory: tuple[float, ...] | None
    flat: Mapping[str, Any]


def events(run: RunData, name: str) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Yield (log time [ns], node, contents) of the events of this name."""
    for time, node, text in run.events:
        try:
            contents = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(contents, dict) and contents.get('event') == name:
            yield time, node, contents


def owners(run: RunData, section: str) -> list[tuple[int, str, dict[str, Any]]]:
    """Return the configuration events of the nodes whose values of a section are the loop's."""
    return [item for item in events(run, 'configuration')
            if isinstance(item[2].get('owns'), list) and section in item[2]['owns']
            and isinstance(item[2].get('configuration'), dict)]


def statements(run: RunData) -> list[Statement]:
    """Return what controllers stated of their configuration, in order of the log."""
    found = []
    for time, node, contents in owners(run, 'controller'):
        seq, memory = contents.get('seq', 0), contents.get('memory')
        if not isinstance(seq, int) or isinstance(seq, bool):
            seq = 0
        if not isinstance(memory, list) or not all(
                isinstance(item, (int, float)) for item in memory):
            memory = None
        found.append(Statement(time, seq, node, str(contents.get('version', '')),
                               None if memory is None else tuple(map(float, memory)),
                               contents['configuration']))
    return found


def parts(run: RunData, samples: Samples, given: Configuration | None,
          here: str) -> tuple[list[Part], list[str], list[str]]:
    """Return the spans of every start of the controller, and (findings, notes) about them.

    Args:
        run: The run.
        samples: Its steps.
        given: Configuration to use in place of what the run says; None = the run's.
        here: Version of dz_ros that recomputes.
    """
    stated = statements(run)
    own = known(run.configuration)
    count = len(samples.begin_ns)
    if given is not None:
        flat = given.to_flat()
        made = [_part(run, flat, given, Span(e, 0, given.law.name, '', 'given'), None)
                for e in range(count)]
        return made, [], _apart(own, flat, "the run's own configuration", 'the one given')
    found: list[Part] = []
    findings: list[str] = []
    for e in range(count):
        mine = [item for item in stated if _start_of(item, samples) == e]
        spans = {item.seq: item for item in sorted(mine, key=lambda item: item.seq)}
        first = int(samples.seq[np.searchsorted(samples.start, e)])
        if not any(seq <= first for seq in spans) and (own or not spans):
            span = Span(e, 0, str(own.get('controller.law', '')),
                        str(run.info.get('dz_ros', '')), "the run's configuration")
            found.append(_part(run, own, None, span, None))
        for seq, item in spans.items():
            span = Span(e, seq, str(item.flat.get('controller.law', '')), item.version,
                        f'stated by {item.node}')
            found.append(_part(run, known(item.flat), None, span, item.memory))
    if stated and own:
        findings += _contradictions(own, [known(item.flat) for item in stated])
    versions = sorted({part.span.version for part in found} - {'', here})
    notes = [f'recorded by dz_ros {version}, recomputed by {here}' for version in versions]
    return found, findings, notes


def known(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a configuration; recordings may carry others beside them."""
    return {key: value for key, value in flat.items() if key.partition('.')[0] in SECTIONS}


def _start_of(item: Statement, samples: Samples) -> int:
    """Return which start of the controller a statement belongs to."""
    if item.seq == 0:
        earlier = sum(end < item.time for end in samples.end_ns)
        return min(earlier, len(samples.end_ns) - 1)
    return max(sum(begin <= item.time for begin in samples.begin_ns) - 1, 0)


def _part(run: RunData, flat: Mapping[str, Any], configuration: Configuration | None,
          span: Span, memory: tuple[float, ...] | None) -> Part:
    """Return a part, its span saying why its law cannot be computed, if so."""
    problem = ''
    if not flat:
        problem = 'the log does not say which law and gains were used'
    elif configuration is None:
        try:
            configuration = Configuration.from_flat(flat, driven=False)
        except DzRosError as error:
            problem = f'its configuration cannot be used here: {error}'
    if configuration is not None:
        problem = _unfit(run, configuration)
        size = len(configuration.law.initial_memory())
        if not problem and memory is not None and len(memory) != size:
            problem = (f'the law {configuration.law.name} of this version keeps {size} numbers '
                       f'from sample to sample, the one recorded {len(memory)}')
    if problem:
        configuration = None
    said = Span(span.start, span.first, span.law, span.version, span.source, problem)
    return Part(said, flat, configuration, memory)


def _unfit(run: RunData, c: Configuration) -> str:
    """Return why the channels are not those of a configuration; '' where they are."""
    order = c.plant.order
    state, reference = run.channels.get('state'), run.channels.get('reference')
    if state is not None and len(state_columns(state.labels)) != order:
        return (f'plant.model = {c.plant.name} has {order} states, the log has '
                f'{len(state_columns(state.labels))}')
    if reference is not None and sum(label.startswith('xd') for label in reference.labels) \
            != order + 1:
        return (f'plant.model = {c.plant.name} needs {order + 1} numbers of a reference, the log '
                f'has {sum(label.startswith("xd") for label in reference.labels)}')
    terms = run.channels.get('terms')
    wanted = Terms.labels(c.law.signal_names)
    if terms is not None and terms.labels != wanted:
        odd = sorted(set(terms.labels) ^ set(wanted)) or ['another order']
        return (f'the law {c.law.name} of this version does not publish what was recorded: '
                f'{", ".join(odd)}')
    return ''


def _apart(one: Mapping[str, Any], other: Mapping[str, Any], name: str,
           other_name: str) -> list[str]:
    """Return a line for each key of the controller that two configurations give differently."""
    return [f'{key} is {one[key]!r} in {name}, {other[key]!r} in {other_name}'
            for key in sorted(one) if key.startswith('controller.') and key in other
            and other[key] != one[key]]


def _contradictions(own: Mapping[str, Any], stated: list[dict[str, Any]]) -> list[str]:
    """Return a line for each key of the controller that no statement gives as the run does."""
    found = []
    for key, value in sorted(own.items()):
        values = [flat[key] for flat in stated if key in flat]
        if key.startswith('controller.') and values and value not in values:
            found.append(f"{key} is {value!r} in the run's configuration, "
                         f'{values[0]!r} in what the controller stated')
    return found
