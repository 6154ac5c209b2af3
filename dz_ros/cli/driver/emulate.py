# SPDX-License-Identifier: Apache-2.0
"""``dz driver emulate KIND``: an emulated device, as a process of its own."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import sys
from types import FrameType
from typing import Any

from dz_ros.cli.options import add_configuration, read_machine
from dz_ros.core import schema
from dz_ros.drivers.emulators import Emulator, EMULATORS, Fault
from dz_ros.errors import ConfigurationError, DzRosError
from dz_ros.files.configurations import shipped_configurations
from dz_ros.files.yaml12 import parse, YamlError
from dz_ros.runtime.os_signals import on_ends, restore_handlers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('kind', nargs='?', metavar='KIND',
                        help='device; see --list')
    add_configuration(parser, default=None, without='the shipped one named as KIND')
    parser.add_argument('--nodes', type=int, default=0, metavar='N',
                        help='emulate N devices, with the node ids of the axes of CONFIG, or 1 to '
                        'N (default: one for each axis)')
    parser.add_argument('-o', '--option', action='append', default=[], metavar='KEY=VALUE',
                        dest='options', help='an option of the device, the value as YAML')
    parser.add_argument('--fault', action='append', default=[], dest='faults',
                        metavar='[DEVICE:]NAME@START[+S][=VALUE]',
                        help='something that goes wrong, START s after the first command that '
                        'moves the device, for S s; DEVICE is an axis or node id, else each one; '
                        'may be repeated')
    parser.add_argument('--list', action='store_true',
                        help='list the devices, or the options and faults of one')


def run(arguments: argparse.Namespace) -> int:
    """Be the device until interrupted."""
    if arguments.kind is None:
        if not arguments.list:
            raise ConfigurationError('KIND', '', f'must be one of {", ".join(_names())}')
        for name, found in EMULATORS.all().items():
            print(f'{name:10} ' + (f'(not usable) {found}' if isinstance(found, DzRosError)
                                   else found.summary))
        return 0
    kind = EMULATORS.load(arguments.kind)
    if arguments.list:
        _describe(kind)
        return 0
    if arguments.config is None and kind.name in shipped_configurations():
        arguments.config = kind.name
    parameters = schema.build(kind.Parameters, _options(kind, arguments.options), '--option ')
    machine = read_machine(arguments)
    faults = [Fault.parse(text, kind.faults) for text in arguments.faults]
    if machine.axes or arguments.nodes:
        return _be(kind.of_axes(parameters, machine, arguments.nodes, faults))
    for text, fault in zip(arguments.faults, faults, strict=True):
        if fault.device:
            raise ConfigurationError('--fault', text, f'there is one device, no {fault.device}')
    return _be(kind(parameters, machine, faults))


def _names() -> list[str]:
    return [*EMULATORS.builtin, *EMULATORS.installed()]


def _options(kind: Any, texts: Sequence[str]) -> dict[str, Any]:
    """Return the options of a device as typed; texts are taken as they are."""
    kinds = {field.name: field.kind for field in schema.fields(kind.Parameters)}
    found: dict[str, Any] = {}
    for text in texts:
        key, equals, written = text.partition('=')
        if not equals:
            raise ConfigurationError('--option', text, 'must be KEY=VALUE')
        try:
            found[key] = written if kinds.get(key) == 'str' else parse(written)
        except YamlError as error:
            raise ConfigurationError(f'--option {key}', written,
                                     f'is not a YAML value: {error}') from None
    return found


def _describe(kind: Any) -> None:
    """Print options and faults of a device."""
    print(kind.summary)
    for field in schema.fields(kind.Parameters):
        unit = f' [{field.spec.unit}]' if field.spec.unit not in ('', '1') else ''
        print(f'  --option {field.name}=  {field.spec.description}{unit} '
              f'(default: {field.default!r})')
    for name, what in kind.faults.items():
        print(f'  --fault {name}@  {what}')


def _be(emulator: Emulator) -> int:
    """Run an emulator until a signal ends it."""
    ended = False

    def end(_number: int, _frame: FrameType | None) -> None:
        nonlocal ended
        ended = True

    previous = on_ends(end)
    try:
        print(emulator.open(), flush=True)
        emulator.run(lambda: ended, lambda text: print(text, flush=True))
    finally:
        emulator.close()
        restore_handlers(previous)
        sys.stdout.flush()
    return 0
