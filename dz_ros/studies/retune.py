# SPDX-License-Identifier: Apache-2.0
"""Every law with the gains that suit it best: tuned for each scenario, and once over all of them.

A law's free gains are those it declares (`Law.tunable`), with their ranges. They are found by
scipy's differential evolution, with the same number of runs and the same seeds for every law. What
is made small is max|x̃| over the last part of the runs; for all scenarios together the mean of its
logarithm. Limits are hard: a lost run, a peak |v| above that of the paper's law in the same
scenario or a total variation above `VARIATION` times its own is worse than any error, the more the
further beyond. The paper's law chatters under delay, which is no measure of effort: its variation
counts without the delay where that is smaller. A law with a place for the actuator's limit
(`v_max`, `v_clip`) is given the allowed peak.

Candidates are tried on runs shortened to `TRIAL` seconds with at most `MEMBERS` members of a
scenario; the best are run in full until one holds the limits, and so are those that a search began
with: the gains as shipped and, for a single scenario, the result over all of them of the same
seed. The better of these is the result, every number of it from a full run; a candidate that was
not run in full may be better still. Each (law, scenario, seed)
is one search; finished ones are kept in a file and not made again.

Over 300 lines: one search, from its limits to its resumed file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.linear_loop import largest_beta, spectral_radius
from dz_ros.core.design.observation import linear_observer
from dz_ros.core.design.stability import run_is_lost
from dz_ros.core.loop.compiled import simulate_fast
from dz_ros.core.schema import fields, to_dict
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.runs.metrics import choose_window, largest, variation
from dz_ros.studies.code_folder import keep_compiled
from dz_ros.studies.entrants import Entrant
from dz_ros.studies.pool import execute, Task
from dz_ros.studies.scenarios import base_configuration, Scenario, scenarios

ALL = 'all scenarios'
"""Name of the search over all scenarios."""
PAPER = {'controller.law': 'wang2004'}
"""The law whose effort is the limit."""
VARIATION = 1.5
"""Total variation of v allowed, over that of the paper's law, and at least `LEAST_VARIATION`."""
LEAST_VARIATION = 8.0
MARGIN = 0.97
"""Share of the allowed total variation that a candidate may use, so that the full run holds it."""
TRIAL = 20.0
"""Longest run of a candidate [s]."""
MEMBERS = 2
"""Members of a scenario that a candidate runs in, at most."""
TRIAL_SUBSTEPS = 1
"""RK4 steps in a sample of a candidate's run."""
CONFIRMED, FURTHER = 6, 1.3
"""Candidates run in full until one holds the limits: the best ones, then each this many times as
far down the list as the one before, since neighbours of one that fails fail as well."""
MOST_DELAY = 12
"""Largest loop delay that is looked at for the margins [samples]."""
BAD = 10.0
"""Scores from here on are beyond a limit, or lost."""

Limits = Mapping[str, tuple[float, float]]
"""Scenario → allowed peak |v| and total variation per second."""


@dataclass(frozen=True)
class Found:
    """The best gains of one search.

    Attributes:
        law, scenario, seed: What was searched.
        gains: Key → value.
        score: What was made small; above `BAD` a limit is exceeded.
        error: max|x̃|, mean over members; of all scenarios the geometric mean.
        peak, variation: Largest peak |v|, largest total variation per second.
        beta: Largest b m that the loop survives with a delay of 0 and of 1 sample; 0 = not known.
        delay: Largest delay it survives at b m = 1.25 [samples]; −1 = none, or not known.
        budget: Gains tried at most.
        errors: Scenario → max|x̃| of the full runs.
    """

    law: str
    scenario: str
    seed: int
    gains: Mapping[str, float]
    score: float
    error: float
    peak: float
    variation: float
    beta: tuple[float, float] = (0.0, 0.0)
    delay: int = -1
    budget: int = 0
    errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Conditions:
    """What candidates run in: scenarios, limits, how long, how finely.

    Attributes:
        scenarios: Name → scenario.
        limits: What they may use in each.
        duration: Length of the runs [s].
        substeps: RK4 steps in a sample; 0 = as configured.
        margin: Share of the allowed total variation.
    """

    scenarios: Mapping[str, Scenario]
    limits: Limits
    duration: float
    substeps: int = 0
    margin: float = 1.0

    @property
    def base(self) -> dict[str, Any]:
        """The flat configuration that scenarios and laws change."""
        return {**base_configuration(self.duration),
                **({'plant.substeps': self.substeps} if self.substeps else {})}

    @classmethod
    def full(cls, names: Sequence[str], duration: float, seeds: int) -> Conditions:
        """Return the conditions of the tables."""
        known = scenarios(duration, seeds)
        chosen = {name: known[name] for name in names}
        return cls(chosen, limits_of(chosen, duration), duration)

    @classmethod
    def trial(cls, names: Sequence[str], duration: float, seeds: int) -> Conditions:
        """Return the shorter ones of the candidates."""
        known = scenarios(min(duration, TRIAL), seeds)
        chosen = {name: replace(known[name], members=known[name].members[:MEMBERS])
                  for name in names}
        return cls(chosen, limits_of(chosen, min(duration, TRIAL)), min(duration, TRIAL),
                   TRIAL_SUBSTEPS, MARGIN)

    def only(self, names: Sequence[str]) -> Conditions:
        """Return the same for some scenarios."""
        return replace(self, scenarios={name: self.scenarios[name] for name in names})


def scaled(entrant: Entrant, place: Sequence[float]) -> dict[str, float]:
    """Return the gains at a place of the unit cube."""
    law = Configuration.from_flat(dict(entrant.changes)).law
    found = {}
    for item, share in zip(law.tunable, place, strict=True):
        value = (item.low * (item.high / item.low) ** share if item.logarithmic
                 else item.low + share * (item.high - item.low))
        found[f'controller.{item.key}'] = float(value)
    return found


def effort_of(base: Mapping[str, Any], changes: Mapping[str, Any]
              ) -> tuple[float, float, float] | None:
    """Return max|x̃| and total variation of the last part of a run, peak |v| of all; None = lost.

    The numbers of `dz_ros.studies.outcome`, without those that a search does not need.
    """
    try:
        run = simulate_fast(Configuration.from_changed(base, changes))
        if not (np.isfinite(run.x).all() and np.isfinite(run.v).all()) or run_is_lost(run):
            return None
    except (ArithmeticError, ValueError, DzRosError):
        return None
    shown = run.t >= choose_window(run.t)[0] - 1e-9
    error = largest((run.x - run.x_d[:, :-1])[shown, 0])
    change, peak = variation(run.t[shown], run.v[shown]), largest(run.v)
    if error is None or change is None or peak is None:
        return None
    return error, change, peak


def limits_of(chosen: Mapping[str, Scenario], duration: float) -> Limits:
    """Return scenario → allowed peak |v| and total variation, from the paper's law."""
    base = base_configuration(duration)
    found = {}
    for scenario in chosen.values():
        rows = [effort_of(base, {**PAPER, **member}) or effort_of(base, PAPER)
                for member in scenario.members]
        calm = [effort_of(base, {**PAPER, **member, 'loop.delay': 0}) or row
                if member.get('loop.delay') else row
                for member, row in zip(scenario.members, rows, strict=True)]
        if any(row is None for row in rows):
            raise ConfigurationError('--duration', duration,
                                     "is too short for a run of the paper's law to be measured")
        found[scenario.name] = (
            max(row[2] for row in rows if row), max(LEAST_VARIATION, VARIATION * max(
                min(row[1], other[1]) for row, other in zip(rows, calm, strict=True)
                if row and other)))
    return found


def score_of(rows: Sequence[tuple[float, float, float] | None], peak: float,
             variation_limit: float) -> tuple[float, float]:
    """Return what is to be made small for one scenario, and max|x̃|, the mean of its members."""
    held = [row for row in rows if row is not None]
    if len(held) < len(rows):
        return 3.0 * BAD, math.inf
    beyond = max(max(row[2] / peak, row[1] / variation_limit) for row in held) - 1.0
    error = float(np.mean([row[0] for row in held]))
    if beyond > 1e-6:
        return BAD + min(beyond, BAD), error
    return math.log(max(error, 1e-12)), error


def evaluate(entrant: Entrant, gains: Mapping[str, float], conditions: Conditions, name: str,
             seed: int) -> Found:
    """Return a law with these gains, run under the conditions; margins are left out."""
    scores, errors, peak, most = [], {}, 0.0, 0.0
    base, own = conditions.base, keys_of(entrant)
    for scenario in conditions.scenarios.values():
        allowed, limit = conditions.limits[scenario.name]
        rows = []
        for member in scenario.members:
            plate = min(allowed, member.get('plant.command_limit', allowed))
            changes = {**entrant.changes, **member, **gains, 'controller.v_max': plate,
                       'controller.v_clip': plate}
            rows.append(effort_of(base, of_the_law(own, changes)))
        score, errors[scenario.name] = score_of(rows, allowed, conditions.margin * limit)
        scores.append(score)
        peak = max([peak, *(row[2] if row else math.inf for row in rows)])
        most = max([most, *(row[1] if row else math.inf for row in rows)])
    bad = [item for item in scores if item >= BAD]
    total = max(bad) + len(bad) if bad else float(np.mean(scores))
    mean = math.exp(float(np.mean(np.log(list(errors.values())))))
    return Found(entrant.name, name, seed, gains, total, mean, peak, most, errors=errors)


def place_of(entrant: Entrant, gains: Mapping[str, float] | None = None) -> list[float]:
    """Return the place of gains in the unit cube, nearest where they are outside.

    Without gains: of those as shipped.
    """
    law = Configuration.from_flat(dict(entrant.changes)).law
    known = {f'controller.{item.key}': float(to_dict(law.gains)[item.key])
             for item in law.tunable} if gains is None else gains
    found = []
    for item in law.tunable:
        value = min(max(known[f'controller.{item.key}'], item.low), item.high)
        found.append(math.log(value / item.low) / math.log(item.high / item.low)
                     if item.logarithmic else (value - item.low) / (item.high - item.low))
    return found


def search(entrant: Entrant, name: str, trial: Conditions, full: Conditions, seed: int,
           budget: int, start: Mapping[str, float] | None = None) -> Found:
    """Return the best gains of a law for some scenarios.

    Args:
        entrant: The law and what is set of it.
        name: Name of the search.
        trial: Conditions of the candidates.
        full: Those of the result.
        seed: Of the search.
        budget: Gains tried at most.
        start: Gains to begin with besides those as shipped.
    """
    from scipy.optimize import differential_evolution
    from scipy.stats.qmc import LatinHypercube

    keep_compiled()
    base = base_configuration(full.duration)
    law = Configuration.from_flat({**base, **entrant.changes}).law
    count = len(law.tunable)
    tried: list[Found] = []

    def trial_score(place: Sequence[float]) -> float:
        tried.append(evaluate(entrant, scaled(entrant, place), trial, name, seed))
        return tried[-1].score

    # scipy wants five at least.
    size = max(5, min(2 * count + 2, budget // 4))
    first = LatinHypercube(count, rng=seed).random(size)
    for row, known in enumerate([None] if start is None else [None, start]):
        first[row] = place_of(entrant, known)
    differential_evolution(trial_score, [(0.0, 1.0)] * count, init=first, tol=0.0, rng=seed,
                           maxiter=max(0, budget // size - 1), polish=False)
    begun = [item.gains for item in tried[:1 if start is None else 2]]
    tried.sort(key=lambda item: item.score)
    best: Found | None = None
    for rank in ranks(len(tried)):
        found = evaluate(entrant, tried[rank].gains, full, name, seed)
        if best is None or found.score < best.score:
            best = found
        if best.score < BAD:
            break
    assert best is not None
    best = min([best, *(evaluate(entrant, gains, full, name, seed) for gains in begun
                        if gains != best.gains)], key=lambda item: item.score)
    beta, delay = margins(configured(entrant, best.gains, name, full))
    return replace(best, beta=beta, delay=delay, budget=budget)


def ranks(count: int) -> list[int]:
    """Return which of this many candidates are run in full, best first."""
    found = list(range(min(CONFIRMED, count)))
    while found and found[-1] < count - 1:
        found.append(min(math.ceil(FURTHER * found[-1]), count - 1))
    return found


def configured(entrant: Entrant, gains: Mapping[str, float], name: str,
               full: Conditions) -> Configuration:
    """Return the loop of a search's gains, in its scenario where that is one."""
    changes = full.scenarios[name].members[0] if name in full.scenarios else {}
    return Configuration.from_changed(full.base, of_the_law(
        keys_of(entrant), {**entrant.changes, **changes, **gains}))


def keys_of(entrant: Entrant) -> set[str]:
    """Return the keys of the controller that a law has."""
    law = Configuration.from_flat(dict(entrant.changes)).law
    return {'controller.law', *(f'controller.{item.name}' for item in fields(law.Gains))}


def of_the_law(own: set[str], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return changes without what a law lacks: looking for its owner takes longer than a run."""
    return {key: value for key, value in changes.items()
            if key in own or not key.startswith('controller.')}


def margins(c: Configuration) -> tuple[tuple[float, float], int]:
    """Return the largest b m with a delay of 0 and 1, and the largest delay at b m = 1.25.

    Where the velocity is observed, its observer is part of the loop.
    """
    try:
        model = c.law.layer_model()
    except (ConfigurationError, ArithmeticError):
        model = None
    if model is None:
        return (0.0, 0.0), -1
    period, observer = c.loop.period, linear_observer(c, c.make_driver().measured)
    delays = [d for d in range(MOST_DELAY + 1)
              if spectral_radius(model, period, 1.25, d, observer) < 1.0]
    return (largest_beta(model, period, 0, observer),
            largest_beta(model, period, 1, observer)), max(delays, default=-1)


def read(path: Path) -> dict[tuple[str, str, int], Found]:
    """Return the searches that a file holds; none where there is no file.

    Raises:
        ConfigurationError: It is not such a file.
    """
    if not path.exists():
        return {}
    found = {}
    try:
        for line in path.read_text(encoding='utf-8').splitlines():
            item = json.loads(line)
            item['beta'] = tuple(item['beta'])
            one = Found(**item)
            found[one.law, one.scenario, one.seed] = one
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigurationError('--out', str(path), f'is not a file of searches: {error}'
                                 ) from error
    return found


def retune(entrants: Mapping[str, Entrant], names: Sequence[str], path: Path,
           duration: float, seeds: int, searches: int, budget: int, jobs: int = 0,
           cluster: str | None = None,
           progress: Callable[[int, int, str], None] | None = None) -> list[Found]:
    """Search everything that the file does not hold yet; return everything.

    Args:
        entrants: Laws.
        names: Scenarios; each by itself, and all together.
        path: File that keeps a line of JSON for each finished search.
        duration: Length of each full run [s].
        seeds: Members of the scenario `noise` in full.
        searches: Searches of each law in each scenario, each of its own seed.
        budget: Gains tried in each search at most.
        jobs: Processes; 0 = one for each core.
        cluster: Address of a dask.distributed scheduler; None = this machine.
        progress: Called with searches done, all of them, the law.
    """
    known = read(path)
    other = {item.budget for item in known.values()} - {budget}
    if other:
        raise ConfigurationError('--budget', budget, f'{path} holds searches of a budget of '
                                 f'{min(other)}; give the same or another file')
    trial = Conditions.trial(names, duration, seeds)
    full = Conditions.full(names, duration, seeds)
    groups = {ALL: list(names), **{name: [name] for name in names}}
    wanted = [(law, name, seed) for seed in range(searches) for name in groups for law in entrants]
    done = sum(key in known for key in wanted)
    for seed in range(searches):
        # What is found over all scenarios is where the search in one of them begins.
        for round_ in ([ALL], list(names)):
            tasks: list[Task] = [
                (search, (entrant, name, trial.only(groups[name]), full.only(groups[name]), seed,
                          budget, None if name == ALL else known[entrant.name, ALL, seed].gains))
                for entrant in entrants.values() for name in round_
                if (entrant.name, name, seed) not in known]
            for _, found in execute(tasks, jobs, cluster):
                with path.open('a', encoding='utf-8') as file:
                    file.write(json.dumps(asdict(found)) + '\n')
                known[found.law, found.scenario, found.seed] = found
                done += 1
                if progress is not None:
                    progress(done, len(wanted), found.law)
    return [known[key] for key in wanted]
