"""Configurations in files: ROS parameter files in, checked configurations out, and back.

A file is what ROS nodes take with ``--params-file`` (``/**: ros__parameters: …``, or sections
with node names, merged in the order of the file), or its bare sections ``loop``, ``plant``,
``controller``, ``trajectory``. Nested keys become dotted ones. A name without a path, such as
``wang2004``, means the configuration of that name that comes with the package.

``trajectory.file`` names a CSV file of way-points, columns t [s] and x [unit of x], read into
``trajectory.times`` and ``trajectory.positions``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import json
import os
from pathlib import Path
from typing import Any

from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError
from dz_ros.waypoints import KEY as WAYPOINTS
from dz_ros.waypoints import read_waypoints
from dz_ros.yaml12 import parse, YamlError

PACKAGE = 'dz_ros'
ROS_OWN = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
"""Parameters that every ROS node has: not ours, so left to the nodes."""


def load_configuration(path: Path | str | None, overrides: Sequence[str] = ()) -> Configuration:
    """Return the configuration of a file, or the default one, with ``KEY=VALUE`` overrides.

    Raises:
        ConfigurationError: The file, a key or a value cannot be used; one line says why.
    """
    return Configuration.from_flat(flat_parameters(path, overrides))


def flat_parameters(path: Path | str | None, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Return the dotted keys a file and overrides give, unchecked but for their form.

    Args:
        path: File, or name of a shipped configuration; None = none.
        overrides: ``KEY=VALUE``, values as YAML; paths in them are relative to the working
            directory, those in a file to that file.

    Raises:
        ConfigurationError: Unreadable file, YAML or CSV, key given twice, malformed override.
    """
    flat: dict[str, Any] = {}
    if path is not None:
        found = find_configuration(path)
        flat = _read_file(found)
        resolve_waypoints(flat, found.parent)
    typed: dict[str, Any] = {}
    for override in overrides:
        typed.update(_parse_override(override))
    resolve_waypoints(typed, Path())
    return {**flat, **typed}


def write_parameters(configuration: Configuration, path: Path) -> None:
    """Write a configuration as a ROS parameter file for every node.

    Floats keep their type and every digit. Empty arrays, which ROS cannot express, are left out:
    they are defaults. The file must not exist.

    Raises:
        FileExistsError: It does.
    """
    tree: dict[str, Any] = {}
    for key, value in configuration.to_flat().items():
        if isinstance(value, list) and not value:
            continue
        *parents, name = key.split('.')
        branch = tree
        for parent in parents:
            branch = branch.setdefault(parent, {})
        branch[name] = value
    lines = _yaml_lines({'/**': {'ros__parameters': tree}}, '')
    with path.open('x', encoding='utf-8') as file:
        file.write('\n'.join(lines) + '\n')


def configuration_folders() -> list[Path]:
    """Return where shipped configurations lie: source tree, install prefix, ament prefixes."""
    package = Path(__file__).parent
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
    raise _file_error(path, f'no such file; shipped configurations: {names}')


def _file_error(path: Path, problem: str) -> ConfigurationError:
    return ConfigurationError('configuration file', str(path), problem)


def _read_file(path: Path) -> dict[str, Any]:
    """Return the dotted keys of a parameter file."""
    try:
        content = parse(path.read_text(encoding='utf-8'))
    except UnicodeDecodeError:
        raise _file_error(path, 'is not a text file in UTF-8') from None
    except OSError as error:
        raise _file_error(path, f'cannot be read: {error.strerror}') from error
    except YamlError as error:
        raise _file_error(path, str(error)) from None
    if not isinstance(content, dict):
        raise _file_error(path, 'is empty' if content is None
                          else 'must be a YAML mapping of sections')
    sections = list(_node_sections(content, path))
    flat: dict[str, Any] = {}
    for section in sections or [content]:
        own: dict[str, Any] = {}
        for key, value in _flatten(section, '', path):
            if key in own:
                raise ConfigurationError(key, value, f'is given twice in {path}')
            if key.partition('.')[0] not in ROS_OWN:
                own[key] = value
        flat.update(own)
    return flat


def _node_sections(content: Mapping[str, Any], path: Path) -> Iterator[Mapping[str, Any]]:
    """Yield the ``ros__parameters`` of every node or wildcard, in order; none in a bare file."""
    bare: list[str] = []
    found = False
    for name, value in content.items():
        if isinstance(value, dict) and 'ros__parameters' in value:
            parameters = value['ros__parameters']
            if not isinstance(parameters, dict):
                raise _file_error(path, f'ros__parameters of {name} must be a mapping')
            if len(value) > 1:
                raise _file_error(path, f'{name}: indent its keys below ros__parameters')
            found = True
            yield parameters
        elif isinstance(value, dict) and any(
                isinstance(item, dict) and 'ros__parameters' in item for item in value.values()):
            found = True        # namespace: node: ros__parameters:
            yield from _node_sections(value, path)
        else:
            bare.append(str(name))
    if found and bare:
        raise _file_error(path, f'{bare[0]}: stands beside ros__parameters sections, not in one')


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
    """Replace ``trajectory.file`` by the times and positions the CSV holds."""
    name = flat.pop(WAYPOINTS, '')
    if name == '':
        return
    if not isinstance(name, str):
        raise ConfigurationError(WAYPOINTS, name, 'must be the path of a CSV file')
    for key in ('trajectory.times', 'trajectory.positions'):
        if flat.get(key):
            raise ConfigurationError(key, flat[key], f'is given beside {WAYPOINTS}; leave one out')
    times, positions = read_waypoints(folder / Path(name).expanduser())
    flat['trajectory.times'] = times
    flat['trajectory.positions'] = positions


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
