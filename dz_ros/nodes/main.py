"""Starting a node as a process: signals, exit codes, errors of one line.

Exit code 0 after an orderly end, also by SIGINT or SIGTERM; 2 after a user's mistake; 1 after
anything else that went wrong. rclpy is imported here and not before, so that its absence is one
line as well.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
import signal
import sys
from types import FrameType
from typing import Any

from dz_ros.errors import DzRosError, NO_RCLPY
from dz_ros.runtime.claim import domain
from dz_ros.runtime.privileges import ADVICE, ask, usable_cores
from dz_ros.runtime.process import end_with_parent, settle

NODES = {'plant_node': 'PlantNode', 'actuator_node': 'ActuatorNode',
         'controller_node': 'ControllerNode',
         'trajectory_node': 'TrajectoryNode', 'recorder_node': 'RecorderNode',
         'replay_node': 'ReplayNode', 'feed_node': 'FeedNode',
         'operator_node': 'OperatorNode', 'check_node': 'CheckNode', 'live_node': 'LiveNode',
         'foxglove_node': 'FoxgloveNode'}
"""Executable → class in the module of the same name."""
PRIORITY = {'plant_node': 0, 'actuator_node': 0, 'controller_node': 0, 'trajectory_node': -1}
"""Node that may be set up by the section `process` → its priority less `process.priority`."""
SIDES = {'plant_node': 0, 'actuator_node': 0, 'controller_node': 1}
"""In lockstep the two that take turns have every other core each: neither sleeps meanwhile."""
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Environment variables that name a file of profiles for Fast DDS."""


def run_node(name: str) -> int:
    """Run one node until it is done or told to end; return the exit code."""
    node: Any = None
    told = False

    def end(_number: int, _frame: FrameType | None) -> None:
        nonlocal told
        told = True
        if node is not None:
            node.stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    # Whoever started this process may have held them back until now (`dz run` does).
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    end_with_parent()
    if not any(os.environ.get(name) for name in PROFILES):
        os.environ[PROFILES[0]] = str(Path(__file__).with_name('fastdds.xml'))
    try:
        import rclpy
        from rclpy.logging import LoggingSeverity, set_logger_level
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        return _complain(name, f'{NO_RCLPY} ({error})')
    try:
        domain()
    except ValueError as error:
        return _complain(name, str(error))
    # rcl logs what it then raises as well; one line is enough.
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        set_logger_level('rcl', LoggingSeverity.UNSET)
    except Exception as error:  # noqa: BLE001  rclpy raises its own kinds for bad arguments
        return _complain(name, _first_line(error))
    code = 0
    try:
        module = importlib.import_module(f'dz_ros.nodes.{name}')
        node = getattr(module, NODES[name])()
        node.stopping = told
        _set_up(name, node)
        node.run()
    except DzRosError as error:
        code = _complain(name, str(error))
    except Exception as error:
        if type(error).__module__.split('.')[0] not in ('rclpy', '_rclpy_pybind11'):
            raise
        code = _complain(name, _first_line(error))
    finally:
        code = _close(name, node) or code
        rclpy.try_shutdown()
    return code


def _set_up(name: str, node: Any) -> None:
    """Set the process up as the configuration wants it; one line for all that is refused."""
    configuration = getattr(node, 'configuration', None)
    if configuration is None or name not in PRIORITY:
        settle(collect_garbage=True)    # nobody waits for it
        return
    wanted, own = configuration.process, PRIORITY[name]
    settle(wanted.collect_garbage)
    realtime = configuration.loop.timing == 'realtime'
    if not realtime and name in SIDES:
        if not wanted.core_numbers:
            ask(cores=usable_cores()[SIDES[name]::2])       # nobody has asked for it
        elif len(wanted.core_numbers) == 1:
            node.eager = 0.0    # who is to answer needs it
    refused = ask(max(wanted.priority + own, 1) if realtime and wanted.priority else 0,
                  wanted.core_numbers if own == 0 else (), wanted.lock_memory and own == 0)
    if refused:
        node.get_logger().warning(f'refused: {", ".join(refused)}; {ADVICE}')


def _close(name: str, node: Any) -> int:
    """Close a node; return the exit code of what went wrong in it, 0 if nothing."""
    try:
        if node is not None:
            node.close()
    except DzRosError as error:
        return _complain(name, str(error))
    return 0


def _complain(name: str, message: str) -> int:
    """Write one line on standard error; return the exit code of a user's mistake."""
    sys.stderr.write(f'{name}: error: {message}\n')
    return 2


def _first_line(error: Exception) -> str:
    """Return the first line of rclpy's message, without the place in its C source."""
    return str(error).strip().splitlines()[0].split(', at /')[0]


def plant_node() -> int:
    """Run the simulated plant."""
    return run_node('plant_node')


def actuator_node() -> int:
    """Run an actuator by its driver."""
    return run_node('actuator_node')


def controller_node() -> int:
    """Run the controller."""
    return run_node('controller_node')


def trajectory_node() -> int:
    """Run the trajectory generator."""
    return run_node('trajectory_node')


def recorder_node() -> int:
    """Run the recorder."""
    return run_node('recorder_node')


def replay_node() -> int:
    """Run the player of a recorded run."""
    return run_node('replay_node')


def foxglove_node() -> int:
    """Run the server for Foxglove and Lichtblick."""
    return run_node('foxglove_node')


def live_node() -> int:
    """Run the live page."""
    return run_node('live_node')


if __name__ == '__main__':
    # python -m dz_ros.nodes.main NODE --ros-args …: how `dz run` starts the nodes.
    sys.exit(run_node(sys.argv.pop(1)))
