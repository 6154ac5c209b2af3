# SPDX-License-Identifier: Apache-2.0
"""Sweeps: thousands of runs offline, a row each, into a file that may be continued.

The file is CSV: a comment line with the plan's fingerprint, a header, rows in the order in which
they were done. Whatever ended a sweep, running it again reads what is there, drops a line that was
cut off, and does the rest; a file of another plan is refused. Rows are sorted by run once all are
there. With the ending .parquet the file is written at the end, from a CSV beside it.

Of a run only some bytes stay in memory, whether it is done and where its row begins: points are
made, results written and files read as a stream.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
import csv
import io
from itertools import compress, islice
import os
from pathlib import Path
from typing import Any

from dz_ros.errors import ConfigurationError, MissingDependencyError, RunExistsError
from dz_ros.studies.arena import text
from dz_ros.studies.outcome import COLUMNS, Row, rows_of
from dz_ros.studies.pool import cores, execute, Task
from dz_ros.studies.sweep_plan import SweepPlan

MARK = '# dz_ros sweep '
CHUNK = 50
"""Runs in a task at most: what is lost where a worker dies."""
GROUP = 10_000
"""Rows in a group of a Parquet file."""
Progress = Callable[[int, int, str], None]
Point = tuple[int, dict[str, Any]]
"""A run's number, and key → value."""
_MISSING, _DONE, _LOST = range(3)


def run_sweep(plan: SweepPlan, out: Path, jobs: int = 0, cluster: str | None = None,
              progress: Progress | None = None,
              resume: Callable[[int], None] | None = None) -> int:
    """Run what is missing of a sweep; return the number of runs that were lost.

    Args:
        plan: What to run.
        out: File, .csv or .parquet.
        jobs: Processes; 0 = one for each core.
        cluster: Address of a dask.distributed scheduler; None = this machine.
        progress: Called with runs done, runs in all and a word.
        resume: Called first, with the number of runs found done.

    Raises:
        ConfigurationError: A plan or a file that cannot be used.
        RunExistsError: The Parquet file is there already.
        MissingDependencyError: Parquet without pyarrow, a cluster without dask.distributed.
    """
    plan.check()
    parquet = out.suffix == '.parquet'
    if parquet:
        _require_pyarrow()
        if out.exists():
            raise RunExistsError(f'{out}: exists already; choose another file')
    working = out.with_name(f'{out.name}.part.csv') if parquet else out
    keys = [axis.key for axis in plan.axes]
    done = _begin(working, plan, keys)
    missing, lost = done.count(_MISSING), done.count(_LOST)
    count = len(plan) - missing
    if resume is not None:
        resume(count)
    size = max(1, min(CHUNK, -(-missing // (4 * (jobs or cores())))))
    flying: dict[int, list[Point]] = {}
    with working.open('a', encoding='utf-8', newline='') as file:
        for place, rows in execute(_tasks(plan, done, size, flying), jobs, cluster):
            file.write(_lines(flying.pop(place), rows, keys))
            file.flush()
            os.fsync(file.fileno())
            count += len(rows)
            lost += sum(bool(row['lost']) for row in rows)
            if progress is not None:
                progress(count, len(plan), f'{lost} lost' if lost else '')
    _sort(working, plan)
    if parquet:
        _write_parquet(working, out)
        working.unlink()
    return lost


def _tasks(plan: SweepPlan, done: bytearray, size: int,
           flying: dict[int, list[Point]]) -> Iterator[Task]:
    """Yield a task for every `size` runs that are missing; note in `flying` which they are."""
    base = dict(plan.base)
    missing = compress(enumerate(plan.points()), (state == _MISSING for state in done))
    place = 0
    while chunk := list(islice(missing, size)):
        flying[place] = chunk
        yield rows_of, (base, [plan.changes(point) for _, point in chunk])
        place += 1


def read_sweep(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a sweep's file, numbers as numbers, sorted by run.

    Raises:
        ConfigurationError: No such file, or not one of a sweep.
        MissingDependencyError: Parquet without pyarrow.
    """
    if not path.is_file():
        raise ConfigurationError('sweep', str(path), 'no such file')
    if path.suffix == '.parquet':
        _require_pyarrow()
        from pyarrow import parquet
        rows: list[dict[str, Any]] = parquet.read_table(path).to_pylist()
        return rows
    return sorted(_rows(path), key=lambda row: int(row['run']))


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a CSV file as they stand, numbers as numbers.

    Raises:
        ConfigurationError: It is not one of a sweep.
    """
    lines = _whole_lines(path)
    if not next(lines, '').startswith(MARK) or not (names := next(lines, '')):
        raise ConfigurationError('sweep', str(path), 'is not a file that dz sweep wrote')
    header = next(csv.reader([names]))
    for values in csv.reader(lines):
        yield {key: _number(value) for key, value in zip(header, values, strict=True)}


def _begin(path: Path, plan: SweepPlan, keys: Sequence[str]) -> bytearray:
    """Make the file or go on with it; return what is known of every run."""
    head = f'{MARK}{plan.fingerprint()}\n' + _csv([('run', *keys, *COLUMNS)])
    done = bytearray(len(plan))
    if not path.exists():
        path.write_text(head, encoding='utf-8')
        return done
    lines = _whole_lines(path)
    first = next(lines, '')
    if not first.startswith(MARK):
        if not first and path.stat().st_size < len(head):
            path.write_text(head, encoding='utf-8')
            return done
        raise ConfigurationError('--out', str(path), 'exists and is not the file of a sweep; '
                                 'choose another one')
    names = next(lines, '')
    if first + names != head:
        raise ConfigurationError('--out', str(path), 'holds another sweep (configuration, axes, '
                                 'samples or seed differ); choose another file')
    whole = len(head.encode())
    for line in lines:
        row = next(csv.reader([line]))
        done[int(row[0])] = _LOST if row[-2] == '1' else _DONE
        whole += len(line.encode())
    os.truncate(path, whole)    # without what was cut off
    return done


def _whole_lines(path: Path) -> Iterator[str]:
    """Yield the lines that were written to their end."""
    try:
        with path.open(encoding='utf-8', newline='') as file:
            for line in file:
                if line.endswith('\n'):
                    yield line
    except UnicodeDecodeError:
        raise ConfigurationError('sweep', str(path), 'is not a text file') from None


def _lines(points: Iterable[Point], rows: Iterable[Row], keys: Sequence[str]) -> str:
    return _csv((str(place), *(text(point[key]) for key in keys),
                 *(text(row[name]).replace('\n', ' ') for name in COLUMNS))
                for (place, point), row in zip(points, rows, strict=True))


def _csv(rows: Iterable[Sequence[str]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator='\n').writerows(rows)
    return out.getvalue()


def _sort(path: Path, plan: SweepPlan) -> None:
    """Put the rows of a finished sweep in the order of its runs."""
    starts = array('q', [-1]) * len(plan)
    with path.open('rb') as file:
        head = file.readline() + file.readline()
        begin, last, sorted_ = len(head), -1, True
        for line in file:
            run = int(line[:line.index(b',')])
            starts[run] = begin
            begin += len(line)
            sorted_, last = sorted_ and run > last, run
        if sorted_ or -1 in starts:
            return
        part = path.with_name(f'{path.name}.sorted')
        with part.open('wb') as target:
            target.write(head)
            for start in starts:
                file.seek(start)
                target.write(file.readline())
    part.replace(path)


def _number(value: str) -> Any:
    """Return a CSV text as what it was."""
    if value == '':
        return None
    for kind in (int, float):
        try:
            return kind(value)
        except ValueError:
            continue
    return value


def _require_pyarrow() -> None:
    """Find out whether Parquet can be read and written."""
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise MissingDependencyError('Parquet needs pyarrow: pip install pyarrow, or write '
                                     '.csv') from error
    assert pyarrow.parquet


def _write_parquet(source: Path, out: Path) -> None:
    """Write the rows of a CSV file as Parquet, some thousands at a time."""
    import pyarrow
    from pyarrow import parquet

    kinds = {}
    for row in _rows(source):
        for name, value in row.items():
            if isinstance(value, str):
                kinds[name] = pyarrow.string()
            else:
                kinds.setdefault(name, pyarrow.int64() if name in ('run', 'lost')
                                 else pyarrow.float64())
    kinds['reason'] = pyarrow.string()
    schema = pyarrow.schema(list(kinds.items()))
    rows = _rows(source)
    part = out.with_name(f'{out.name}.part')
    with parquet.ParquetWriter(part, schema) as writer:
        while group := list(islice(rows, GROUP)):
            writer.write_table(pyarrow.table({name: [_as(kind, row[name]) for row in group]
                                              for name, kind in kinds.items()}, schema))
    part.replace(out)


def _as(kind: Any, value: Any) -> Any:
    """Return a value as what its column holds."""
    if str(kind) == 'string':
        return '' if value is None else str(value)
    return value if value is None or str(kind) == 'int64' else float(value)
