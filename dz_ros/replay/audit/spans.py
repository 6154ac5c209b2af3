# SPDX-License-Identifier: Apache-2.0
"""Spans of a run in which one configuration held, and whether its law can be computed here.

The controller states its configuration when it starts and whenever its gains change: an event with
the seq of the first command it holds for and the law's memory before that command. Offline there
are no events: the run's own configuration holds from the first sample on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import RunData
from dz_ros.core.signals import declared, Role
from dz_ros.replay.audit.result import Span
from dz_ros.runs.history import known_keys, RunHistory, usable
from dz_ros.runs.setting import state_columns
from dz_ros.runs.steps import StepTable

RUNAWAY = 'safety.runaway_time'
"""Key of the runaway guard."""


@dataclass(frozen=True)
class Part:
    """A span with what is needed to compute its law.

    Attributes:
        span: Its description.
        flat: Dotted key → value, as stated.
        configuration: The configuration; None where there is none or it cannot be used here.
        memory: The law's memory before the first command; None = not stated.
    """

    span: Span
    flat: Mapping[str, Any]
    configuration: Configuration | None
    memory: tuple[float, ...] | None


def parts(run: RunData, steps: StepTable, given: Configuration | None,
          here: str) -> tuple[list[Part], list[str], list[str]]:
    """Return the spans of every start of the controller, and (findings, notes) about them.

    Args:
        run: The run.
        steps: Its steps.
        given: Configuration to use in place of the run's; None = the run's.
        here: Version of dz_ros that recomputes.
    """
    history = RunHistory.of(run)
    stated, own = history.statements('controller'), history.stored
    if given is not None:
        flat = given.to_flat()
        made = [_part(run, flat, given, Span(e, 0, given.law.name, '', 'given'), None)
                for e in range(len(steps.begin_ns))]
        return made, [], _apart(own, flat, "the run's own configuration", 'the one given')
    found: list[Part] = []
    findings: list[str] = []
    for e, spans in enumerate(history.held(steps.begin_ns, steps.end_ns)):
        first = int(steps.seq[np.searchsorted(steps.start, e)])
        if not any(seq <= first for seq in spans) and (own or not spans):
            span = Span(e, 0, str(own.get('controller.law', '')),
                        str(run.info.get('dz_ros', '')), "the run's configuration")
            found.append(_part(run, own, None, span, None))
        for seq, item in spans.items():
            span = Span(e, seq, str(item.configuration.get('controller.law', '')),
                        item.version, f'stated by {item.node}')
            found.append(_part(run, known_keys(item.configuration), None, span,
                               item.memory))
    if stated and own:
        findings += _contradictions(own, [known_keys(item.event.configuration)
                                          for item in stated])
    versions = sorted({part.span.version for part in found} - {'', here})
    notes = [f'recorded by dz_ros {version}, recomputed by {here}' for version in versions]
    return found, findings, notes


def _part(run: RunData, flat: Mapping[str, Any], configuration: Configuration | None,
          span: Span, memory: tuple[float, ...] | None) -> Part:
    """Return a part, its span with the reason why its law cannot be computed, if so."""
    problem = ''
    if not flat:
        problem = 'the log does not state which law and gains were used'
    elif configuration is None:
        if run.info.get('mode') == 'offline' or RUNAWAY not in flat:
            flat = {**flat, RUNAWAY: 0.0}       # offline, and in earlier versions, nothing guards
        configuration, problem = usable(flat)
        problem = problem and f'its configuration cannot be used here: {problem}'
    if configuration is not None:
        problem = _unfit(run, configuration)
        size = len(configuration.law.initial_memory())
        if not problem and memory is not None and len(memory) != size:
            problem = (f'the law {configuration.law.name} of this version keeps {size} numbers '
                       f'from sample to sample, the one recorded {len(memory)}')
    if problem:
        configuration = None
    described = Span(span.start, span.first, span.law, span.version, span.source, problem)
    return Part(described, flat, configuration, memory)


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
    if terms is not None:
        odd = [name for name in c.law.memory_signals if name not in terms.labels]
        odd += [item.name for item in declared(terms.labels) if item.name not in
                c.law.signal_names and item.role in (Role.ESTIMATE, Role.MEMORY)]
        if odd:
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
