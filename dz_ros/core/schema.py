# SPDX-License-Identifier: Apache-2.0
"""One schema for configuration files, ROS parameters, command-line overrides and sweeps.

A group of parameters is a frozen dataclass whose fields are made by `parameter`: default, unit,
description, range. From that one declaration come validation (`build`), the ROS parameter
descriptors and the documentation. A group may define ``check(self, prefix)`` for rules that span
several fields; it raises `ConfigurationError`.

A field whose name is a Python keyword carries a trailing underscore (``lambda_``) and is written
without it everywhere outside the code (``controller.lambda``).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import dataclasses
from dataclasses import dataclass
import difflib
from functools import cache
import math
from typing import Any, get_type_hints, TypeVar

from dz_ros.core.renamed import KEYS
from dz_ros.errors import ConfigurationError

Group = TypeVar('Group')
_SPEC = 'dz_ros.parameter'


@dataclass(frozen=True)
class Spec:
    """Everything of a parameter but its name and type.

    Attributes:
        unit: ``'1'`` for dimensionless, ``''`` for names and flags.
        description: One sentence.
        minimum, maximum: Range allowed, inclusive; the minimum is excluded with `open_minimum`.
        choices: The only strings allowed; empty = any.
        length: The only length allowed of an array; 0 = any.
        structural: True where the value cannot change while a loop runs (order, model, rate).
    """

    unit: str
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf
    open_minimum: bool = False
    choices: tuple[str, ...] = ()
    length: int = 0
    structural: bool = False

    def range_text(self) -> str:
        """Return what is allowed as text, or an empty string."""
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        low = '' if self.minimum == -math.inf else (
            f'{">" if self.open_minimum else ">="} {self.minimum:g}')
        high = '' if self.maximum == math.inf else f'<= {self.maximum:g}'
        return ' and '.join(part for part in (low, high) if part)


@dataclass(frozen=True)
class Field:
    """One parameter of a group: its outside name, Python attribute, type, default and `Spec`."""

    name: str
    attribute: str
    kind: str
    default: Any
    spec: Spec

    @property
    def unit(self) -> str:
        """Unit as it is shown: a count, a seed or a number of something has none."""
        return '' if self.kind == 'int' and self.spec.unit == '1' else self.spec.unit


def parameter(default: Any, unit: str, description: str, **rules: Any) -> Any:
    """Declare a parameter of a frozen dataclass; `rules` are further fields of `Spec`."""
    return dataclasses.field(default=default, metadata={_SPEC: Spec(unit, description, **rules)})


_KINDS = {float: 'float', int: 'int', bool: 'bool', str: 'str',
          tuple[float, ...]: 'floats', tuple[str, ...]: 'strings'}
_WORDS = {'float': 'a finite number', 'int': 'an integer', 'bool': 'true or false',
          'str': 'a text', 'floats': 'a list of finite numbers', 'strings': 'a list of texts'}


def fields(group: type) -> tuple[Field, ...]:
    """Return the parameters of a group in order of declaration."""
    hashable: Any = group
    return _declared(hashable)


def is_group(group: Any) -> bool:
    """Return whether something is a group: a frozen dataclass whose parameters can be read."""
    try:
        fields(group)
        return isinstance(group, type) and bool(vars(group)['__dataclass_params__'].frozen)
    except Exception:  # noqa: BLE001  a user's own class
        return False


@cache
def _declared(group: Any) -> tuple[Field, ...]:
    """Return what `fields` does, found out once."""
    hints = get_type_hints(group)
    found = []
    for item in dataclasses.fields(group):
        spec = item.metadata.get(_SPEC)
        if spec is not None:
            found.append(Field(item.name.rstrip('_'), item.name, _KINDS[hints[item.name]],
                               item.default, spec))
    return tuple(found)


@cache
def names(group: Any) -> dict[str, Field]:
    """Return the parameters of a group by their outside names."""
    return {field.name: field for field in fields(group)}


def _convert(kind: str, value: Any) -> Any:
    """Return the value as its declared type; raise TypeError where it is another one."""
    if kind == 'bool':
        if isinstance(value, bool):
            return value
    elif kind == 'int':
        if isinstance(value, int) and not isinstance(value, bool):
            return value
        if isinstance(value, float) and value.is_integer():
            return int(value)
    elif kind == 'float':
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            number = float(value)
            if math.isfinite(number):
                return number
    elif kind == 'str':
        if isinstance(value, str):
            return value
    elif type(value) in (list, tuple) or (
            not isinstance(value, (str, bytes, Mapping)) and isinstance(value, Iterable)):
        return tuple(_convert('float' if kind == 'floats' else 'str', item) for item in value)
    raise TypeError(kind)


def check_value(field: Field, value: Any, key: str) -> Any:
    """Return the value converted to the field's type.

    Raises:
        ConfigurationError: Wrong type, not finite, out of range or not among the choices.
    """
    spec = field.spec
    if field.kind == 'float' and type(value) is float and spec.minimum < value < spec.maximum:
        return value        # most values; what is not finite is within no limits
    try:
        converted = _convert(field.kind, value)
    except (TypeError, OverflowError):
        raise ConfigurationError(key, value, _wanted(field)) from None
    if spec.choices and field.kind == 'str' and converted not in spec.choices:
        raise ConfigurationError(key, value, _wanted(field))
    if field.kind in ('float', 'int', 'floats'):
        for number in converted if field.kind == 'floats' else (converted,):
            too_low = number <= spec.minimum if spec.open_minimum else number < spec.minimum
            if too_low or number > spec.maximum:
                raise ConfigurationError(key, value, _wanted(field))
    if spec.length and len(converted) != spec.length:
        raise ConfigurationError(key, value,
                                 f'must be a list of {spec.length} numbers{_unit(spec)}')
    return converted


def _wanted(field: Field) -> str:
    """Return what a value of a field must be, as text."""
    limits = field.spec.range_text()
    if field.spec.choices and field.kind == 'str':
        return f'must be {limits}'
    return f'must be {_WORDS[field.kind]}{" " + limits if limits else ""}{_unit(field.spec)}'


def _unit(spec: Spec) -> str:
    return f' [{spec.unit}]' if spec.unit not in ('', '1') else ''


def unknown_key(key: str, value: Any, known: Iterable[str]) -> ConfigurationError:
    """Return the error for an undeclared key, with the nearest known one."""
    if key in KEYS:
        return ConfigurationError(key, value, f'is called {KEYS[key]} now')
    names = sorted(known)
    section = key.rpartition('.')[0] + '.' if '.' in key else ''
    close = 0.6
    if section and not any(name.startswith(section) for name in names):
        section, close = '', 0.8
    own = {name.removeprefix(section): name for name in names}  # a common prefix is no likeness
    near = difflib.get_close_matches(key.removeprefix(section), own, 1, close)
    if '.' not in key:      # a name without its section
        own = {name.rpartition('.')[2]: name for name in reversed(names)}
        near = difflib.get_close_matches(key, own, n=1)
    hint = (f'did you mean {own[near[0]]}?' if near else 'see dz list keys' if len(names) > 100
            else 'known: ' + ', '.join(names))
    return ConfigurationError(key, value, f'unknown key; {hint}')


def build(group: type[Group], values: Mapping[str, Any], prefix: str = '',
          base: Group | None = None) -> Group:
    """Make a group from the values given, defaults for the rest.

    Args:
        group: A frozen dataclass of `parameter` fields.
        values: Outside name → value. Every name must belong to the group.
        prefix: Section, ending in a dot, put before names in errors.
        base: A group of the same class, whose values are taken for the rest instead.

    Raises:
        ConfigurationError: Unknown key or a value that is not allowed.
    """
    if base is not None and not values:
        return base
    hashable: Any = group
    known = names(hashable)
    for name in values:
        if name not in known:
            raise unknown_key(prefix + name, values[name], (prefix + item for item in known))
    checked = {known[name].attribute: check_value(known[name], value, prefix + name)
               for name, value in values.items()}
    before: Any = base
    made: Group = group(**checked) if base is None else dataclasses.replace(before, **checked)
    check = getattr(made, 'check', None)
    if check is not None:
        check(prefix)
    return made


def shown(group: Any, most: int = 6) -> str:
    """Return parameters as ``name=value, …`` for a repr, the first ones of many."""
    def text(value: Any) -> str:
        if isinstance(value, list) and len(value) > most:
            return f'[{len(value)} numbers]'
        return f'{value:g}' if isinstance(value, float) else f'{value}'

    found = to_dict(group)
    words = [f'{name}={text(value)}' for name, value in list(found.items())[:most]]
    return ', '.join([*words, '…'] if len(found) > most else words)


def to_dict(group: Any) -> dict[str, Any]:
    """Return outside name → value of every parameter; arrays as lists."""
    found = {}
    for field in fields(type(group)):
        value = getattr(group, field.attribute)
        found[field.name] = list(value) if isinstance(value, tuple) else value
    return found
