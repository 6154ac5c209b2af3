# SPDX-License-Identifier: Apache-2.0
"""Files of a run, by metadata.yaml and by what is in its directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
import re
from typing import Any

from dz_ros.errors import RecordingError, RunNotFoundError, suggestion
from dz_ros.recording.bag_metadata import FILE_NAME, read_metadata

_STORAGE = re.compile(r'\.(mcap|db3)(\.zstd)?$')
_NUMBERED = re.compile(r'^(.*?)_?(\d+)\.(mcap|db3)(?:\.zstd)?$')
_MOST_NAMES = 5
"""Number of files that are named."""


@dataclass(frozen=True)
class BagFiles:
    """The files of a run.

    Attributes:
        files: In the order in which they were recorded.
        bag: Contents of metadata.yaml; {} without one.
        notes: Where it differs from the files, as text.
        cut: Which files are missing by their numbers, as text; empty = none.
        damage: Which files it names that are missing, as text.
    """

    files: list[Path]
    bag: Mapping[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    cut: str = ''
    damage: list[str] = field(default_factory=list)


def _near(path: Path) -> str:
    """Return what an error adds about the run beside a misspelt one; '' if there is none."""
    try:
        return suggestion(path.name, [item.name for item in path.parent.iterdir()])
    except OSError:
        return ''


def find_files(path: Path, skip_damage: bool) -> BagFiles:
    """Return the files of the run at a path.

    Args:
        path: Directory or file.
        skip_damage: Do without files that are missing, instead of raising.

    Raises:
        RunNotFoundError: Nothing there, or a file that metadata.yaml names is missing.
        RecordingError: Something else than a run.
    """
    try:
        there, is_directory, is_file = path.exists(), path.is_dir(), path.is_file()
        here = sorted((item for item in path.iterdir() if _STORAGE.search(item.name)
                       and item.is_file()), key=_by_number) if is_directory else []
    except (OSError, ValueError) as error:
        raise RecordingError(f'{path} cannot be read: '
                             f'{getattr(error, "strerror", None) or error}') from None
    if not there:
        raise RunNotFoundError(f'{path}: no such run{_near(path)}')
    if is_file:
        return BagFiles([path])
    if not is_directory:
        raise RecordingError(f'{path} is neither a file nor a directory')
    bag, problem = read_metadata(path)
    notes = [f'{FILE_NAME}: {problem}'] if problem else []
    if bag:
        return _described(path, bag, here, skip_damage)
    if not here:
        raise RecordingError(f'{path} is not a run: it holds neither {FILE_NAME} nor an .mcap '
                             f'file nor a .db3 file{f"; {notes[0]}" if notes else ""}')
    chosen = [item for item in here if '.db3' not in item.name] or here
    notes += [f'{item.name} is not read: there are .mcap files' for item in here
              if item not in chosen]
    return BagFiles(chosen, notes=notes, cut=_gaps(chosen))


def _described(path: Path, bag: Mapping[str, Any], here: list[Path],
               skip_damage: bool) -> BagFiles:
    """Return the bag in a directory as its metadata.yaml describes it."""
    stated = bag.get('relative_file_paths')
    names = [Path(str(name)).name for name in stated] if isinstance(stated, list) else []
    lying = {item.name: item for item in path.iterdir() if item.is_file()}
    files: list[Path] = []
    missing: list[str] = []
    for name in dict.fromkeys(names):
        found = next((lying[item] for item in (name, f'{name}.zstd', name.removesuffix('.zstd'))
                      if item in lying), None)
        if found is None:
            missing.append(name)
        elif found not in files:
            files.append(found)
    notes: list[str] = []
    damage: list[str] = []
    if not files and here:
        files = here
        notes.append(f'{FILE_NAME} names {_listed(missing) or "no file"}: read are the files '
                     f'there, {_listed([item.name for item in here])}')
    elif missing or not files:
        text = f'{path / (missing or ["no file"])[0]}: {FILE_NAME} names it, but it is not there'
        if not (skip_damage and files):
            raise RunNotFoundError(text + (f'; keep the others with dz bag recover {path}'
                                           if files else ''))
        damage = [f'{name}: {FILE_NAME} names it, but it is not there' for name in missing]
    read = {item.name.removesuffix('.zstd') for item in files}
    others = [item.name for item in here if item.name.removesuffix('.zstd') not in read]
    if others:
        notes.append(f'{FILE_NAME} does not name {_listed(others)}, not read here')
    return BagFiles(files, bag, notes, damage=damage)


def _listed(names: list[str]) -> str:
    """Return some names, and how many more there are."""
    more = f' and {len(names) - _MOST_NAMES} more' if len(names) > _MOST_NAMES else ''
    return ', '.join(names[:_MOST_NAMES]) + more


def _gaps(files: list[Path]) -> str:
    """Return which files of a series are missing, as text; empty where none is."""
    found: dict[tuple[str, str], set[int]] = {}
    for item in files:
        parts = _NUMBERED.match(item.name)
        if parts and len(parts[2]) < 7:
            found.setdefault((parts[1], parts[3]), set()).add(int(parts[2]))
    lacking = [f'{name}_{number}.{kind}' for (name, kind), numbers in found.items()
               if len(numbers) > 1
               for number in range(0 if min(numbers) < 10 else min(numbers), max(numbers))
               if number not in numbers]
    if not lacking:
        return ''
    return f'not whole: {_listed(lacking)} missing'


def _by_number(path: Path) -> tuple[int, str]:
    """Return a key that puts NAME_2 before NAME_10."""
    parts = _NUMBERED.match(path.name)
    return int(parts[2]) if parts and len(parts[2]) < 20 else 0, path.name
