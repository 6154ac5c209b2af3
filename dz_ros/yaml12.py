"""YAML as it is meant today: 1e-3 is a number, a key twice in one mapping is an error.

PyYAML follows YAML 1.1, in which ``1e-3`` is text, ``12:30`` is 750, ``010`` is 8 and a date is
no text. ROS's own reader (rcl) takes the first as the number it looks like. Here numbers are those
of the core schema of YAML 1.2; true and false keep the spellings ROS accepts; aliases are refused,
as ROS does.
"""

from __future__ import annotations

import re
from typing import Any, ClassVar

import yaml


class YamlError(ValueError):
    """Text that is not YAML, or a mapping with a key given twice; one line with the place."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML comes without types
    """PyYAML's safe loader with numbers of YAML 1.2 and without duplicate keys."""

    yaml_implicit_resolvers: ClassVar[dict[Any, Any]] = {
        first: [(tag, pattern) for tag, pattern in resolvers
                if tag.rpartition(':')[2] not in ('int', 'float', 'timestamp', 'value')]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()}

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node; refuse an alias."""
        if self.check_event(yaml.AliasEvent):
            raise YamlError(f'{_place(self.peek_event().start_mark)}aliases are not allowed')
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping; refuse a key that stands in it twice."""
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


_INTEGER = re.compile(r'^(?:[-+]?[0-9]+|0x[0-9a-fA-F]+)$')
_FLOAT = re.compile(r'^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?'
                    r'|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$')
_Loader.add_implicit_resolver('tag:yaml.org,2002:int', _INTEGER, list('-+0123456789'))
_Loader.add_implicit_resolver('tag:yaml.org,2002:float', _FLOAT, list('-+.0123456789'))


def _integer(loader: _Loader, node: Any) -> int:
    text = str(loader.construct_scalar(node))
    return int(text, 16 if text.startswith('0x') else 10)


_Loader.add_constructor('tag:yaml.org,2002:int', _integer)


def parse(text: str) -> Any:
    """Return what a YAML text holds: dict, list, str, float, int, bool or None.

    Raises:
        YamlError: It is not YAML, or gives a key twice.
    """
    try:
        return yaml.load(text, _Loader)
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
