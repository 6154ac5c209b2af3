# SPDX-License-Identifier: Apache-2.0
"""Arguments of our launch files, checked: texts to values, a mistake named in one line (ours).

The ROS-free part of `launch/*.launch.py`, which pass every argument through it.
"""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
from pathlib import Path
import re
from typing import Any

import yaml

from dz_ros.core.axes_keys import AXES
from dz_ros.core.configuration import Configuration
from dz_ros.core.driven import DRIVERS
from dz_ros.errors import ConfigurationError, LaunchArgumentError
from dz_ros.files.configurations import find_configuration, load_configuration

WORDS = {'true': True, 'yes': True, 'on': True, '1': True,
         'false': False, 'no': False, 'off': False, '0': False}
_NAME = '[A-Za-z_][A-Za-z0-9_]*'
NAMESPACE = re.compile(f'/|/?{_NAME}(/{_NAME})*')
TOPIC = re.compile(f'~?/?{_NAME}(/{_NAME})*')


class LaunchArguments:
    """The arguments of a launch as typed; each method raises LaunchArgumentError for a wrong one.

    Args:
        given: Name → text; an empty text stands for the default.
    """

    def __init__(self, given: Mapping[str, str]) -> None:
        self._given = given

    def text(self, name: str) -> str:
        """Return an argument as it was typed, without the blanks around it."""
        return self._given[name].strip()

    def wrong(self, name: str, allowed: str) -> LaunchArgumentError:
        """Return the error that names an argument, its value and what is allowed."""
        return LaunchArgumentError(name, self._given[name], allowed)

    def number(self, name: str, unit: str, above: float | None = None) -> float:
        """Return an argument that is a number [unit], at least 0, or greater than `above`."""
        limit = 'at least 0' if above is None else f'greater than {above:g}'
        allowed = f'must be a number of {unit}, {limit}' if unit else f'must be a number, {limit}'
        try:
            value = float(self.text(name))
        except ValueError:
            raise self.wrong(name, allowed) from None
        if not math.isfinite(value) or (value < 0.0 if above is None else value <= above):
            raise self.wrong(name, allowed)
        return value

    def flag(self, name: str) -> bool:
        """Return an argument that is true or false."""
        found = WORDS.get(self.text(name).lower())
        if found is None:
            raise self.wrong(name, 'must be true or false')
        return found

    def namespace(self, name: str = 'namespace') -> str:
        """Return a namespace of ROS, or nothing."""
        return self._matching(name, self.text(name), NAMESPACE, 'must be a namespace of ROS: '
                              'letters, digits and _, no digit first, joined by /')

    def node(self, name: str) -> str:
        """Return the full name of a node, or nothing."""
        word = self._matching(name, self.text(name), NAMESPACE, 'must be the name of a node: '
                              'letters, digits and _, no digit first, joined by /')
        if word.endswith('/'):
            raise self.wrong(name, 'must be the name of a node')
        return f'/{word.strip("/")}' if word else ''

    def names(self, name: str) -> list[str]:
        """Return topics or nodes, separated by commas."""
        words = [word.strip() for word in self.text(name).split(',')]
        return [self._matching(name, word, TOPIC, f'{word!r} is no name of ROS: letters, digits '
                               'and _, no digit first, joined by /') for word in words if word]

    def configuration(self, name: str = 'config') -> str:
        """Return the path of a configuration given by path or by the name of one that ships."""
        try:
            return str(find_configuration(self.text(name)))
        except ConfigurationError as error:
            raise self.wrong(name, error.allowed) from error

    def read(self, name: str = 'config', **overrides: Any) -> Configuration:
        """Return that configuration itself, with other values of some dotted keys."""
        try:
            return load_configuration(self.configuration(name), [
                f'{key}={json.dumps(value)}' for key, value in overrides.items()])
        except LaunchArgumentError:
            raise
        except ConfigurationError as error:
            raise self.wrong(name, str(error)) from error

    def new_directory(self, name: str = 'record') -> str:
        """Return the path of a run that is to be recorded, or nothing."""
        if not self.text(name):
            return ''
        path = Path(self.text(name)).expanduser().absolute()
        if path.exists():
            raise self.wrong(name, 'exists already; recordings are never overwritten')
        return str(path)

    def existing(self, name: str, kind: str) -> str:
        """Return the path of something that is there."""
        path = Path(self.text(name)).expanduser().absolute()
        if not self.text(name) or not path.exists():
            raise self.wrong(name, f'no such {kind}')
        return str(path)

    def driver(self, name: str = 'driver') -> str:
        """Return the name of a driver, or nothing."""
        word = self.text(name)
        known = [*DRIVERS.builtin, *DRIVERS.installed()]
        if word and ':' not in word and word not in known:
            raise self.wrong(name, f'no such driver; known: {", ".join(known)}; or give '
                             'package.module:Class')
        return word

    def _matching(self, name: str, word: str, pattern: re.Pattern[str], allowed: str) -> str:
        if word and not pattern.fullmatch(word):
            raise self.wrong(name, allowed)
        return word


def joint_axes(configuration: Configuration) -> dict[str, Any]:
    """Return prefix of keys → parameters of each driver `joint`; '' of a loop of one axis."""
    return {f'{AXES}.{name}.' if name else '': item.driver_parameters
            for name, item in configuration.axes or (('', configuration),)
            if item.driver_settings.name == 'joint'}


def of_manager(configuration: Configuration, manager: str) -> dict[str, str]:
    """Return the settings of the drivers `joint` for another controller manager.

    Args:
        configuration: Of the loop.
        manager: Full name of the manager's node. Its controllers and its broadcaster are in its
            namespace, so absolute names that are not get it.

    Returns:
        Dotted key → name.
    """
    namespace = manager.rpartition('/')[0]
    found = {}
    for prefix, driver in joint_axes(configuration).items():
        for key in ('command_topic', 'state_topic', 'controller'):
            name = getattr(driver, key)
            if key == 'controller' and name.strip('/-'):
                name = '/' + name.strip('/')    # as the driver takes it
            if name.startswith('/') and not name.startswith(f'{namespace}/'):
                found[f'{prefix}driver.{key}'] = namespace + name
        found[f'{prefix}driver.activity_topic'] = f'{manager}/activity'
    return found


def joint_controllers(template: Path, configuration: Configuration, folder: Path,
                      namespace: str = '') -> Path:
    """Write the parameter file of the controllers for the joints of a configuration.

    Args:
        template: Parameter file with the section `effort_controller`.
        configuration: Its drivers `joint` name joint, interface and controller; joints of one
            command topic are those of one controller, in the order of the axes.
        folder: Where the file goes.
        namespace: That of the controllers, as /left; '' = none.

    Returns:
        The file.

    Raises:
        ConfigurationError: The command topic is not that of a controller, or that of another one
            of the same name.
    """
    content = yaml.safe_load(template.read_text(encoding='utf-8'))
    section = content.pop('effort_controller')['ros__parameters']
    manager = content['controller_manager']['ros__parameters']
    kind = manager.pop('effort_controller')
    topics: dict[str, str] = {}
    for prefix, driver in joint_axes(configuration).items():
        controller, _, last = driver.command_topic.strip('/').rpartition('/')
        if last != 'commands' or not controller:
            raise ConfigurationError(f'{prefix}driver.command_topic', driver.command_topic,
                                     'must end in CONTROLLER/commands where a controller is '
                                     'spawned')
        controller = controller.rpartition('/')[2]
        topic = topics.setdefault(controller, driver.command_topic)
        if topic != driver.command_topic:
            raise ConfigurationError(f'{prefix}driver.command_topic', driver.command_topic,
                                     f'names the controller {controller} of {topic} again: '
                                     'a manager has one of a name')
        if controller not in manager:
            manager[controller] = kind
            content[controller] = {'ros__parameters': {
                **section, 'joints': [], 'interface_name': driver.interface}}
        content[controller]['ros__parameters']['joints'].append(driver.joint)
    if namespace:       # there the spawner and the controllers ask for full names
        content = {f'{namespace}/{name}': item for name, item in content.items()}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / 'joint_controllers.yaml'
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')
    return path
