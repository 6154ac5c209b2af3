# SPDX-License-Identifier: Apache-2.0
"""Functions of the Python API."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
import os
from pathlib import Path
import tempfile
from typing import Any
import warnings

import numpy as np

from dz_ros.api.results import AxesComparison, Comparison, Findings, Run
from dz_ros.core.configuration import allow_named, Configuration, SECTIONS, SELECTORS
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.loop.finite import require_finite, simulate_finite
from dz_ros.core.loop.offline import simulate as simulate_plain
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import flat_parameters
from dz_ros.report.axes import compare_axes
from dz_ros.studies.code_folder import keep_compiled

LITTLE = 100_000
"""Samples of a whole sweep up to which starting processes for it does not pay."""
LONG = 100_000
"""Samples above which compiling a loop takes less time than it saves."""

Source = str | os.PathLike[str] | Mapping[str, Any] | Configuration | None


def load(source: Source = None, overrides: Mapping[str, Any] | None = None,
         **keys: Any) -> Configuration:
    """Return a checked configuration.

    Args:
        source: Name of a shipped configuration, a file, a mapping of keys (nested or dotted), a
            configuration; None = all defaults.
        overrides: Dotted key → value, put over `source`. A plant, a law or a trajectory may be a
            class of yours.
        **keys: The same, as in ``load('servo', **{'controller.lambda': 4})``.

    Raises:
        ConfigurationError: No such file, unknown key, value not allowed, or `source` is none of
            these.
    """
    if source is not None and not isinstance(source, (str, os.PathLike, Mapping, Configuration)):
        raise ConfigurationError('source', source, 'must be a name, a file, a mapping of keys or '
                                 'a configuration')
    values = _valued({**(overrides or {}), **keys})
    if isinstance(source, Configuration) and source.axes:   # a key of all axes changes all
        allow_named(values, True)
        found = source.replace(**values)
    else:
        flat = (source.to_flat() if isinstance(source, Configuration) else
                _flat(source) if isinstance(source, Mapping) else
                flat_parameters(None if source is None else Path(source)))
        found = Configuration.from_changed(_valued(flat), values)
    for note in found.misfit_notes:
        warnings.warn(note, stacklevel=2)
    return found


def simulate(source: Source = None, overrides: Mapping[str, Any] | None = None,
             compiled: bool | None = None, **keys: Any) -> Run:
    """Run the closed loop offline; of several axes all of them.

    Args:
        source: As of `load`.
        overrides: As of `load`.
        compiled: Whether numba compiles the loop, which takes seconds the first time and is kept
            for later processes; the numbers are the same. None = for runs of more than `LONG`
            samples, where numba is installed. Axes that plant or law couple are not compiled.
        **keys: As of `load`.

    Raises:
        ConfigurationError: As of `load`.
        DivergedError: The loop diverged; with the time and the axis.
    """
    configuration = load(source, overrides, **keys)
    if compiled is None:
        compiled = configuration.loop.samples > LONG
    if compiled:
        keep_compiled()
    one = simulate_fast if compiled else simulate_plain
    runs = simulate_axes(configuration, lambda item, memory: simulate_finite(item, memory, one))
    require_finite(runs)        # of coupled axes
    return Run(from_runs(runs, configuration))


def read(path: str | os.PathLike[str], namespace: str | None = None,
         axis: str | None = None) -> Run:
    """Read a recording: of dz_ros or of rosbag2, whole or cut off.

    Args:
        path: Directory of a run, .mcap or .db3 file.
        namespace: Whose topics to read where the recording holds several loops.
        axis: Name of the axis of a run of several; None = all of them.

    Raises:
        RecordingError: Nothing there, not a run of dz_ros, damaged, or without this axis.
    """
    from dz_ros.recording.reader import read_run
    from dz_ros.runs.axes import axis_run

    path = Path(path)
    data = read_run(path, namespace)
    return Run(data if axis is None else axis_run(data, axis), path.name)


def check(source: Source = None, overrides: Mapping[str, Any] | None = None,
          **keys: Any) -> Findings:
    """Return the findings of the design rules for a configuration; arguments as of `load`."""
    from dz_ros.core.design.rules import check as check_rules
    from dz_ros.core.design.stability import has_slope, lambda_limit

    configuration = load(source, overrides, **keys)
    limit = lambda_limit(configuration) if has_slope(configuration) else None
    return Findings(check_rules(configuration, None, limit))


def sweep(source: Source, over: Mapping[str, Sequence[Any]], *, samples: int = 0, seed: int = 0,
          jobs: int = 0) -> list[dict[str, Any]]:
    """Run a loop for values of some keys and return a row of numbers for each run.

    Args:
        source: As of `load`.
        over: Dotted key → its values; every combination is run. With `samples` each value lists
            the two ends of a range, sampled by a Sobol sequence.
        samples: Number of runs of a Sobol sequence; 0 = every combination.
        seed: Seed of the sequence.
        jobs: Processes; 0 = one for each core, and this one alone for up to `LITTLE` samples in
            all.

    Raises:
        ConfigurationError: Unknown key, values that are not allowed, or a loop of several axes.
    """
    from dz_ros.studies.sweep import read_sweep, run_sweep
    from dz_ros.studies.sweep_plan import Axis, SweepPlan

    axes = []
    for key, values in over.items():
        if isinstance(values, str) or not isinstance(values, (Sequence, np.ndarray)):
            raise ConfigurationError(key, values, 'must be a list of values')
        listed = tuple(values.tolist() if isinstance(values, np.ndarray) else values)
        if not listed:
            raise ConfigurationError(key, listed, 'must be at least one value')
        if samples and (len(listed) != 2 or not all(isinstance(item, Real) for item in listed)):
            raise ConfigurationError(key, listed, 'must be the two ends of a range with samples')
        axes.append(Axis(key, float(listed[0]), float(listed[1]), 2) if samples
                    else Axis(key, values=listed))
    configuration = load(source)
    configuration.require_one()
    plan = SweepPlan(configuration.to_flat(), tuple(axes), 'sobol' if samples else 'grid', samples,
                     seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'sweep.csv'
        little = len(plan) * configuration.loop.samples <= LITTLE
        run_sweep(plan, file, jobs or (1 if little else 0))
        return read_sweep(file)


def compare(*runs: Run | str | os.PathLike[str],
            names: Sequence[str] = ()) -> Comparison | AxesComparison:
    """Lay runs side by side; of several axes each axis by itself.

    Args:
        *runs: Two or more; of recordings the path is enough.
        names: Their names in table and figures; empty = file names, or 1, 2, ….

    Raises:
        ConfigurationError: Fewer than two runs, something else, or not a name for each.
        RecordingError: The runs have not the same axes, or a path is none of a recording.
    """
    for run in runs:
        if not isinstance(run, (Run, str, os.PathLike)):
            raise ConfigurationError('run', run, 'must be a run, as simulate and read return it, '
                                     'or the path of one')
    known = [run if isinstance(run, Run) else read(run) for run in runs]
    given = [*names] or [run.name or f'run {place}' for place, run in enumerate(known, 1)]
    if len(set(given)) != len(known):
        raise ConfigurationError('names', given, f'must be {len(known)} different names')
    found = {axis: Comparison(comparison) for axis, comparison in compare_axes(
        {name: run.data for name, run in zip(given, known, strict=True)}).items()}
    return found[''] if '' in found else AxesComparison(found)


def _flat(tree: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return a mapping with dotted keys."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            found.update(_flat(value, f'{prefix}{key}.'))
        else:
            found[f'{prefix}{key}'] = value
    return found


def _valued(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted keys with their values as configurations take them."""
    return {key: _value(key, value) for key, value in flat.items()}


def _value(key: str, value: Any) -> Any:
    """Return a value as configurations take it: classes by name, arrays as lists."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if key.startswith('axes.'):
        key = key.split('.', 2)[-1]
    section, _, name = key.partition('.')
    if isinstance(value, type) and SELECTORS.get(section) == name:
        registry = SECTIONS[section][1]
        assert registry is not None
        return registry.add(value)
    return value
