# SPDX-License-Identifier: Apache-2.0
"""The folder in which this user's compiled loops are kept between processes (ours).

`$DZ_ROS_CACHE`, else `dz_ros` in `$XDG_CACHE_HOME` or `~/.cache`; ``off`` keeps nothing. A file
is a digest and the code it is of. What is read from it is run, so a folder that another user owns
or may write to is not used; nor is a file whose digest does not fit. Nothing here ever raises: a
folder that cannot be used costs the time of compiling.
"""

from __future__ import annotations

from contextlib import suppress
import hashlib
import os
from pathlib import Path
import stat
import tempfile

from dz_ros.core.loop.compiled import keep_in

VARIABLE = 'DZ_ROS_CACHE'
LARGEST_COUNT = 300
"""Files that are kept, those used last; a file is some tenths of a megabyte."""
_SUFFIX = '.code'
_DIGEST = 32


def keep_compiled() -> None:
    """Keep what this process compiles in this user's folder, and take it from there."""
    keep_in(CodeFolder.of_user())


class CodeFolder:
    """Code in files of a folder, one for each key; see `dz_ros.core.loop.code_store.CodeStore`.

    Args:
        folder: The folder; it is made when something is saved.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @classmethod
    def of_user(cls) -> CodeFolder | None:
        """Return this user's folder; None where there is none, or it is switched off."""
        named = os.environ.get(VARIABLE, '')
        if named == 'off' or os.environ.get('NUMBA_DISABLE_JIT', '0') not in ('', '0'):
            return None
        if named:
            return cls(Path(named))
        with suppress(RuntimeError):        # no home
            base = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
            return cls(Path(base) / 'dz_ros')
        return None

    def load(self, key: str) -> bytes | None:
        """Return the code under a key; None where there is none that may be used."""
        path = self._folder / (key + _SUFFIX)
        try:
            if not self._private():
                return None
            content = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        data = content[_DIGEST:]
        return data if hashlib.sha256(data).digest() == content[:_DIGEST] else None

    def save(self, key: str, data: bytes) -> None:
        """Keep code under a key, if the folder may be used."""
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if not self._private():
                return
            handle, name = tempfile.mkstemp(dir=self._folder, suffix='.part')
            part = Path(name)
            try:
                with os.fdopen(handle, 'wb') as file:
                    file.write(hashlib.sha256(data).digest() + data)
                part.replace(self._folder / (key + _SUFFIX))
            finally:
                part.unlink(missing_ok=True)
            self._forget()

    def _private(self) -> bool:
        """Return whether the folder is this user's, and only this user may write to it."""
        found = os.lstat(self._folder)
        return (stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
                and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))

    def _forget(self) -> None:
        """Remove what was used longest ago, beyond `LARGEST_COUNT` files."""
        found = sorted(self._folder.glob(f'*{_SUFFIX}'), key=lambda path: -path.stat().st_mtime)
        for path in found[LARGEST_COUNT:]:
            path.unlink(missing_ok=True)
