# SPDX-License-Identifier: Apache-2.0
"""YAML as it is meant today: 1e-3 is a number, a key twice in one mapping is an error.

PyYAML follows YAML 1.1, in which ``1e-3`` is text, ``12:30`` is 750, ``010`` is 8 and a date is
no text. ROS's own reader (rcl) takes the first as the number it looks like. Here numbers are those
of the core schema of YAML 1.2; true and false keep the spellings ROS accepts; aliases are refused,
as ROS does, or, where other tools write them, counted as what they stand for: a text may hold
`MOST_NODES` values, however few lines they take.
"""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any, ClassVar

import yaml

MOST_BYTES = 16 * 2**20
"""Largest file read."""
MOST_NODES = 300_000
"""Most keys and values in a text, aliases expanded; some 600 bytes each while it is read."""


class YamlError(ValueError):
    """Text that is not YAML, or a mapping with a key given twice; one line with the place."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML comes without types
    """PyYAML's safe loader with numbers of YAML 1.2 and without duplicate keys."""

    yaml_implicit_resolvers: ClassVar[dict[Any, Any]] = {
        first: [(tag, pattern) for tag, pattern in resolvers
                if tag.rpartition(':')[2] not in ('int', 'float', 'timestamp', 'value')]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()}
    aliases: ClassVar[bool] = False

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._count = 0
        self._sizes: dict[str, int] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node; refuse an alias where none is wanted, and too many nodes."""
        event = self.peek_event()
        anchor, before = event.anchor, self._count
        if not isinstance(event, yaml.AliasEvent):
            self._sizes.pop(anchor, None)
            self._count += 1
        elif not self.aliases:
            raise YamlError(f'{_place(event.start_mark)}aliases are not allowed')
        elif anchor in self.anchors and anchor not in self._sizes:
            raise YamlError(f'{_place(event.start_mark)}*{anchor} stands within itself')
        else:
            self._count += self._sizes.get(anchor, 0)
        if self._count > MOST_NODES:
            raise YamlError(f'{_place(event.start_mark)}more than {MOST_NODES} keys and values')
        node = super().compose_node(parent, index)
        if anchor is not None:
            self._sizes[anchor] = self._count - before
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping; refuse a key given twice."""
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = key_node.value
            if key_node.id != 'scalar':
                raise YamlError(f'{_place(key_node.start_mark)}a key must be a word')
            if key in seen:
                raise YamlError(f'{_place(key_node.start_mark)}{key} is given twice')
            seen.add(key)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


class _AliasLoader(_Loader):
    """The same, with aliases."""

    aliases: ClassVar[bool] = True


_INTEGER = re.compile(r'^(?:[-+]?[0-9]+|0x[0-9a-fA-F]+)$')
_FLOAT = re.compile(r'^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?'
                    r'|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$')
_Loader.add_implicit_resolver('tag:yaml.org,2002:int', _INTEGER, list('-+0123456789'))
_Loader.add_implicit_resolver('tag:yaml.org,2002:float', _FLOAT, list('-+.0123456789'))


def _integer(loader: _Loader, node: Any) -> int:
    text = str(loader.construct_scalar(node))
    return int(text, 16 if text.startswith('0x') else 10)


_Loader.add_constructor('tag:yaml.org,2002:int', _integer)


def parse_file(path: Path, aliases: bool = False) -> Any:
    """Return what a YAML file holds; see `parse`.

    Raises:
        YamlError: It is no YAML that `parse` takes, no UTF-8, or larger than `MOST_BYTES`.
        OSError: It cannot be read.
    """
    if path.stat().st_size > MOST_BYTES:
        raise YamlError(f'is larger than {MOST_BYTES} bytes')
    try:
        text = path.read_text(encoding='utf-8')
    except UnicodeDecodeError:
        raise YamlError('is not a text file in UTF-8') from None
    return parse(text, aliases)


def parse(text: str, aliases: bool = False) -> Any:
    """Return what a YAML text holds: dict, list, str, float, int, bool or None.

    Args:
        text: The text.
        aliases: Take aliases and merge keys, which ROS's own parameter files must not hold.

    Raises:
        YamlError: It is not YAML, gives a key twice, or holds more than `MOST_NODES` values.
    """
    try:
        return yaml.load(text, _AliasLoader if aliases else _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        problem = getattr(error, 'problem', None) or str(error).splitlines()[0]
        raise YamlError(f'{_place(mark)}{problem}') from None
    except YamlError:
        raise
    except RecursionError:
        raise YamlError('is nested too deeply') from None
    except (ValueError, TypeError, AttributeError):     # how PyYAML meets !!float abc
        raise YamlError('a value does not fit its tag') from None


def _place(mark: Any) -> str:
    return f'line {mark.line + 1}: ' if mark is not None else ''
