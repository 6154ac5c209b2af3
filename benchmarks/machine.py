# SPDX-License-Identifier: Apache-2.0
"""What a figure was measured on: printed above every table of the benchmarks."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform


def describe(*packages: str) -> str:
    """Return one line: date-less description of machine, system, Python and package versions."""
    model = platform.machine()
    try:
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith('model name'):
                model = line.partition(':')[2].strip()
                break
    except OSError:
        pass
    parts = [f'{os.cpu_count()} × {model}', f'Linux {platform.release()}'
             if platform.system() == 'Linux' else platform.platform(),
             f'CPython {platform.python_version()}']
    for package in packages:
        try:
            parts.append(f'{package} {version(package)}')
        except PackageNotFoundError:
            continue
    return ', '.join(parts)
