# SPDX-License-Identifier: Apache-2.0
"""Every error that dz_ros raises on purpose.

    DzRosError                      root: catch this one to catch them all
    ├── ConfigurationError          a key, its value, what is allowed     (also ValueError)
    │   ├── LaunchArgumentError     NAME:=VALUE of ros2 launch            (also RuntimeError)
    │   └── UnknownNameError        a plant, law, trajectory, driver name (also LookupError)
    │       └── ImportRefusedError  a recording names a module to import
    ├── MissingDependencyError      an optional package is not installed  (also ImportError)
    ├── MessageError                bytes or labels are not the topic's   (also ValueError)
    ├── RecordingError              a run that cannot be written or read
    │   ├── RunExistsError          refuses to overwrite                  (also FileExistsError)
    │   ├── RunNotFoundError        nothing there                         (also FileNotFoundError)
    │   ├── MissingLabelError       records without a number that is needed (also KeyError)
    │   └── DamagedRunError         cut off or corrupted, and what to do
    └── LoopError                   the running loop: peers, topics, nodes(also RuntimeError)
        ├── DivergedError           a loop offline, and when              (also OverflowError)
        └── DriverError             a device that is not there or refuses

The library raises; the command line prints the message, which is one line, and returns 2.
"""

from __future__ import annotations

from collections.abc import Iterable
import reprlib
from typing import Any

LONGEST_KEY = 200
"""Characters of a key that an error shows."""
_shown = reprlib.Repr()
_shown.maxstring = _shown.maxother = _shown.maxlong = 200
_shown.maxlist = _shown.maxtuple = _shown.maxdict = 20
_shown.maxlevel = 3


def shown(value: Any) -> str:
    """Return a value as an error shows it: as Python writes it, abridged where it is long."""
    try:
        return _shown.repr(value)
    except ValueError:      # an int of more digits than Python writes
        return f'{type(value).__name__} of too many digits'


def suggestion(word: str, known: Iterable[str], prefix: str = '') -> str:
    """Return what an error adds about the known name nearest to a misspelt one; '' if none is.

    Args:
        word: The misspelt name.
        known: Names that it may mean.
        prefix: Written before the name that is suggested.
    """
    import difflib

    near = difflib.get_close_matches(word, list(known), n=1)
    return f'; did you mean {prefix}{near[0]}?' if near else ''


class DzRosError(Exception):
    """Root of the errors dz_ros raises on purpose."""

    def __str__(self) -> str:
        """Return the message alone (KeyError-like bases would quote it)."""
        return str(self.args[0]) if self.args else type(self).__name__


class ConfigurationError(DzRosError, ValueError):
    """A configuration value that is not allowed.

    Attributes:
        key: Dotted key as the user writes it, e.g. ``controller.lambda``.
        value: The offending value, as given.
        allowed: What would be accepted, as text.
    """

    def __init__(self, key: str, value: Any, allowed: str) -> None:
        self.key = key
        self.value = value
        self.allowed = allowed
        name = key if len(key) <= LONGEST_KEY else f'{key[:LONGEST_KEY]}…'
        super().__init__(f'{name} = {shown(value)}: {allowed}')


class CountError(ConfigurationError):
    """A list that has not as many numbers as the plant has states, or regressors."""


class LaunchArgumentError(ConfigurationError, RuntimeError):
    """An argument of a launch file that is not allowed; attributes as of its base."""

    def __init__(self, key: str, value: Any, allowed: str) -> None:
        super().__init__(key, value, allowed)
        self.args = (f'{key}:={str(value)[:200]}: {allowed}',)


class UnknownNameError(ConfigurationError, LookupError):
    """A plant, law, trajectory or driver that is not installed."""


class ImportRefusedError(UnknownNameError):
    """A recording or a message names a module that the user did not allow to be imported.

    Attributes:
        module: That module.
    """

    def __init__(self, key: str, value: str, module: str) -> None:
        self.module = module
        named = module if module.replace('.', '').isidentifier() else ascii(module)
        super().__init__(key, value, 'a recording or a message names this module, which is '
                         'therefore not imported'
                         + (f'; if you trust it: --allow-import {named}'
                            if len(named) <= LONGEST_KEY else ''))


class MissingDependencyError(DzRosError, ImportError):
    """An optional package is needed for this and is not installed."""


class MessageError(DzRosError, ValueError):
    """A message whose bytes or labels are not those its topic carries.

    Attributes:
        expected: Labels the topic carries; empty where any would do.
        got: Labels found; empty where the message has none or cannot be read.
        cause: One of few causes by which such messages are counted; empty = by `got`.
    """

    def __init__(self, reason: str, expected: tuple[str, ...] = (),
                 got: tuple[str, ...] = (), cause: str = '') -> None:
        self.expected = expected
        self.got = got
        self.cause = cause
        super().__init__(reason)


class RecordingError(DzRosError):
    """A run that cannot be written or read."""


class RunExistsError(RecordingError, FileExistsError):
    """The directory of a run exists already; recordings are never overwritten."""


class RunNotFoundError(RecordingError, FileNotFoundError):
    """No run at the given path."""


class MissingLabelError(RecordingError, KeyError):
    """A run whose records lack a number that is needed."""


class DamagedRunError(RecordingError):
    """A run that was cut off or corrupted."""


class LoopError(DzRosError, RuntimeError):
    """The running loop cannot start or go on."""


class DivergedError(LoopError, OverflowError):
    """The numbers of a loop offline are no longer finite.

    Attributes:
        t: Time of the first sample that cannot be computed [s].
        where: Axis or axes in question, as ``axis yaw``; empty: the loop has one.
    """

    def __init__(self, t: float, where: str = '') -> None:
        self.t = t
        self.where = where
        super().__init__((f'{where}: ' if where else '') + 'the loop diverged, its numbers are no '
                         f'longer finite at t = {t:g} s')


class DriverError(LoopError):
    """A device is not there, is another one, refuses, or has gone."""


NO_RCLPY = ('rclpy is not installed here: source an installed ROS 2 Jazzy, or '
            "pip install 'dz_ros[ros]' on CPython 3.10 to 3.13")
"""Message where a node cannot start."""
