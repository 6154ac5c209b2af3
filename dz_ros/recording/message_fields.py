# SPDX-License-Identifier: Apache-2.0
"""Numbers out of any ROS 2 message, by the definition that its bag holds.

A definition (``ros2msg``) is the text of the message, then those of the types it uses, each after
a line of = and ``MSG: package/Type``. The payload is CDR as in `dz_ros.recording.cdr`. A field is
named as its path, ``position[0]`` or ``pose.pose.position.x``; ``header.stamp`` is its seconds.
Where strings ``name[]`` are beside arrays, as in a JointState, their numbers have the names of
their places as well, ``position[elbow]``, wherever that is in each message.

The definition comes from the bag as well, so it is no more believed than the payload: each value
takes at least a byte of the payload, and only the first `MOST_NUMBERS` are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import re
import struct
from typing import Any

from dz_ros.errors import MessageError

PRIMITIVES = {'bool': '?', 'byte': 'B', 'char': 'B', 'octet': 'B', 'int8': 'b', 'uint8': 'B',
              'int16': 'h', 'uint16': 'H', 'int32': 'i', 'uint32': 'I', 'int64': 'q',
              'uint64': 'Q', 'float32': 'f', 'float64': 'd'}
TIMES = {'builtin_interfaces/Time', 'builtin_interfaces/Duration'}
LARGEST_COUNT = 2**24
"""Elements of an array at most."""
MOST_NUMBERS = 100_000
"""Numbers of a message that are returned, its first ones: not all of an image or a cloud."""
NAMES = 'name'
"""Field with the names of the places of the arrays beside it."""
DEEPEST = 20
"""Types within types at most."""
_HEADER = 'MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id'
KNOWN = {'sensor_msgs/msg/JointState':
         'std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n'
         f'float64[] effort\n===\n{_HEADER}',
         'std_msgs/msg/Float64': 'float64 data', 'std_msgs/msg/Float32': 'float32 data'}
"""Definitions of common types, for bags without them."""
_FIELD = re.compile(r'^([A-Za-z0-9_/]+)(<=\d+)?(\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)\s*(=)?')


@dataclass(frozen=True)
class _Field:
    kind: str
    name: str
    array: bool
    length: int | None


class MessageType:
    """A type of message, ready to decode.

    Args:
        type_name: Such as ``sensor_msgs/msg/JointState``.
        definition: Its text; empty = one of `KNOWN`.

    Raises:
        MessageError: No definition, or not one.
    """

    def __init__(self, type_name: str, definition: str) -> None:
        text = definition or KNOWN.get(type_name, '')
        if not text:
            raise MessageError(f'the bag does not define how {type_name} is made')
        self.name = type_name
        own, *others = re.split(r'^=+\s*$', text, flags=re.MULTILINE)
        self._types = {'': _fields(own)}
        for other in others:
            head, _, body = other.strip().partition('\n')
            name = head.removeprefix('MSG:').strip().replace('/msg/', '/')
            self._types[name] = _fields(body)
        self._package = type_name.partition('/')[0]

    def decode(self, payload: bytes) -> dict[str, float]:
        """Return the numbers of a message by their paths, the first `MOST_NUMBERS` of them.

        Raises:
            MessageError: The payload does not fit the definition.
        """
        if len(payload) < 4 or payload[0] != 0 or payload[1] not in (0, 1):
            raise MessageError(f'{self.name}: not plain CDR')
        reader = _Reader(payload, '<' if payload[1] else '>')
        found: dict[str, float] = {}
        try:
            self._read(reader, '', '', found, 0)
        except (struct.error, IndexError):
            raise MessageError(f'{self.name}: the message ends before its last field') from None
        return found

    def _read(self, reader: _Reader, kind: str, path: str, found: dict[str, float],
              depth: int) -> None:
        if depth > DEEPEST:
            raise MessageError(f'{self.name}: types within types without end')
        names: list[str] = []
        if not self._types[kind]:
            reader.skip(1)      # as IDL gives a type without fields one
        for field in self._types[kind]:
            name = f'{path}.{field.name}' if path else field.name
            count = 1
            if field.array:
                count = reader.number('I') if field.length is None else field.length
                if count > LARGEST_COUNT:
                    raise MessageError(f'{self.name}: {name} has {count} elements')
            if field.array and field.kind in PRIMITIVES:
                kept = min(count, max(MOST_NUMBERS - len(found), 0))
                for i, value in enumerate(reader.numbers(PRIMITIVES[field.kind], count, kept)):
                    found[f'{name}[{i}]'] = float(value)
                continue
            if field.array and field.name == NAMES and field.kind == 'string':
                names = [reader.string() for _ in range(count)]
                continue
            for i in range(count):
                self._value(reader, field.kind, f'{name}[{i}]' if field.array else name, found,
                            depth)
        arrays = [field.name for field in self._types[kind]
                  if field.array and field.kind in PRIMITIVES] if names else []
        for array in arrays:
            before = f'{path}.{array}' if path else array
            for i, own in enumerate(names[:MOST_NUMBERS]):
                if f'{before}[{i}]' in found:
                    found.setdefault(f'{before}[{own}]', found[f'{before}[{i}]'])

    def _value(self, reader: _Reader, kind: str, name: str, found: dict[str, float],
               depth: int) -> None:
        if kind in PRIMITIVES:
            value = float(reader.number(PRIMITIVES[kind]))
            if len(found) < MOST_NUMBERS:
                found[name] = value
        elif kind in ('string', 'wstring'):
            reader.skip(reader.number('I') * (1 if kind == 'string' else 4))
        elif kind in TIMES or f'builtin_interfaces/{kind}' in TIMES:
            value = reader.number('i') + 1e-9 * reader.number('I')
            if len(found) < MOST_NUMBERS:
                found[name] = value
        else:
            own = f'{self._package}/{kind}'
            used = kind if kind in self._types else own if own in self._types else next(
                (item for item in self._types if item.endswith(f'/{kind}')), '')
            if not used:
                raise MessageError(f'{self.name}: the bag does not define how {kind} is made')
            self._read(reader, used, name, found, depth + 1)


class _Reader:
    """Place in a payload; numbers start at multiples of their size."""

    def __init__(self, payload: bytes, order: str) -> None:
        self._body, self._order, self._place = memoryview(payload)[4:], order, 0

    def numbers(self, code: str, count: int, kept: int) -> Sequence[Any]:
        """Return the first of a number of numbers, and pass over all.

        Raises:
            IndexError: The payload ends before.
        """
        if not count:
            return ()
        size = struct.calcsize(f'={code}')
        begin = -(-self._place // size) * size
        self._place = begin
        self.skip(size * count)
        return struct.unpack_from(f'{self._order}{kept}{code}', self._body, begin)

    def number(self, code: str) -> Any:
        """Return one."""
        return self.numbers(code, 1, 1)[0]

    def string(self) -> str:
        """Return a string without the 0 at its end.

        Raises:
            IndexError: The payload ends before.
        """
        size = self.number('I')
        begin = self._place
        self.skip(size)
        return bytes(self._body[begin:self._place]).rstrip(b'\0').decode(errors='replace')

    def skip(self, count: int) -> None:
        """Pass over bytes.

        Raises:
            IndexError: The payload ends before.
        """
        self._place += count
        if self._place > len(self._body):
            raise IndexError(self._place)


def _fields(text: str) -> tuple[_Field, ...]:
    """Return the fields of one type; constants and comments are none.

    Raises:
        MessageError: An array of length 0.
    """
    found = []
    for line in text.splitlines():
        match = _FIELD.match(line.partition('#')[0].strip())
        if match is None or match[7]:
            continue
        bounded = bool(match[4])
        length = int(match[5][:20]) if match[5] and not bounded else None
        if length == 0:
            raise MessageError(f'{match[6]}: an array of a definition has no elements')
        found.append(_Field(match[1].replace('/msg/', '/'), match[6], match[3] is not None,
                            length))
    return tuple(found)


def close_names(wanted: str, known: Mapping[str, Any] | Sequence[str]) -> str:
    """Return the known names, the likely ones first, cut short for a message of one line."""
    from difflib import get_close_matches

    names = list(known)
    near = get_close_matches(wanted, names, 3, 0.5)
    shown = [*near, *(name for name in names if name not in near)][:12]
    return ', '.join(shown) + (' …' if len(names) > len(shown) else '')
