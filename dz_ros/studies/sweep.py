"""Sweeps: thousands of runs off line, a row each, into a file that may be continued.

The file is CSV: a comment line with the plan's fingerprint, a header, rows in the order in which
they were done. Whatever ended a sweep, running it again reads what is there, drops a line that was
cut off, and does the rest; a file of another plan is refused. Rows are sorted by run once all are
there. With the ending .parquet the file is written in one piece at the end, from a CSV beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import csv
import io
import os
from pathlib import Path
from typing import Any

from dz_ros.errors import ConfigurationError, MissingDependencyError, RunExistsError
from dz_ros.studies.arena import text
from dz_ros.studies.outcome import COLUMNS, Row, rows_of
from dz_ros.studies.pool import cores, execute
from dz_ros.studies.sweep_plan import SweepPlan

MARK = '# dz_ros sweep '
CHUNK = 50
"""Runs in a task at most: what is lost where a worker dies."""
Progress = Callable[[int, int, str], None]


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
    points = plan.points()
    done = _begin(working, plan, keys)
    if resume is not None:
        resume(len(done))
    missing = [place for place in range(len(points)) if place not in done]
    lost = sum(done.values())
    size = max(1, min(CHUNK, -(-len(missing) // (4 * (jobs or cores())))))
    chunks = [missing[i:i + size] for i in range(0, len(missing), size)]
    tasks = [(rows_of, (dict(plan.base), [plan.changes(points[place]) for place in chunk]))
             for chunk in chunks]
    count = len(done)
    with working.open('a', encoding='utf-8', newline='') as file:
        for place, rows in execute(tasks, jobs, cluster):
            file.write(_lines(zip(chunks[place], rows, strict=True), points, keys))
            file.flush()
            os.fsync(file.fileno())
            count += len(rows)
            lost += sum(bool(row['lost']) for row in rows)
            if progress is not None:
                progress(count, len(points), f'{lost} lost' if lost else '')
    _sort(working, plan)
    if parquet:
        _write_parquet(working, out)
        working.unlink()
    return lost


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
    lines = _whole_lines(path)
    if len(lines) < 2 or not lines[0].startswith(MARK):
        raise ConfigurationError('sweep', str(path), 'is not a file that dz sweep wrote')
    found = [{key: _number(value) for key, value in row.items()}
             for row in csv.DictReader(lines[1:])]
    return sorted(found, key=lambda row: int(row['run']))


def _begin(path: Path, plan: SweepPlan, keys: Sequence[str]) -> dict[int, bool]:
    """Make the file or go on with it; return run → whether it was lost, of those done."""
    head = f'{MARK}{plan.fingerprint()}\n' + _csv([('run', *keys, *COLUMNS)])
    if not path.exists():
        path.write_text(head, encoding='utf-8')
        return {}
    lines = _whole_lines(path)
    if not lines or not lines[0].startswith(MARK):
        if not lines and path.stat().st_size < len(head):
            path.write_text(head, encoding='utf-8')
            return {}
        raise ConfigurationError('--out', str(path), 'exists and is not the file of a sweep; '
                                 'choose another one')
    if ''.join(lines[:2]) != head:
        raise ConfigurationError('--out', str(path), 'holds another sweep (configuration, axes, '
                                 'samples or seed differ); choose another file')
    path.write_text(''.join(lines), encoding='utf-8')   # without what was cut off
    return {int(row['run']): row['lost'] == '1' for row in csv.DictReader(lines[1:])}


def _whole_lines(path: Path) -> list[str]:
    """Return the lines that were written to their end."""
    try:
        with path.open(encoding='utf-8', newline='') as file:
            return [line for line in file if line.endswith('\n')]
    except UnicodeDecodeError:
        raise ConfigurationError('sweep', str(path), 'is not a text file') from None


def _lines(rows: Iterable[tuple[int, Row]], points: Sequence[Mapping[str, Any]],
           keys: Sequence[str]) -> str:
    return _csv((str(place), *(text(points[place][key]) for key in keys),
                 *(text(row[name]).replace('\n', ' ') for name in COLUMNS))
                for place, row in rows)


def _csv(rows: Iterable[Sequence[str]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator='\n').writerows(rows)
    return out.getvalue()


def _sort(path: Path, plan: SweepPlan) -> None:
    """Put the rows of a finished sweep in the order of its runs."""
    lines = _whole_lines(path)
    rows = sorted(lines[2:], key=lambda line: int(line.partition(',')[0]))
    if len(rows) == len(plan) and rows != lines[2:]:
        part = path.with_name(f'{path.name}.sorted')
        part.write_text(''.join([*lines[:2], *rows]), encoding='utf-8')
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
    """Write the rows of a CSV file as Parquet."""
    import pyarrow
    from pyarrow import parquet

    rows = read_sweep(source)
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        if name == 'reason' or any(isinstance(value, str) for value in values):
            values = ['' if value is None else str(value) for value in values]
        elif name not in ('run', 'lost'):
            values = [None if value is None else float(value) for value in values]
        columns[name] = values
    part = out.with_name(f'{out.name}.part')
    parquet.write_table(pyarrow.table(columns), part)
    part.replace(out)
