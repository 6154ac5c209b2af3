# SPDX-License-Identifier: Apache-2.0
"""Frames on a line of bytes: COBS and CRC-32, and a receiver that finds its way back.

A frame's body is followed by its CRC-32, least significant byte first; both together are encoded
by COBS [cheshire1999], which leaves no zero byte, and a zero byte ends the frame:

    line = COBS(body ‖ CRC-32(body)) ‖ 00

The CRC is that of IEEE 802.3 (CRC-32/ISO-HDLC): polynomial 0x04C11DB7, reflected, initial value
and final xor 0xFFFFFFFF; over the nine bytes "123456789" it is 0xCBF43926. For bodies of up to 29
bytes it detects every pattern of up to five wrong bits, for the longest here of up to four
[koopman2002]; COBS can turn one wrong bit of the line into more, so for a line the bound that
holds is the one for arbitrary damage: one damaged frame in 2^32 passes.

Because zero is nothing but an end, a receiver that has lost its place has it again after the next
zero: damage costs the frames it touches, and at most the one after them.
"""

from __future__ import annotations

from collections.abc import Iterator
import zlib

from dz_ros.core.counted_log import Counted

END = 0
"""The byte that ends a frame and occurs nowhere else."""
MAX_BODY = 216
"""Longest body of a frame [bytes]."""
CRC_SIZE = 4
MAX_LINE = MAX_BODY + CRC_SIZE + 1
"""Longest frame on the line, without its end [bytes]; COBS adds one to less than 254."""
NO_CODE, CHECKSUM, SHORT, LONG = ('frames that are not COBS', 'frames with a wrong check sum',
                                  'frames too short', 'frames too long')
"""Causes by which what a receiver throws away is counted."""


def cobs_encode(data: bytes) -> bytes:
    """Return data without zero bytes, the end not included [cheshire1999]."""
    out = bytearray()
    at, size = 0, len(data)
    while True:
        stop = data.find(END, at, at + 254)
        if stop >= 0:
            out.append(stop - at + 1)
            out += data[at:stop]
            at = stop + 1
        else:
            block = data[at:at + 254]
            out.append(len(block) + 1)
            out += block
            at += len(block)
            if at >= size:
                return bytes(out)


def cobs_decode(line: bytes) -> bytes | None:
    """Return what was encoded; None where the line cannot have been encoded by COBS."""
    out = bytearray()
    at, size = 0, len(line)
    if not size or END in line:
        return None
    while at < size:
        code = line[at]
        stop = at + code
        if stop > size:
            return None
        out += line[at + 1:stop]
        at = stop
        if code < 255 and at < size:
            out.append(END)
    return bytes(out)


def pack(body: bytes) -> bytes:
    """Return a frame as it goes over the line, its end included."""
    return cobs_encode(body + zlib.crc32(body).to_bytes(CRC_SIZE, 'little')) + bytes([END])


class Receiver:
    """Finds frames in a stream of bytes, whatever else is in it; needs a bounded memory.

    Args:
        refused: Counts what was thrown away, by cause.
    """

    def __init__(self, refused: Counted | None = None) -> None:
        self.refused = refused or Counted()
        self._line = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Take bytes as they came; yield the body of each frame that is whole."""
        *ended, rest = data.split(bytes([END]))
        for piece in ended:
            self._grow(piece)
            line, skipped = bytes(self._line), self._skipping
            self._line.clear()
            self._skipping = False
            if line and not skipped:
                body = self._open(line)
                if body is not None:
                    yield body
        self._grow(rest)

    def _grow(self, piece: bytes) -> None:
        """Add to the line; begin to skip where it is longer than any frame."""
        if not self._skipping and len(self._line) + len(piece) > MAX_LINE:
            self._skipping = True
            self.refused.add(LONG)
            self._line.clear()
        if not self._skipping:
            self._line += piece

    def _open(self, line: bytes) -> bytes | None:
        """Return the body of a line, None where it is none."""
        data = cobs_decode(line)
        if data is None:
            self.refused.add(NO_CODE)
        elif len(data) <= CRC_SIZE:
            self.refused.add(SHORT)
        elif zlib.crc32(data[:-CRC_SIZE]) != int.from_bytes(data[-CRC_SIZE:], 'little'):
            self.refused.add(CHECKSUM)
        else:
            return data[:-CRC_SIZE]
        return None
