# SPDX-License-Identifier: Apache-2.0
"""Compressed bytes made plain again, never beyond what their file may ask for.

Chunks are compressed by zstd or lz4, rosbag2 compresses single messages or whole files by zstd. A
length is what a file claims: a kilobyte can claim a petabyte, and can become gigabytes. What our
recordings hold is 4 to 6 times as large as their file.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import lz4.frame
import zstandard

from dz_ros.errors import RecordingError

ZSTD = b'\x28\xb5\x2f\xfd'
"""What a zstd frame begins with; no CDR message does."""
LZ4 = b'\x04\x22\x4d\x18'
"""What an lz4 frame begins with."""
LARGEST = 2**28
"""Largest chunk, message or record that is taken into memory [bytes]."""
RATIO = 100
FREE = 2**26
"""A file may become `RATIO` times its size and this [bytes]."""
_STEP = 2**20
BROKEN = (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError)
"""What `expanded` may raise."""


class Allowance:
    """Bytes that one file may still become.

    Args:
        size: Size of the file.
    """

    def __init__(self, size: int) -> None:
        self._most = self._left = FREE + RATIO * size

    def take(self, size: int) -> None:
        """Take some.

        Raises:
            ValueError: They are too many.
        """
        if size > LARGEST:
            raise ValueError(f'{size} bytes in one piece, at most {LARGEST} are read')
        if size > self._left:
            raise ValueError(f'the file expands to more than {self._most} bytes')
        self._left -= size


def expanded(data: bytes, compression: str, allowance: Allowance,
             size: int | None = None) -> bytes:
    """Return the plain bytes of a chunk or message.

    Args:
        data: The compressed bytes.
        compression: ``zstd`` or ``lz4``.
        allowance: Of its file.
        size: How many they must be; None = what the data announces, which only zstd must.

    Raises:
        ValueError: Another size than announced, too large a one, an unknown compression.
        zstandard.ZstdError, RuntimeError, EOFError, MemoryError: Broken data.
    """
    room = LARGEST if size is None else size
    if compression == 'zstd':
        claimed = zstandard.frame_content_size(data)
        if claimed >= 0 and size in (None, claimed):
            allowance.take(claimed)
            return bytes(_decompressor().decompress(data))
        allowance.take(room)
        with _decompressor().stream_reader(data) as reader:
            found = bytes(reader.read(room + 1))
    elif compression == 'lz4':
        allowance.take(room)
        found = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=room + 1)
    else:
        raise ValueError(f'compression {compression[:20]!r}, known are zstd and lz4')
    if len(found) > room or size not in (None, len(found)):
        raise ValueError(f'{len(found)} bytes, announced were {room}')
    return found


def _decompressor() -> zstandard.ZstdDecompressor:
    return zstandard.ZstdDecompressor(max_window_size=LARGEST // 2)


@contextmanager
def plain_file(path: Path, damage: list[str] | None) -> Iterator[Path]:
    """Yield a file as it is, or a copy made plain if it is compressed as a whole.

    Args:
        path: The file.
        damage: Takes what is wrong with the compressed bytes, as text, where what comes before
            is wanted all the same; None = it is not.

    Raises:
        RecordingError: It expands too far, is broken, or there is no room for the copy.
    """
    with path.open('rb') as file:
        if file.read(len(ZSTD)) != ZSTD:
            yield path
            return
    size = path.stat().st_size
    left = FREE + RATIO * size
    with TemporaryDirectory(prefix='dz_ros-') as folder:
        copy = Path(folder, path.name.removesuffix('.zstd').removesuffix('.zst'))
        try:
            with path.open('rb') as packed, copy.open('wb') as file:
                reader = _decompressor().stream_reader(packed, read_across_frames=True)
                while piece := reader.read(_STEP):
                    left -= file.write(piece)
                    if left < 0:
                        raise RecordingError(f'{path} expands to more than {FREE + RATIO * size} '
                                             'bytes: no recording does')
        except zstandard.ZstdError as error:
            if damage is None:
                raise RecordingError(f'{path} is damaged: {error}; keep what is readable with '
                                     f'dz bag recover {path}') from None
            damage.append(f'{path.name}: {error}')
        yield copy
