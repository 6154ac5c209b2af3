# SPDX-License-Identifier: Apache-2.0
"""Starting a node as a process: signals, exit codes, errors of one line.

Exit code 0 after an orderly end, also by SIGINT, SIGTERM or SIGHUP; 2 after a user's mistake; 1
after anything else that went wrong. rclpy is imported here and not before, so that its absence is
one line as well. This module imports next to nothing: until `_run` has its handler, a signal ends
the process with a traceback, and a busy machine takes a second over some imports.
"""

from __future__ import annotations

from functools import partial
import importlib
import os
import signal
import sys
from types import FrameType
from typing import Any

from dz_ros.runtime.import_path import drop_current_folder
from dz_ros.runtime.os_signals import ENDS, ignore_ends, on_ends

NODES = {'plant_node': 'make_plant_node', 'actuator_node': 'ActuatorNode',
         'controller_node': 'ControllerNode',
         'trajectory_node': 'TrajectoryNode', 'recorder_node': 'RecorderNode',
         'replay_node': 'ReplayNode', 'feed_node': 'FeedNode',
         'operator_node': 'OperatorNode', 'check_node': 'CheckNode', 'live_node': 'LiveNode',
         'foxglove_node': 'FoxgloveNode'}
"""Executable → class, or function that makes the node, in the module of the same name."""
PRIORITY = {'plant_node': 0, 'actuator_node': 0, 'controller_node': 0, 'trajectory_node': -1}
"""Node that may be set up by the section `process` → its priority less `process.priority`."""
SIDES = {'plant_node': 0, 'actuator_node': 0, 'controller_node': 1}
"""The two that take turns have every other core each: what one sends and what that wakes up does
not take the core from the other, whose caches stay its own; in lockstep neither sleeps."""


def run_node(name: str) -> int:
    """Run one node until it is done or to end; return the exit code.

    The process is to end after that: signals that ask it to are ignored from then on.
    """
    try:
        return _run(name)
    finally:
        ignore_ends()


def _run(name: str) -> int:
    drop_current_folder()
    node: Any = None
    stopping = False

    def end(_number: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True
        if node is not None:
            node.stopping = True

    on_ends(end)
    # The parent may have held them back until now (`dz run` does).
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDS)
    from pathlib import Path

    from dz_ros.errors import DzRosError, NO_RCLPY
    from dz_ros.nodes.ros.middleware import wishes
    from dz_ros.runtime.claim import domain
    from dz_ros.runtime.log_folder import log_folder_fault, NO_LOG_FILES
    from dz_ros.runtime.process import end_with_parent

    end_with_parent()
    try:
        import rclpy
        from rclpy.logging import LoggingSeverity, set_logger_level
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        return _report_mistake(name, f'{NO_RCLPY} ({error})')
    try:
        domain()
    except ValueError as error:
        return _report_mistake(name, str(error))
    words = list(sys.argv)
    fault = '' if NO_LOG_FILES in words else log_folder_fault()
    if fault:
        sys.stderr.write(f'{name}: warning: {fault}\n')
        words += ['--ros-args', NO_LOG_FILES]
    # rcl logs what it then raises as well; one line is enough.
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        if rclpy.get_rmw_implementation_identifier().startswith('rmw_fastrtps'):
            os.environ.update(wishes(os.environ, Path.cwd()))
        rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
        set_logger_level('rcl', LoggingSeverity.UNSET)
    except Exception as error:  # noqa: BLE001  rclpy raises its own kinds for bad arguments
        return _report_mistake(name, _first_line(error))
    code = 0
    try:
        module = importlib.import_module(f'dz_ros.nodes.{name}')
        node = getattr(module, NODES[name])()
        node.stopping = stopping
        _set_up(name, node)
        node.run()
    except DzRosError as error:
        code = _report_mistake(name, str(error))
    except SystemExit as error:
        # No node ends so: a plant, a law or a driver of the user's own did, whatever its code.
        code = _report_mistake(name, 'code that was imported ended the program: '
                               f'SystemExit({error.code!r})')
    except Exception as error:
        if type(error).__module__.split('.')[0] not in ('rclpy', '_rclpy_pybind11'):
            raise
        code = _report_mistake(name, _first_line(error))
    finally:
        code = _close(name, node) or code
        rclpy.try_shutdown()
    return code


def _set_up(name: str, node: Any) -> None:
    """Set the process up as the configuration wants it; one line for all that is refused."""
    from dz_ros.runtime.privileges import ADVICE, ask, usable_cores
    from dz_ros.runtime.process import settle

    configuration = getattr(node, 'configuration', None)
    if configuration is None or name not in PRIORITY:
        settle(collect_garbage=True)    # no node waits for it
        return
    wanted, own = configuration.process, PRIORITY[name]
    settle(wanted.collect_garbage)
    realtime = configuration.loop.timing == 'realtime'
    if name in SIDES and not wanted.core_numbers:
        ask(cores=usable_cores()[SIDES[name]::2])       # unless configured
    elif name in SIDES and len(wanted.core_numbers) == 1:
        node.eager = 0.0    # in lockstep the node to answer needs it
    refused = ask(max(wanted.priority + own, 1) if realtime and wanted.priority else 0,
                  wanted.core_numbers if own == 0 else (), wanted.lock_memory and own == 0)
    if refused:
        node.get_logger().warning(f'refused: {", ".join(refused)}; {ADVICE}')


def _close(name: str, node: Any) -> int:
    """Close a node; return the exit code of what went wrong in it, 0 if nothing."""
    from dz_ros.errors import DzRosError

    try:
        if node is not None:
            node.close()
    except DzRosError as error:
        return _report_mistake(name, str(error))
    return 0


def _report_mistake(name: str, message: str) -> int:
    """Write one line on standard error; return the exit code of a user's mistake."""
    from dz_ros.core.text import printable

    sys.stderr.write(f'{name}: error: {printable(message)}\n')
    return 2


def _first_line(error: Exception) -> str:
    """Return the first line of rclpy's message, without the place in its C source."""
    return str(error).strip().splitlines()[0].split(', at /')[0]


plant_node, actuator_node, controller_node, trajectory_node, recorder_node, replay_node, \
    foxglove_node, live_node = (partial(run_node, name) for name in (
        'plant_node', 'actuator_node', 'controller_node', 'trajectory_node', 'recorder_node',
        'replay_node', 'foxglove_node', 'live_node'))
"""The console scripts of setup.py."""

if __name__ == '__main__':
    # python -m dz_ros.nodes.main NODE --ros-args …: how `dz run` starts the nodes.
    sys.exit(run_node(sys.argv.pop(1)))
