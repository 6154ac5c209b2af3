"""Every error that dz_ros raises on purpose.

    DzRosError                      root: catch this one to catch them all
    ├── ConfigurationError          a key, its value, what is allowed     (also ValueError)
    │   └── UnknownNameError        a plant, law, trajectory, driver name (also LookupError)
    ├── MissingDependencyError      an optional package is not installed  (also ImportError)
    ├── MessageError                bytes or labels are not the topic's   (also ValueError)
    ├── RecordingError              a run that cannot be written or read
    │   ├── RunExistsError          refuses to overwrite                  (also FileExistsError)
    │   ├── RunNotFoundError        nothing there                         (also FileNotFoundError)
    │   └── DamagedRunError         cut off or corrupted: says what to do
    └── LoopError                   the running loop: peers, topics, nodes(also RuntimeError)
        └── DriverError             a device that is not there or refuses

The library raises; the command line prints the message, which is one line, and returns 2.
"""

from __future__ import annotations

from typing import Any


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
        allowed: What would be accepted, in words.
    """

    def __init__(self, key: str, value: Any, allowed: str) -> None:
        self.key = key
        self.value = value
        self.allowed = allowed
        super().__init__(f'{key} = {value!r}: {allowed}')


class UnknownNameError(ConfigurationError, LookupError):
    """A plant, law, trajectory or driver that is not installed."""


class MissingDependencyError(DzRosError, ImportError):
    """An optional package is needed for this and is not installed."""


class MessageError(DzRosError, ValueError):
    """A message whose bytes or labels are not those its topic carries.

    Attributes:
        expected: Labels the topic carries; empty where any would do.
        got: Labels found; empty where the message has none or cannot be read.
    """

    def __init__(self, reason: str, expected: tuple[str, ...] = (),
                 got: tuple[str, ...] = ()) -> None:
        self.expected = expected
        self.got = got
        super().__init__(reason)


class RecordingError(DzRosError):
    """A run that cannot be written or read."""


class RunExistsError(RecordingError, FileExistsError):
    """The directory of a run exists already; recordings are never overwritten."""


class RunNotFoundError(RecordingError, FileNotFoundError):
    """No run at the given path."""


class DamagedRunError(RecordingError):
    """A run that was cut off or corrupted."""


class LoopError(DzRosError, RuntimeError):
    """The running loop cannot start or go on."""


class DriverError(LoopError):
    """A device is not there, is another one, refuses, or has gone."""


NO_RCLPY = ('rclpy is not installed here: source an installed ROS 2 Jazzy, or '
            "pip install 'dz_ros[ros]' on CPython 3.10 to 3.13")
"""What to say where a node cannot start."""
