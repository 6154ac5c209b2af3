"""Finding plants, trajectories, laws and drivers by name: ours, installed ones, ``module:Name``.

A package of yours adds its own by an entry point in the group ``dz_ros.plants``,
``dz_ros.trajectories``, ``dz_ros.laws`` or ``dz_ros.drivers`` (``name = package.module:Class``);
without installing anything, a configuration may name ``package.module:Class`` directly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import importlib
from importlib.metadata import entry_points
from typing import Any

from dz_ros.core import schema
from dz_ros.errors import UnknownNameError


@dataclass(frozen=True)
class Registry:
    """One kind of thing that configurations choose by name.

    Attributes:
        kind: Singular noun for messages, e.g. ``plant``.
        key: Configuration key that chooses, e.g. ``plant.model``.
        group: Entry-point group.
        base: Class the things derive from.
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

    def load(self, name: str) -> Any:
        """Return the class called `name`.

        Raises:
            UnknownNameError: No such name, it cannot be imported, it is something else, or it
                lacks something that every one must define, or its parameters are none.
        """
        target = self.builtin.get(name) or (name if ':' in name else self.installed().get(name))
        if isinstance(target, type):
            return target
        if target is None:
            known = ', '.join([*self.builtin, *self.installed()])
            raise UnknownNameError(self.key, name, f'no such {self.kind}; known: {known}; '
                                   'or give package.module:Class')
        module, _, attribute = target.partition(':')
        try:
            found = getattr(importlib.import_module(module), attribute)
        except Exception as error:  # the module is somebody else's code
            reason = ' '.join(f'{type(error).__name__}: {error}'.split())
            if isinstance(error, ModuleNotFoundError) and error.name == module.partition('.')[0]:
                reason += '; the folder that holds it must be on PYTHONPATH'
            raise UnknownNameError(self.key, name, f'cannot be loaded: {reason}') from error
        if not (isinstance(found, type) and issubclass(found, self.base)):
            raise UnknownNameError(self.key, name, f'is not a {self.base.__name__}')
        missing = sorted(item for item in self.base.__annotations__ if not hasattr(found, item))
        missing += sorted(getattr(found, '__abstractmethods__', ()))
        if missing:
            raise UnknownNameError(self.key, name, f'does not define {", ".join(missing)}')
        for item in ('Parameters', 'Gains'):
            if item in self.base.__annotations__ and not schema.is_group(getattr(found, item)):
                raise UnknownNameError(self.key, name, f'{item} must be a frozen dataclass of '
                                       'dz_ros.core.schema.parameter fields')
        return found

    def all(self) -> dict[str, Any]:
        """Return name → class, or → the error that keeps one from loading."""
        found: dict[str, Any] = {}
        for name in (*self.builtin, *self.installed()):
            try:
                found[name] = self.load(name)
            except UnknownNameError as error:
                found[name] = error
        return found
