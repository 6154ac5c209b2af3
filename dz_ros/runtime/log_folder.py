# SPDX-License-Identifier: Apache-2.0
"""Folder in which ROS keeps the log files of nodes, checked before rcl fails on it."""

from __future__ import annotations

import os
from pathlib import Path
import tempfile

NO_LOG_FILES = '--disable-external-lib-logs'
"""ROS argument that leaves the log files out; what a node logs still goes to standard error."""


def log_folder_fault() -> str:
    """Return why log files cannot be kept, one line for users; '' where they can.

    The folder is the one rcl takes: $ROS_LOG_DIR, else $ROS_HOME/log, else $HOME/.ros/log. It is
    made if it is missing, as rcl would.
    """
    given, home = os.environ.get('ROS_LOG_DIR'), os.environ.get('HOME')
    name = given or f'{os.environ.get("ROS_HOME") or "~/.ros"}/log'
    advice = 'set ROS_LOG_DIR to a folder that can be written; going on without log files'
    if name.startswith('~') and not home:
        return f'HOME is not set, so there is no place for log files: {advice}'
    folder = Path(f'{home}{name[1:]}' if name.startswith('~') else name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return ''
    except OSError as error:
        return (f'log files cannot be written to {folder} ({error.strerror or error}): '
                f'{advice}')
