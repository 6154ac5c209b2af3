# SPDX-License-Identifier: Apache-2.0
"""Finding plants, trajectories, laws and drivers by name: ours, installed ones, ``module:Name``.

A package of yours adds its own by an entry point in the group ``dz_ros.plants``,
``dz_ros.trajectories``, ``dz_ros.laws`` or ``dz_ros.drivers`` (``name = package.module:Class``);
without installing anything, a configuration may name ``package.module:Class`` directly.

To import a module is to run it. So a name of the second kind is followed only where the user gave
it: in a file, an option, a parameter of a node. In a configuration that a recording or a message
holds it is data: `Registry.check_untrusted` refuses it unless `allow_import` named its module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import importlib
from importlib.metadata import entry_points
from typing import Any

from dz_ros.core import schema
from dz_ros.core.text import LONGEST, printable
from dz_ros.errors import ImportRefusedError, suggestion, UnknownNameError

_allowed: set[str] = set()
_added: dict[tuple[str, str], type] = {}
"""(Entry-point group, name) → class that this process added."""


def allow_import(*names: str) -> None:
    """Let recordings and messages name these modules, and those below them, from now on.

    Args:
        *names: ``package.module``; of ``package.module:Class`` the module counts.
    """
    _allowed.update(name.partition(':')[0] for name in names)


def import_allowed(module: str) -> bool:
    """Return whether `allow_import` named a module or one it lies in."""
    return any(module == item or module.startswith(f'{item}.') for item in _allowed if item)


def failure(error: BaseException) -> str:
    """Return in one line what code of a user's own raised, `SystemExit` included."""
    return printable(' '.join(f'{type(error).__name__}: {error}'.split()).rstrip(': '), LONGEST)


@dataclass(frozen=True)
class Registry:
    """One kind of thing that configurations choose by name.

    Attributes:
        kind: Singular noun for messages, e.g. ``plant``.
        key: Configuration key that chooses, e.g. ``plant.model``.
        group: Entry-point group.
        base: Class the things derive from, or protocol of what they must define.
        builtin: Name → class, or → ``module:Class`` loaded when asked for; those of dz_ros.
    """

    kind: str
    key: str
    group: str
    base: type
    builtin: Mapping[str, Any]

    def installed(self) -> dict[str, str]:
        """Return name → ``module:Class`` of those that other packages bring."""
        return {point.name: point.value for point in entry_points(group=self.group)
                if point.name not in self.builtin}

    def check_untrusted(self, name: Any) -> None:
        """Refuse a name from a recording or a message that would import a module of its choice.

        Raises:
            ImportRefusedError: ``module:Class``, and no `allow_import` for that module.
            UnknownNameError: It is no text.
        """
        if name is not None and not isinstance(name, str):
            raise UnknownNameError(self.key, name, f'must be the name of a {self.kind}')
        if isinstance(name, str) and ':' in name and name not in self.builtin:
            module = name.partition(':')[0]
            if not import_allowed(module):
                raise ImportRefusedError(self.key, name, module)

    def add(self, item: type) -> str:
        """Let configurations of this process choose a class by its name; return the name.

        Raises:
            UnknownNameError: It is something else, lacks what every one must define, or another
                class has its name.
        """
        self._require(item, str(item))
        name = str(getattr(item, 'name', '') or item.__name__)
        if self.builtin.get(name) is item:
            return name
        if name in self.builtin or name in self.installed():
            raise UnknownNameError(self.key, name, f'is the name of another {self.kind}')
        _added[self.group, name] = item
        return name

    def load(self, name: str) -> Any:
        """Return the class called `name`.

        Raises:
            UnknownNameError: No such name, it cannot be imported, it is something else, or it
                lacks something that every one must define, or its parameters are none.
        """
        target = self.builtin.get(name) or _added.get((self.group, name)) or (
            name if ':' in name else self.installed().get(name))
        if isinstance(target, type):
            return target
        if target is None:
            known = [*self.builtin, *self.installed()]
            hint = suggestion(name, known)
            raise UnknownNameError(self.key, name, f'no such {self.kind}{hint}; '
                                   f'known: {", ".join(known)}; or give package.module:Class')
        module, _, attribute = target.partition(':')
        try:
            found = getattr(importlib.import_module(module), attribute)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            reason = failure(error)
            if isinstance(error, ModuleNotFoundError) and error.name == module.partition('.')[0]:
                reason += '; the folder that holds it must be on PYTHONPATH'
            raise UnknownNameError(self.key, name, f'cannot be loaded: {reason}') from error
        self._require(found, name)
        return found

    def _require(self, found: Any, name: str) -> None:
        """Refuse what is not a class of this kind, or lacks something."""
        protocol = getattr(self.base, '_is_protocol', False)    # then what it defines is all
        if not (isinstance(found, type) and (protocol or issubclass(found, self.base))):
            raise UnknownNameError(self.key, name, f'is not a {self.base.__name__}')
        missing = sorted(item for item in self.base.__annotations__ if not hasattr(found, item))
        missing += sorted(getattr(found, '__abstractmethods__', ()))
        if missing:
            raise UnknownNameError(self.key, name, f'does not define {", ".join(missing)}')
        for item in ('Parameters', 'Gains'):
            if item in self.base.__annotations__ and not schema.is_group(getattr(found, item)):
                raise UnknownNameError(self.key, name, f'{item} must be a frozen dataclass of '
                                       'dz_ros.core.schema.parameter fields')

    def all(self) -> dict[str, Any]:
        """Return name → class, or → the error that keeps one from loading."""
        found: dict[str, Any] = {}
        for name in (*self.builtin, *self.installed()):
            try:
                found[name] = self.load(name)
            except UnknownNameError as error:
                found[name] = error
        return found
