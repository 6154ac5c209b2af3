# SPDX-License-Identifier: Apache-2.0
"""Arguments that several verbs share.

Over 300 lines: each is declared, checked and read here alone.
"""

from __future__ import annotations

import argparse
import errno
import os
from pathlib import Path
import sys

from dz_ros.cli.progress import stage
from dz_ros.core.configuration import Configuration, every_field
from dz_ros.core.dataset import RunData
from dz_ros.errors import ConfigurationError, RunExistsError
from dz_ros.files.configurations import (
    foreign_sections,
    load_configuration,
    shipped_configurations,
)


def add_configuration(parser: argparse.ArgumentParser,
                      namespace: str = 'whose sections of CONFIG count, where it has some of '
                      'several loops', default: str | None = 'robust_eso',
                      without: str = '') -> None:
    """Declare CONFIG, --duration, --set and --namespace.

    Args:
        parser: Of the verb.
        namespace: What the ROS namespace of the loop is used for.
        default: CONFIG where none is given.
        without: What is taken where there is no default, for the help.
    """
    shown = default or without
    config = parser.add_argument(
        'config', nargs='?', default=default, metavar='CONFIG',
        help='configuration file, or the name of one that comes with dz_ros, see dz list '
             'configurations' + (f' (default: {shown})' if shown else ''))
    config.completer = _complete_configuration  # type: ignore[attr-defined]  # argcomplete's
    parser.add_argument('--duration', metavar='S',
                        help='length of the run [s], short for --set loop.duration=S')
    overrides = parser.add_argument(
        '--set', action='append', default=[], metavar='KEY=VALUE', dest='overrides',
        help='change one key of the configuration, the value as YAML, e.g. controller.lambda=2; '
             'may be repeated')
    overrides.completer = _complete_key  # type: ignore[attr-defined]
    parser.add_argument('--axis', metavar='NAME',
                        help='the axis that is meant, of a configuration of several (loop.axes)')
    parser.add_argument('--namespace', default='', metavar='NS',
                        help=f'ROS namespace of the loop, e.g. /left_valve: {namespace}')


def _complete_configuration(prefix: str, **_: object) -> list[str]:
    """Return the names of shipped configurations, and of files in the folder typed so far."""
    folder, name = os.path.split(prefix)
    there = Path(folder).iterdir() if Path(folder).is_dir() else ()
    files = [f'{item}/' if item.is_dir() else str(item) for item in there
             if item.name.startswith(name) and (item.is_dir() or item.suffix == '.yaml')]
    return [*(name for name in shipped_configurations() if name.startswith(prefix)), *files]


def _complete_key(prefix: str, **_: object) -> list[str]:
    """Return the keys that begin so, for ``KEY=VALUE``."""
    return [f'{key}=' for key in every_field() if key.startswith(prefix)]


def add_recording(parser: argparse.ArgumentParser, numbers: bool = False,
                  many: bool = False) -> None:
    """Declare RUN, --namespace and --allow-import.

    Args:
        parser: Of the verb.
        numbers: Declare --window and --pulse as well.
        many: RUN is two or more, `runs`.
    """
    what = 'directory of a run or of a rosbag2 bag, or its .mcap or .db3'
    if many:
        parser.add_argument('runs', type=Path, nargs='+', metavar='RUN',
                            help=f'{what}; two or more, or one of several axes')
    else:
        parser.add_argument('run', type=Path, metavar='RUN', help=what)
    if numbers:
        parser.add_argument('--window', type=float, nargs=2, metavar=('FROM', 'TO'),
                            help='instants the numbers are about [s] (default: the last 10 s, of '
                                 'a short run the last half)')
        parser.add_argument('--pulse', type=float, metavar='T',
                            help='instant of a disturbance to recover from [s]')
    add_allow_import(parser)
    parser.add_argument('--namespace', metavar='NS',
                        help='whose topics to read, where a run holds several loops')
    parser.add_argument('--axis', metavar='NAME',
                        help='the axis that is meant, of a run of several')


def read_one(arguments: argparse.Namespace, path: Path | None = None) -> RunData:
    """Return the run of RUN and --axis, of one axis.

    Args:
        arguments: Of the verb.
        path: Another run than RUN.

    Raises:
        RecordingError: It cannot be read, or has several axes and none was chosen.
    """
    from dz_ros.runs.axes import choose_axis

    return choose_axis(read_recording(arguments.run if path is None else path,
                                      arguments.namespace), arguments.axis)


def read_recording(path: Path, namespace: str | None = None) -> RunData:
    """Return a run as `dz_ros.recording.reader.read_run` does; its reading is a stage.

    Raises:
        RecordingError: It cannot be read.
    """
    from dz_ros.recording.reader import read_run

    with stage(f'reading {path}'):
        return read_run(path, namespace)


def read_chosen(arguments: argparse.Namespace, path: Path) -> RunData:
    """Return a run with all its axes, or its --axis alone.

    Raises:
        RecordingError: It cannot be read, or there is no such axis.
    """
    from dz_ros.runs.axes import axis_run

    run = read_recording(path, arguments.namespace)
    return run if arguments.axis is None else axis_run(run, arguments.axis)


def read_axes(arguments: argparse.Namespace) -> dict[str, RunData]:
    """Return axis → its run, of RUN: the one of --axis or all; a run of one axis is called ''.

    Raises:
        RecordingError: It cannot be read, or there is no such axis.
    """
    from dz_ros.runs.axes import each_axis

    return each_axis(read_chosen(arguments, arguments.run))


def window(arguments: argparse.Namespace) -> tuple[float, float] | None:
    """Return --window."""
    return None if arguments.window is None else (arguments.window[0], arguments.window[1])


def refuse_existing(path: Path | None, kind: str = 'directory') -> None:
    """Refuse to overwrite, and a directory that cannot be made, before anything starts.

    Raises:
        RunExistsError: There is something of that name.
        NotADirectoryError: What should hold the directory is a file.
        PermissionError: It may not be written to.
    """
    if path is not None and (path.exists() or path.is_symlink()):
        raise RunExistsError(f'{path}: exists already and is never overwritten; choose another '
                             f'{kind}')
    if path is not None and kind == 'directory':
        holder = next(item for item in path.absolute().parents if item.exists())
        if not holder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, 'no directory', str(holder))
        if not os.access(holder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, 'must be writable', str(holder))


def require_folder(path: Path) -> None:
    """Find out before computing anything whether a file could be written there.

    Raises:
        NotADirectoryError: Its folder does not exist.
    """
    if not path.absolute().parent.is_dir():
        raise NotADirectoryError(20, 'no such directory', str(path.absolute().parent))


def namespace_name(namespace: str) -> str:
    """Return --namespace without slashes around it.

    Raises:
        ConfigurationError: ROS does not allow it.
    """
    name = namespace.strip('/')
    if namespace and not all(part.isidentifier() and part.isascii() for part in name.split('/')):
        raise ConfigurationError('--namespace', namespace,
                                 'must be names of letters, digits and _ separated by /')
    return name


def add_allow_import(parser: argparse.ArgumentParser) -> None:
    """Declare --allow-import, for verbs that read recordings; `main` applies it."""
    parser.add_argument('--allow-import', action='append', default=[], metavar='MODULE',
                        help='import this module, and those below it, where the configuration of '
                             'a recording names a class of it; that runs its code; may be '
                             'repeated (default: built-in and installed names only)')


def add_address(parser: argparse.ArgumentParser) -> None:
    """Declare --host and --port of the page in the browser."""
    parser.add_argument('--host', default='127.0.0.1', metavar='ADDRESS',
                        help='where the page is to be reached; another address than this '
                             "machine's own 127.0.0.1 asks everybody for the printed token")
    parser.add_argument('--port', type=int, default=0, metavar='N',
                        help='port of the page (default: the first free one from 8420 on)')


def check_address(arguments: argparse.Namespace, page: bool) -> None:
    """Refuse --host and --port where no page could be served, before anything is started.

    Args:
        arguments: They hold both.
        page: Whether a page is to be served; else only a port that is none is refused.

    Raises:
        ConfigurationError: The port is none or taken, or the host not this machine's.
    """
    host, port = arguments.host.strip('[]'), arguments.port
    if not 0 <= port <= 65535:
        raise ConfigurationError('--port', port, 'must be from 1 to 65535, 0 = the first free one '
                                 'from 8420 on')
    if not page:
        return
    import socket

    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM) if host else []
    except (OSError, UnicodeError):
        found = []
    usable = False      # one address is enough: a name may have one of IPv6, which may be off
    for family, kind, protocol, _, address in found:
        try:
            with socket.socket(family, kind, protocol) as tried:
                tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                tried.bind(address)
            usable = True
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                raise ConfigurationError('--port', port, f'cannot be served: {error.strerror}'
                                         ) from None
    if not usable:
        raise ConfigurationError('--host', arguments.host, 'must be an address or name of this '
                                 'machine, 0.0.0.0 for all of them')


def configuration_overrides(arguments: argparse.Namespace) -> list[str]:
    """Return --set and --duration as texts ``KEY=VALUE``."""
    overrides = list(arguments.overrides)
    if arguments.duration is not None:
        overrides.append(f'loop.duration={arguments.duration}')
    return overrides


def read_configuration(arguments: argparse.Namespace) -> Configuration:
    """Return the configuration of one axis asked for; note typed keys that it does not use.

    Raises:
        ConfigurationError: It cannot be used, or is of several axes and none was chosen.
    """
    return one_axis(read_all_axes(arguments), arguments.axis)


def one_axis(machine: Configuration, axis: str | None) -> Configuration:
    """Return the configuration of one axis.

    Raises:
        ConfigurationError: There are several and none was chosen, or there is no such axis.
    """
    if axis is not None:
        return machine.axis(axis)
    if machine.axes:
        raise ConfigurationError('loop.axes', list(machine.axis_names),
                                 'this is done for one axis; choose it with --axis')
    return machine


def read_machine(arguments: argparse.Namespace) -> Configuration:
    """Return the configuration asked for, of all its axes or of --axis; notes as above.

    Raises:
        ConfigurationError: It cannot be used, or there is no such axis.
    """
    configuration = read_all_axes(arguments)
    return configuration if arguments.axis is None else configuration.axis(arguments.axis)


def read_all_axes(arguments: argparse.Namespace) -> Configuration:
    """Return the configuration asked for, of all its axes whatever --axis; notes as above.

    Raises:
        ConfigurationError: It cannot be used.
    """
    overrides = configuration_overrides(arguments)
    configuration = load_configuration(arguments.config, overrides, arguments.namespace)
    if arguments.config is not None:
        aside = foreign_sections(arguments.config, arguments.namespace)
        if aside:
            print(f'dz: note: {arguments.config}: sections of other nodes are left aside: '
                  f'{", ".join(aside)}', file=sys.stderr)
    typed = {override.partition('=')[0].strip() for override in overrides}
    for note in configuration.misfit_notes:
        print(f'dz: note: {note}', file=sys.stderr)
    for key in configuration.set_aside:
        if key in typed:
            print(f'dz: note: {key} is set aside: {configuration.plant.name}, '
                  f'{configuration.law.name} and {configuration.trajectory.name} do not use it',
                  file=sys.stderr)
    return configuration
