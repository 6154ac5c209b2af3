# SPDX-License-Identifier: Apache-2.0
"""Many tasks on all cores of this machine, or on the workers of a dask.distributed scheduler.

A task is a picklable call; results come as they are ready, each with its place. Numbers do not
hang on how tasks are spread: a task carries everything it needs, seeds included.

- one job: in this process
- several: processes, each started fresh (spawn), so that nothing is inherited but the package;
  interrupts do not reach them: they are killed where their results are not awaited any more
- a cluster: any dask.distributed scheduler whose workers have dz_ros. What a worker was doing when
  it died is given to another one; what it had done and not yet handed over is done again.

However many tasks there are, only `AHEAD` for each worker are taken from the iterable, begun and
not yet handed on; a result is forgotten when it is handed on. So memory does not grow with their
number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import chain, islice
import multiprocessing
import os
import signal
from typing import Any

from dz_ros.errors import ConfigurationError, LoopError, MissingDependencyError

Task = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function and its arguments."""

SCHEDULER_TIMEOUT = 30
"""Longest wait for a scheduler to answer [s]."""
AHEAD = 3
"""Tasks in flight for each worker: one at work, two so that it never waits for the next."""


def cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def execute(tasks: Iterable[Task], jobs: int = 0,
            cluster: str | None = None) -> Iterator[tuple[int, Any]]:
    """Yield (place of a task, its result) as results become ready, each once.

    Args:
        tasks: What to do, taken as it is needed; those at the front are begun first.
        jobs: Processes; 0 = one for each core.
        cluster: Address of a dask.distributed scheduler, e.g. ``tcp://host:8786``; None = here.

    Raises:
        ConfigurationError: Fewer than no jobs, or an address at which no scheduler answers.
        MissingDependencyError: dask.distributed is not installed.
        LoopError: A worker process was killed (by the system, for its memory, most likely).
    """
    if jobs < 0:
        raise ConfigurationError('jobs', jobs, 'must be 0 (all cores) or more')
    coming = iter(tasks)
    if cluster is not None:
        yield from _on_cluster(enumerate(coming), cluster)
        return
    first = list(islice(coming, jobs or cores()))
    waiting = enumerate(chain(first, coming))
    if len(first) <= 1:
        for place, (function, arguments) in waiting:
            yield place, function(*arguments)
        return
    others = set(multiprocessing.active_children())
    done = False
    with ProcessPoolExecutor(len(first), multiprocessing.get_context('spawn')) as pool:
        flying: dict[Future[Any], int] = {}
        try:
            while True:
                with _without_interrupts():     # a worker keeps the mask it was started with
                    for place, (function, arguments) in islice(waiting,
                                                               AHEAD * len(first) - len(flying)):
                        flying[pool.submit(function, *arguments)] = place
                if not flying:
                    done = True
                    return
                ready = wait(flying, return_when=FIRST_COMPLETED).done
                while ready:
                    future = ready.pop()
                    yield flying.pop(future), future.result()
        except BrokenProcessPool as error:
            raise LoopError(
                'a worker process has ended: killed (fewer jobs need less memory), or it ran the '
                "script again, which needs if __name__ == '__main__' or jobs=1") from error
        finally:
            # Workers first: a queue that is closed while its thread writes would print an error.
            for process in () if done else set(multiprocessing.active_children()) - others:
                process.kill()
            pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Hold SIGINT back for a while."""
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _on_cluster(waiting: Iterator[tuple[int, Task]], address: str) -> Iterator[tuple[int, Any]]:
    """Yield results of the workers of a scheduler."""
    if find_spec('distributed') is None:
        raise MissingDependencyError("dask.distributed is not installed: pip install "
                                     "'dz_ros[cluster]'")
    from distributed import as_completed, Client, KilledWorker

    try:
        client = Client(address, timeout=SCHEDULER_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigurationError('--cluster', address,
                                 f'no scheduler answers there: {error}') from error
    with client, client.as_current():
        places: dict[str, int] = {}
        flying = as_completed()

        def fill() -> None:
            """Submit as many as the workers that are there now can use."""
            most = AHEAD * max(1, sum(client.nthreads().values()))
            for place, (function, arguments) in islice(waiting, max(0, most - len(places))):
                future = client.submit(function, *arguments, pure=False, priority=-place)
                places[future.key] = place
                flying.add(future)

        try:
            fill()
            while places:
                for future in flying.next_batch():
                    place, result = places.pop(future.key), future.result()
                    future.release()
                    yield place, result
                fill()
        except KilledWorker as error:
            raise LoopError(f'the scheduler gave up on a task, its workers keep dying: {error}'
                            ) from error
