# SPDX-License-Identifier: Apache-2.0
"""Sections of a ROS parameter file and the nodes they are for, matched as rcl and rclpy match.

A section's name is a fully qualified node name, written at once (``/left/controller_node``) or
nested (``/left: controller_node:``); a first ``/`` may be left out. ``*`` replaces one part of
it, ``**`` any number of parts, none included. Each node takes the sections that match its name, a
later one before an earlier one; a name that stands twice keeps its first place. Order alone
counts: a wildcard that comes later replaces what an exact name gave.

A verb of ``dz`` runs one configuration for the whole loop, so `loop_parameters` collects what the
nodes of a loop would be given. Where two are given different values for one key, the node whose
section it is decides (`OWNERS`); for a section of several nodes that is an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import re
from typing import Any

from dz_ros.core.axes_keys import section_of

ROLES: Mapping[str, tuple[str, ...]] = {
    'actuator': ('plant_node', 'actuator_node'), 'controller': ('controller_node',),
    'trajectory': ('trajectory_node',)}
"""Part in the loop → names of the nodes that play it: of the first, one of the two runs."""
OWNERS: Mapping[str, tuple[str, ...]] = {
    'plant': ('actuator',), 'driver': ('actuator',), 'controller': ('controller',),
    'trajectory': ('trajectory',)}
"""Section of the configuration → the part whose node decides; any other belongs to all."""
BESIDE = ('recorder_node', 'replay_node', 'live_node', 'foxglove_node')
"""Nodes that go with a loop and have no section of its configuration."""

_NAME = re.compile(r'/?(?:(?:\*{1,2}|[A-Za-z_][A-Za-z0-9_]*)/)*(?:\*{1,2}|[A-Za-z_][A-Za-z0-9_]*)')
Fail = Callable[[str], Exception]
"""Makes the error of a file that cannot be used."""
Flatten = Callable[[Mapping[str, Any]], dict[str, Any]]
"""Returns the dotted keys of nested parameters."""


@dataclass(frozen=True)
class Section:
    """Parameters for some nodes.

    Attributes:
        name: As written, its parts joined by ``/``.
        parameters: Nested parameters; of a name that stands twice, each by itself.
    """

    name: str
    parameters: tuple[Mapping[str, Any], ...]

    def matches(self, node: str) -> bool:
        """Return whether the section is for a node, given by its fully qualified name."""
        parts = node.split('/')[1:]
        taken = [True] + [False] * len(parts)   # may what is written so far mean the first k parts
        for word in self.name.removeprefix('/').split('/'):
            if word == '**':
                first = taken.index(True) if True in taken else len(taken)
                taken = [place >= first for place in range(len(taken))]
            else:
                taken = [False, *(before and word in ('*', part)
                                  for before, part in zip(taken, parts, strict=False))]
        return taken[-1]


def sections(content: Mapping[Any, Any], fail: Fail) -> list[Section]:
    """Return the sections of a file in the order in which they count; none in a bare file.

    Raises:
        Exception: What `fail` makes: sections and other keys mixed, a name that ROS refuses.
    """
    found: dict[str, list[Mapping[str, Any]]] = {}
    bare: list[str] = []
    for name, parameters in _named(content, '', bare, fail):
        found.setdefault(name, []).append(parameters)
    if found and bare:
        raise fail(f'{bare[0]}: stands beside ros__parameters sections, not in one')
    for name in found:
        if not _NAME.fullmatch(name):
            raise fail(f'{name}: is no name of a node; letters, digits, _, the wildcards * and ** '
                       'and single / are')
    return [Section(name, tuple(given)) for name, given in found.items()]


def _named(content: Mapping[Any, Any], prefix: str, bare: list[str],
           fail: Fail) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield (name, parameters) of every section; keep keys that are none in `bare`."""
    for key, value in content.items():
        name = f'{prefix}{key}'
        if isinstance(value, dict) and 'ros__parameters' in value:
            parameters = value['ros__parameters']
            if not isinstance(parameters, dict):
                raise fail(f'ros__parameters of {name} must be a mapping')
            if len(value) > 1:
                raise fail(f'{name}: indent its keys below ros__parameters')
            yield name, parameters
        elif isinstance(value, dict) and _holds_sections(value):
            yield from _named(value, f'{name}/', bare, fail)
        else:
            bare.append(name)


def _holds_sections(tree: Mapping[Any, Any]) -> bool:
    """Return whether there is a ros__parameters anywhere in nested mappings."""
    return any(isinstance(value, dict) and ('ros__parameters' in value or _holds_sections(value))
               for value in tree.values())


def qualified(node: str, namespace: str) -> str:
    """Return the fully qualified name of a node in a namespace, '' or '/' = the root."""
    return '/' + '/'.join([*filter(None, namespace.split('/')), node])


def node_parameters(found: Sequence[Section], nodes: Sequence[str],
                    flatten: Flatten) -> dict[str, Any]:
    """Return the dotted keys that a node of one of these fully qualified names is given."""
    given: dict[str, Any] = {}
    for section in found:
        if any(section.matches(node) for node in nodes):
            for parameters in section.parameters:
                given.update(flatten(parameters))
    return given


def foreign(found: Sequence[Section], namespace: str) -> list[str]:
    """Return the names of the sections that are for no node of a loop in this namespace."""
    nodes = [qualified(node, namespace) for node in (*sum(ROLES.values(), ()), *BESIDE)]
    return [section.name for section in found if not any(map(section.matches, nodes))]


def loop_parameters(found: Sequence[Section], namespace: str, flatten: Flatten,
                    fail: Fail) -> dict[str, Any]:
    """Return the dotted keys that the nodes of a loop in this namespace are given, together.

    Raises:
        Exception: What `fail` makes: no section is for one of them, or two nodes are to have
            different values of what all of them use.
    """
    given = {role: node_parameters(found, [qualified(node, namespace) for node in nodes], flatten)
             for role, nodes in ROLES.items()}
    if found and not any(section.matches(qualified(node, namespace)) for section in found
                         for nodes in ROLES.values() for node in nodes):
        raise fail(f'has no section for a node of the loop in namespace /{namespace.strip("/")}, '
                   f'only for {", ".join(section.name for section in found)}; name the loop '
                   'with --namespace')
    flat: dict[str, Any] = {}
    for key in dict.fromkeys(key for keys in given.values() for key in keys):
        values = {role: keys[key] for role, keys in given.items() if key in keys}
        owners = [role for role in OWNERS.get(section_of(key), ()) if role in values]
        first, *others = owners or values
        for other in others:
            # One that is not even equal to itself (.nan) is refused where it is checked.
            if values[other] != values[first] and repr(values[other]) != repr(values[first]):
                raise fail(f'{key} = {values[first]!r} for {ROLES[first][0]} and '
                           f'{values[other]!r} for {ROLES[other][0]}: must be one value, the '
                           'loop has one configuration')
        flat[key] = values[first]
    return flat
