# SPDX-License-Identifier: Apache-2.0
"""Configurations in files: ROS parameter files in, checked configurations out, and back.

A file is what ROS nodes take with ``--params-file`` (``/**: ros__parameters: …``, or sections
with names of nodes and wildcards, matched as ROS does: ``files/parameter_sections.py``), or its
bare sections ``loop``, ``plant``, ``controller``, ``trajectory``. Nested keys become dotted
ones. A name without a path, such as ``wang2004``, means the configuration of that name that
comes with the package.

``trajectory.file`` names a CSV file of way-points, columns t [s] and x [unit of x], read into
``trajectory.times`` and ``trajectory.positions``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
import json
import os
from pathlib import Path
from typing import Any

from dz_ros.core.axes_keys import is_machines, parts
from dz_ros.core.configuration import Configuration
from dz_ros.core.schema import fields
from dz_ros.errors import ConfigurationError, suggestion
from dz_ros.files.parameter_sections import foreign, loop_parameters, sections
from dz_ros.files.waypoints import KEY as WAYPOINTS
from dz_ros.files.waypoints import read_waypoints
from dz_ros.files.yaml12 import parse, parse_file, YamlError

PACKAGE = 'dz_ros'
ROS_OWN = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
"""Parameters that every ROS node has: not ours, so left to the nodes."""


def load_configuration(path: Path | str | None, overrides: Sequence[str] = (),
                       namespace: str = '') -> Configuration:
    """Return the configuration of a file, or the default one, with ``KEY=VALUE`` overrides.

    Args:
        path: File, or name of a shipped configuration; None = none.
        overrides: ``KEY=VALUE``, as of `flat_parameters`.
        namespace: Namespace of the loop's nodes.

    Raises:
        ConfigurationError: The file, a key or a value cannot be used, and why.
    """
    return Configuration.from_changed(flat_parameters(path, (), namespace),
                                      flat_parameters(None, overrides))


def flat_parameters(path: Path | str | None, overrides: Sequence[str] = (),
                    namespace: str = '') -> dict[str, Any]:
    """Return the dotted keys a file and overrides give, unchecked but for their form.

    Args:
        path: File, or name of a shipped configuration; None = none.
        overrides: ``KEY=VALUE``, values as YAML; paths in them are relative to the working
            directory, those in a file to that file.
        namespace: Namespace of the loop's nodes; sections of other nodes are left out.

    Raises:
        ConfigurationError: Unreadable file, YAML or CSV, key given twice, malformed override, a
            file that has sections for other nodes only.
    """
    flat: dict[str, Any] = {}
    if path is not None:
        found = find_configuration(path)
        flat = _loop_keys(found, namespace)
        resolve_waypoints(flat, found.parent)
    typed: dict[str, Any] = {}
    for override in overrides:
        typed.update(_parse_override(override))
    resolve_waypoints(typed, Path())
    return {**flat, **typed}


def write_parameters(configuration: Configuration, path: Path) -> None:
    """Write a configuration as a ROS parameter file for every node; the file must not exist.

    Raises:
        FileExistsError: It does.
    """
    with path.open('x', encoding='utf-8') as file:
        file.write(format_parameters(configuration))


def format_parameters(configuration: Configuration) -> str:
    """Return a configuration as the text of a ROS parameter file for every node.

    Floats keep their type and every digit. Empty arrays are left out where they are the default,
    since rcl refuses them to a node that declares all it is given. Of several axes each has all
    its keys, so there are none for all of them beside the machine's.
    """
    tree: dict[str, Any] = {}
    cleared = {f'loop.{item.name}' for item in fields(type(configuration.loop)) if item.default}
    for key, value in configuration.to_flat().items():
        if value == [] and key not in cleared:
            continue
        if configuration.axes and not parts(key)[0] and not is_machines(key):
            continue
        *parents, name = key.split('.')
        branch = tree
        for parent in parents:
            branch = branch.setdefault(parent, {})
        branch[name] = value
    return '\n'.join(_yaml_lines({'/**': {'ros__parameters': tree}}, '')) + '\n'


def configuration_folders() -> list[Path]:
    """Return where shipped configurations lie: source tree, install prefix, ament prefixes."""
    package = Path(__file__).parents[1]
    candidates = [package.parent / 'config']
    candidates += [parent / 'share' / PACKAGE / 'config' for parent in package.parents[1:6]]
    candidates += [Path(prefix) / 'share' / PACKAGE / 'config'
                   for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
                   if prefix]
    return [folder for folder in dict.fromkeys(candidates) if folder.is_dir()]


def shipped_configurations() -> dict[str, Path]:
    """Return name → file of the configurations that come with the package, sorted by name."""
    found: dict[str, Path] = {}
    for folder in configuration_folders():
        for file in folder.glob('*.yaml'):
            found.setdefault(file.stem, file)
    return dict(sorted(found.items()))


def find_configuration(path: Path | str) -> Path:
    """Return the file meant by a path, or by the bare name of a shipped configuration.

    Raises:
        ConfigurationError: No such file or name.
    """
    path = Path(path).expanduser()
    if path.is_file():
        return path
    if path.is_dir():
        raise _file_error(path, 'is a directory, not a file')
    shipped = shipped_configurations()
    if path.name == str(path) and path.name.removesuffix('.yaml') in shipped:
        return shipped[path.name.removesuffix('.yaml')]
    names = ', '.join(shipped) or 'none'
    raise _file_error(path, f'no such file; shipped configurations: {names}'
                      + suggestion(path.name.removesuffix('.yaml'), shipped))


def _file_error(path: Path, problem: str) -> ConfigurationError:
    return ConfigurationError('configuration file', str(path), problem)


def foreign_sections(path: Path | str, namespace: str = '') -> list[str]:
    """Return the names of a file's sections that are for no node of a loop in a namespace.

    Raises:
        ConfigurationError: As `flat_parameters`.
    """
    found = find_configuration(path)
    return foreign(sections(_read_file(found), partial(_file_error, found)), namespace)


def _read_file(path: Path) -> dict[Any, Any]:
    """Return the mapping that a parameter file holds."""
    try:
        content = parse_file(path)
    except OSError as error:
        raise _file_error(path, f'cannot be read: {error.strerror}') from error
    except YamlError as error:
        raise _file_error(path, str(error)) from None
    if not isinstance(content, dict):
        raise _file_error(path, 'is empty' if content is None
                          else 'must be a YAML mapping of sections')
    return content


def _loop_keys(path: Path, namespace: str) -> dict[str, Any]:
    """Return the dotted keys of a parameter file that a loop's nodes in a namespace take."""
    def flatten(tree: Mapping[str, Any]) -> dict[str, Any]:
        own: dict[str, Any] = {}
        for key, value in _flatten(tree, '', path):
            if key in own:
                raise ConfigurationError(key, value, f'is given twice in {path}')
            if key.partition('.')[0] not in ROS_OWN:
                own[key] = value
        return own

    content = _read_file(path)
    fail = partial(_file_error, path)
    found = sections(content, fail)
    return loop_parameters(found, namespace, flatten, fail) if found else flatten(content)


def _flatten(tree: Mapping[Any, Any], prefix: str, path: Path) -> Iterator[tuple[str, Any]]:
    """Yield (dotted key, value) of a nested mapping."""
    for name, value in tree.items():
        key = f'{prefix}{name}'
        if isinstance(value, dict):
            yield from _flatten(value, f'{key}.', path)
        elif value is None:
            raise ConfigurationError(key, value, f'has no value in {path}')
        else:
            yield key, value


def _parse_override(text: str) -> dict[str, Any]:
    """Return the dotted keys of one ``KEY=VALUE``; a YAML mapping gives several."""
    key, equals, written = text.partition('=')
    key = key.strip()
    if not equals or not key:
        raise ConfigurationError('--set', text, 'must be KEY=VALUE, e.g. controller.lambda=2')
    try:
        value = parse(written)
    except YamlError as error:
        raise ConfigurationError(key, written, f'is not a YAML value: {error}') from None
    if value is None:
        raise ConfigurationError('--set', text, 'gives no value; write KEY=VALUE')
    return dict(_flatten({key: value}, '', Path('--set')))


def resolve_waypoints(flat: dict[str, Any], folder: Path) -> None:
    """Replace ``trajectory.file``, also of an axis, by the times and positions the CSV holds."""
    for key in [key for key in flat if parts(key)[1] == WAYPOINTS]:
        name = flat.pop(key)
        if name == '':
            continue
        if not isinstance(name, str):
            raise ConfigurationError(key, name, 'must be the path of a CSV file')
        prefix = key.removesuffix(WAYPOINTS)
        for other in ('trajectory.times', 'trajectory.positions'):
            if flat.get(f'{prefix}{other}'):
                raise ConfigurationError(f'{prefix}{other}', flat[f'{prefix}{other}'],
                                         f'is given beside {key}; leave one out')
        times, positions = read_waypoints(folder / Path(name).expanduser(), key)
        flat[f'{prefix}trajectory.times'] = times
        flat[f'{prefix}trajectory.positions'] = positions


def _yaml_lines(tree: Mapping[str, Any], indent: str) -> Iterator[str]:
    """Yield the lines of a nested mapping in the YAML that both rcl and PyYAML read alike."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield f'{indent}{key}:'
            yield from _yaml_lines(value, f'{indent}  ')
        elif isinstance(value, list):
            yield f'{indent}{key}: [{", ".join(_scalar(item) for item in value)}]'
        else:
            yield f'{indent}{key}: {_scalar(value)}'


def _scalar(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)    # quoted: never taken for a bool
    if isinstance(value, float):
        mantissa, _, exponent = repr(value).partition('e')
        if '.' not in mantissa:
            mantissa += '.0'
        return f'{mantissa}e{exponent}' if exponent else mantissa
    return str(value).lower() if isinstance(value, bool) else str(value)
