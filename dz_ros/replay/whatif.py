# SPDX-License-Identifier: Apache-2.0
"""What-if: a recorded closed loop again, offline, with some keys of its configuration changed.

Initial plant state, initial estimates, reference, seed and length are those of the run; so with
nothing changed an offline or lockstep run comes out bit for bit. That needs a model of the plant:
the one that was simulated, one given by its parameters, or one fitted to the log (`fit`).

Of several axes `plan_axis` is about one alone and `plan_axes` about all of them together, which is
what a plant or a law that couples them needs.

Over 300 lines: a plan of one axis, one of all, and what both take from the log.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from dz_ros.core import schema
from dz_ros.core.axes import gathered, spoken
from dz_ros.core.axes_keys import (
    axis_key,
    axis_seed,
    check_axes,
    is_machines,
    parts,
    split_keys,
)
from dz_ros.core.configuration import allow_named, Configuration, PLANT_AXIS
from dz_ros.core.dataset import from_run, from_runs, RunData
from dz_ros.core.loop.coupled import knows_others
from dz_ros.core.loop.offline import Run
from dz_ros.core.plants import PLANTS
from dz_ros.errors import ConfigurationError, RecordingError, suggestion
from dz_ros.identification.estimation.least_squares import ZONE as ESTIMATED_ZONE
from dz_ros.identification.estimation.physical_parameters import parameters_with
from dz_ros.identification.estimation.pipeline import fit_log
from dz_ros.identification.estimation.prediction_error import Fit
from dz_ros.identification.proposal import zone_keys
from dz_ros.replay.recorded_trajectory import RecordedTrajectory
from dz_ros.runs.axes import axis_run, each_axis
from dz_ros.runs.history import known_keys, RunHistory
from dz_ros.runs.sequence import readable
from dz_ros.runs.setting import state_columns

PULSE = 'plant.disturbance_pulse'
SIMULATED = 'simulated'
ZONE = ('m_r', 'm_l', 'b_r', 'b_l')
"""Parameters of the dead-zone a plant model needs."""
FITS_ONE = ('fits one axis that neither plant nor law couple to others: choose it with --axis, or '
            'give the parameters')


@dataclass(frozen=True)
class Plan:
    """A what-if, ready to be simulated.

    Attributes:
        configuration: What to run.
        memory: The law's memory before the first sample; None = its initial one.
        notes: What a reader of the answer must know.
        fit: The plant's estimates, where it was fitted.
        as_recorded: Whether the reference is the recorded one, sample by sample.
    """

    configuration: Configuration
    memory: tuple[float, ...] | None
    notes: tuple[str, ...]
    fit: Fit | None = None
    as_recorded: bool = False

    @property
    def coupled(self) -> bool:
        """Whether the axis that it is of cannot be simulated without the others of its machine."""
        return knows_others(self.configuration)


@dataclass(frozen=True)
class MachinePlan:
    """A what-if of all axes of a machine, ready to be simulated.

    Attributes:
        configuration: What to run.
        each: Axis → its plan.
    """

    configuration: Configuration
    each: Mapping[str, Plan]

    @property
    def memories(self) -> tuple[tuple[float, ...] | None, ...]:
        """The laws' memories before the first sample; None = the initial one."""
        return tuple(item.memory for item in self.each.values())

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the answer must know; with the axis where it is not so of all."""
        found = gathered((name, text) for name, item in self.each.items() for text in item.notes)
        return tuple(text if len(names) == len(self.each) else f'{spoken(names)}: {text}'
                     for text, names in found.items())


def is_simulated(run: RunData) -> bool:
    """Return whether the plant of a run was a simulated one, whose parameters the run states."""
    truth = run.channels.get('truth')
    return ((truth is not None and len(truth) > 0) or run.info.get('mode') == 'offline'
            or bool(RunHistory.of(run).statements('plant')))


def base_configuration(run: RunData) -> dict[str, Any]:
    """Return the dotted keys a run began with: each node's own, the first time it stated them.

    A disturbance pulse names its own instant, so the only one of a run holds whenever it was set.
    """
    history = RunHistory.of(run)
    flat, pulses = history.began, _pulses(history)
    if len(pulses) == 1:
        flat[PULSE] = list(pulses[0])
    return flat


def _pulses(history: RunHistory) -> list[tuple[float, ...]]:
    """Return the different pulses that a run's plant was given, in order."""
    stated = [item.event.configuration.get(PULSE) for item in history.statements('plant')]
    return list(dict.fromkeys(tuple(pulse) for pulse in stated
                              if isinstance(pulse, list) and len(pulse) == 3 and pulse[1] != 0.0
                              and all(isinstance(item, (int, float)) for item in pulse)))


def _plant_changes(history: RunHistory) -> list[str]:
    """Return the keys of the simulated plant that changed while the run went on."""
    stated = [known_keys(item.event.configuration) for item in history.statements('plant')]
    return sorted({key for before, after in pairwise(stated) for key, value in after.items()
                   if key.startswith('plant.') and key != PULSE and before.get(key) != value})


def plan(run: RunData, overrides: Mapping[str, Any], *, given: Mapping[str, Any] | None = None,
         fit: bool = False, of_several: bool = False) -> Plan:
    """Return what to simulate.

    Args:
        run: The recorded run.
        overrides: Dotted key → value: what is changed.
        given: Dotted keys of what ran, for logs without it; overrules the log.
        fit: Estimate plant and dead-zone from the log.
        of_several: Whether the run is that of one axis of several, which may be coupled.

    Raises:
        ConfigurationError: No plant model, and which parameters it lacks; a value not allowed; a
            fit of an axis that is coupled to others.
        RecordingError: The log has no states, or no configuration.
    """
    simulated = is_simulated(run)
    flat = {**base_configuration(run), **(given or {})}
    state = run.channels.get('state')
    if state is None or not len(state):
        raise RecordingError('there are no states in the log')
    if not any(key.startswith('controller.') for key in flat):
        raise RecordingError('the log does not state which law and gains were used: give them by '
                             '--config FILE')
    if not simulated and not any(key.startswith('plant.') for key in given or {}):
        flat = _structure(RunHistory.of(run), flat, overrides, fit)
    if not any(key.startswith('loop.') for key in flat):
        flat['loop.rate'] = round(1.0 / float(np.median(np.diff(state['stamp']))), 6)
    allow_named(overrides)
    typed = {key: value for key, value in flat.items() if key in (given or {})
             or (key in overrides and overrides[key] == value)}
    # The simulated driver decides what is measured; a real one is not here.
    driven = {**flat, **typed}.get('driver.name', SIMULATED) == SIMULATED
    base = Configuration.from_untrusted(flat, typed, driven)
    notes: list[str] = []
    rows = np.flatnonzero(readable(state['seq']))
    if not len(rows):
        raise RecordingError('no state of the log has a seq that is a count')
    begin, end = float(state['stamp'][rows[0]]), float(np.nanmax(state['stamp'][rows]))
    if not simulated and 'plant.x0' not in overrides:
        x = state.values[rows[0]][state_columns(state.labels)]
        base = base.replace(**{'plant.x0': x.tolist()})
        notes.append('it starts from the first measured state')
    if not simulated or round(end * base.loop.rate) != base.loop.samples:
        origin = 0.0 if simulated else begin
        base = base.replace(**{'loop.duration': (end - origin) or base.loop.period})
    found = None
    if fit:
        if of_several and (knows_others(base) or knows_others(base.replace(**overrides))):
            raise ConfigurationError('--fit', True, FITS_ONE)
        found = fit_log(run, base)
        base = base.replace(**fitted_keys(found, base))
    chosen = base.replace(**overrides)
    chosen.require_one()
    notes += _notes(run, chosen, overrides)
    moved = any(key.startswith('trajectory.') for key in overrides)
    as_recorded = not moved and (not any(key.startswith('trajectory.') for key in flat)
                                 or (not simulated and begin > 0.5 * base.loop.period))
    if as_recorded:
        chosen = replace(chosen, trajectory=RecordedTrajectory.of(
            run, chosen, 0.0 if simulated else begin))
        notes.append('the reference is the recorded one, sample by sample')
    return Plan(chosen, _memory(run, base, chosen), tuple(notes), found, as_recorded)


def plan_axis(run: RunData, axis: str, overrides: Mapping[str, Any], *,
              given: Mapping[str, Any] | None = None, fit: bool = False) -> Plan:
    """Return what to simulate of one axis; where it is `coupled`, `plan_axes` is what is asked.

    Args:
        run: The recorded run.
        axis: Name of the axis.
        overrides: Dotted key → value: what is changed, as of `of_axis`.
        given: Dotted keys of what ran, for logs without it; overrules the log.
        fit: Estimate plant and dead-zone from the log.

    Raises:
        ConfigurationError: As of `plan` and `of_axis`.
        RecordingError: As of `plan`; there is no such axis.
    """
    data = axis_run(run, axis)
    return plan(data, _of_place(of_axis(overrides, axis), axis, run.axes), given=given, fit=fit,
                of_several=bool(run.axes))


def plan_axes(run: RunData, overrides: Mapping[str, Any], *,
              given: Mapping[str, Mapping[str, Any]] | None = None) -> MachinePlan:
    """Return what to simulate of a run of several axes, all of them together.

    Args:
        run: The recorded run.
        overrides: Dotted key → value: what is changed; without an axis, of each of them.
        given: Axis → dotted keys of what ran, for logs without it; overrules the log.

    Raises:
        ConfigurationError: As of `plan`; a key of no axis, axes that no longer go together.
        RecordingError: As of `plan`.
    """
    check_axes(split_keys(overrides)[1], run.axes)
    each = {}
    for name, data in each_axis(run).items():
        mine = _of_place(overrides, name, run.axes)
        try:
            each[name] = plan(data, mine, given=(given or {}).get(name))
        except (ConfigurationError, RecordingError) as error:
            error.args = (f'axis {name}: {error}',)
            raise
    machine = Configuration.of_axes({name: item.configuration for name, item in each.items()})
    return MachinePlan(machine, each)


def of_axis(overrides: Mapping[str, Any], axis: str) -> dict[str, Any]:
    """Return keys as changes of one axis of a machine; those of the machine stay as they are.

    A key that names the axis overrules the same one without a name.

    Raises:
        ConfigurationError: A key of another axis.
    """
    common, own = split_keys(overrides)
    for name, keys in own.items():
        if name != axis:
            key, value = next(iter(keys.items()))
            raise ConfigurationError(axis_key(name, key), value, 'is of another axis than '
                                     f'{axis}{suggestion(name, (axis,))}')
    return {key if is_machines(key) else axis_key(axis, key): value
            for key, value in {**common, **own.get(axis, {})}.items()}


def _of_place(overrides: Mapping[str, Any], axis: str, axes: Sequence[str]) -> dict[str, Any]:
    """Return what changes one axis of a machine, as keys of a loop of this axis alone.

    Raises:
        ConfigurationError: A change of the axes themselves.
    """
    common, own = split_keys(overrides)
    if 'loop.axes' in common:
        raise ConfigurationError('loop.axes', common['loop.axes'], 'the axes are those of the run')
    mine = {**common, **own.get(axis, {})}
    if 'loop.seed' in mine and axis in axes:
        mine['loop.seed'] = axis_seed(mine['loop.seed'], axes.index(axis))
    return mine


def fitted_keys(fit: Fit, c: Configuration) -> dict[str, Any]:
    """Return the configuration keys of a fitted plant: its parameters and the dead-zone's.

    Raises:
        ConfigurationError: No allowed parameters of the model give the estimates.
    """
    return {**parameters_with(c.plant, fit.a),
            **zone_keys([fit[name].value for name in ESTIMATED_ZONE], c.plant.b)}


def answer(plan: Plan, run: Run, name: str, start_ns: int) -> RunData:
    """Return a simulated what-if as a run to be recorded.

    Args:
        plan: What was simulated.
        run: The result.
        name: Name of the recorded run.
        start_ns: Log time of its first sample [ns since the epoch].
    """
    return _answered(from_run(run, start_ns), {'': plan.as_recorded}, name)


def answer_axes(plan: MachinePlan, runs: Mapping[str, Run], name: str, start_ns: int) -> RunData:
    """Return a simulated what-if of all axes as one run to be recorded.

    Args:
        plan: What was simulated.
        runs: The results by axis.
        name: Name of the recorded run.
        start_ns: Log time of its first sample [ns since the epoch].
    """
    return _answered(from_runs(runs, plan.configuration, start_ns),
                     {axis: item.as_recorded for axis, item in plan.each.items()}, name)


def _answered(data: RunData, as_recorded: Mapping[str, bool], name: str) -> RunData:
    """Return the run of an answer, without the trajectories that its configuration does not hold.

    Where one axis has none, the keys of all axes go too: they repeat those of the first axis, and
    an axis without keys of its own would take them for its trajectory.
    """
    without = {axis for axis, found in as_recorded.items() if found}
    if without:
        without.add('')
    flat = {key: value for key, value in data.configuration.items()
            if not (parts(key)[0] in without and parts(key)[1].startswith('trajectory.'))}
    return replace(data, configuration=flat, info={**data.info, 'what_if_of': name})


def _structure(history: RunHistory, flat: dict[str, Any], overrides: Mapping[str, Any],
               fit: bool) -> dict[str, Any]:
    """Return the keys with the plant's structure that the controller used."""
    stated = history.statements('controller')
    used = known_keys(stated[0].event.configuration) if stated else {}
    flat = {**{key: value for key, value in used.items()
               if key.startswith(('plant.', 'loop.'))}, **flat}
    flat = {key: value for key, value in flat.items()
            if not key.startswith(('plant.x0', 'plant.dead_zone.', 'plant.noise'))}
    model = overrides.get('plant.model', flat.get('plant.model'))
    what = 'this log is not of a simulated plant, so a model of the plant is needed'
    if model is None:
        raise ConfigurationError('plant.model', '', f'{what}: choose one by --set plant.model=…, '
                                 f'known: {", ".join(PLANTS.builtin)}')
    if 'plant.model' not in overrides:
        PLANTS.check_untrusted(model)
    flat['plant.model'] = model
    needed = [f'plant.{item.name}' for item in schema.fields(PLANTS.load(model).Parameters)]
    needed += [f'plant.dead_zone.{name}' for name in ZONE]
    lacking = [key for key in needed if key not in overrides and key != PLANT_AXIS]
    if lacking and not fit:
        raise ConfigurationError('plant.model', model, f'{what}; it lacks {", ".join(lacking)}: '
                                 'give them by --set KEY=VALUE, or --fit estimates them')
    own = {key: value for key, value in overrides.items() if key in needed}
    names = {key.partition('.')[2] for key in needed}
    return {**{key: value for key, value in flat.items() if not key.startswith('plant.')
               or key.partition('.')[2] in names or key in ('plant.model', 'plant.substeps')},
            **own}


def _memory(run: RunData, base: Configuration,
            chosen: Configuration) -> tuple[float, ...] | None:
    """Return the memory the recorded law began with, if it is the chosen law's as well."""
    if (type(chosen.law) is not type(base.law)
            or chosen.law.initial_memory() != base.law.initial_memory()):
        return None
    memory = next((item.event.memory for item in RunHistory.of(run).statements('controller')
                   if item.event.seq == 0), None)
    terms = run.channels.get('terms')
    if memory is None and terms is not None and len(terms) and not is_simulated(run):
        signals = terms.table(base.law.signal_names)[0]
        memory = tuple(map(float, base.law.memory_from_signals(signals.tolist())))
    if memory is not None and len(memory) != len(base.law.initial_memory()):
        return None
    return memory


def _notes(run: RunData, chosen: Configuration, overrides: Mapping[str, Any]) -> list[str]:
    """Return what the answer leaves out."""
    notes, history = [], RunHistory.of(run)
    changes = [item.event.seq for item in history.statements('controller') if item.event.seq > 0]
    if changes:
        notes.append('the gain changes of the recorded run are not repeated: seq '
                     + ', '.join(map(str, changes)))
    moved = _plant_changes(history)
    if moved:
        notes.append('the changes of the plant in the recorded run are not repeated: '
                     + ', '.join(moved))
    pulses = len(_pulses(history))
    if pulses > 1:
        notes.append(f'of {pulses} pulses in the recorded run none that was given while it went '
                     'on is repeated')
    trip = run.channels['state']['round_trip']
    trip = trip[trip > 0.0]
    if len(trip):
        notes.append(f'in the recorded run a command acted {float(np.median(trip)) * 1e3:.2g} ms '
                     'after its state (median); here it acts at once, and loop.delay = '
                     f'{chosen.loop.delay} whole sample(s) later')
    notes += [f'{key} is set aside: {chosen.plant.name}, {chosen.law.name} and '
              f'{chosen.trajectory_settings.kind} do not use it'
              for key in chosen.set_aside if key in overrides]
    return notes + chosen.misfit_notes
