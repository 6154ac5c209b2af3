"""Who may import whom, read from the source; the picture is in docs/architecture.md.

    errors ← core ← {drivers, recording, analysis ← {studies, live}, files} ← {nodes, cli};
    runtime: stdlib only; studies is for cli alone
"""

import ast
from pathlib import Path
import subprocess
import sys

import pytest

import dz_ros

ROOT = Path(dz_ros.__file__).parent
FILES = sorted(ROOT.rglob('*.py'))
LEAVES = {'errors', 'version'}  # import nothing of ours; anybody may import them
READERS = {'files', 'waypoints', 'yaml12'}  # the modules beside the folders that read files
# Part of the package → the other parts it may import, at any depth of the code.
ARROWS = {
    '__init__': LEAVES,
    '__main__': LEAVES | {'cli'},
    'errors': set(),
    'version': set(),
    'core': LEAVES,
    **dict.fromkeys(READERS, LEAVES | READERS | {'core'}),
    'drivers': LEAVES | {'core'},
    'recording': LEAVES | READERS | {'core'},
    'analysis': LEAVES | {'core'},
    'studies': LEAVES | {'core', 'analysis'},
    'identification': LEAVES | {'core', 'drivers', 'analysis', 'studies'},
    'live': LEAVES | {'core', 'analysis'},
    'runtime': LEAVES,
    'nodes': LEAVES | READERS | {'core', 'drivers', 'recording', 'live', 'runtime'},
    'cli': LEAVES | READERS | {'core', 'drivers', 'recording', 'analysis', 'studies', 'live',
                               'identification', 'runtime'},
}
ROS = {'rclpy', 'std_msgs', 'std_srvs', 'rcl_interfaces', 'rosgraph_msgs', 'builtin_interfaces',
       'diagnostic_msgs', 'lifecycle_msgs', 'sensor_msgs', 'launch', 'launch_ros',
       'ament_index_python'}
SLOW = {'matplotlib', 'scipy', 'rosbags', 'numba', 'pandas', 'pyarrow', 'dask',
        'distributed', 'serial', 'can', 'canopen', 'aiohttp', 'foxglove'}  # only inside functions
OUTSIDE_WORLD = {'asyncio', 'ctypes', 'datetime', 'io', 'logging', 'multiprocessing', 'os',
                 'pathlib', 'select', 'shutil', 'signal', 'socket', 'subprocess', 'tempfile',
                 'threading', 'time'}


def imports(source, package):
    """Yield (module imported, whether at import time, line) of a source text.

    Args:
        source: The text.
        package: Dotted package it stands in, for relative imports.
    """
    def visit(node, eager):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                for item in child.names:
                    yield item.name, eager, child.lineno
            elif isinstance(child, ast.ImportFrom):
                base = child.module or ''
                if child.level:
                    parents = package.split('.')
                    base = '.'.join([*parents[:len(parents) - child.level + 1], base]).rstrip('.')
                for item in child.names:
                    yield f'{base}.{item.name}', eager, child.lineno
            else:
                inside = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
                only_for_types = isinstance(child, ast.If) and 'TYPE_CHECKING' in ast.dump(
                    child.test)
                yield from visit(child, eager and not inside and not only_for_types)

    yield from visit(ast.parse(source), True)


def part_of(path):
    """Return which part of the package a file belongs to."""
    return path.relative_to(ROOT).parts[0].removesuffix('.py')


def violations(source, part, package):
    """Return what a source text of a part imports and must not."""
    found = []
    for module, eager, line in imports(source, package):
        top, _, rest = module.partition('.')
        if top == 'dz_ros':
            target = rest.partition('.')[0]
            if target in ARROWS and target != part and target not in ARROWS[part]:
                found.append(f'line {line}: {part} must not import {module}')
        elif top in ROS and part != 'nodes':
            found.append(f'line {line}: only nodes import {top}')
        elif top in SLOW and eager:
            found.append(f'line {line}: import {top} inside the function that needs it')
        elif part == 'core' and top in OUTSIDE_WORLD:
            found.append(f'line {line}: core knows no {top}')
        elif part in ('runtime', 'errors', 'version') and top not in sys.stdlib_module_names:
            found.append(f'line {line}: {part} is standard library only, not {top}')
        elif part == 'core' and top not in sys.stdlib_module_names | {'numpy', 'numba'}:
            found.append(f'line {line}: core needs numpy and nothing else, not {top}')
    return found


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_arrows(path):
    package = '.'.join(('dz_ros', *path.relative_to(ROOT).parts[:-1]))
    assert violations(path.read_text(encoding='utf-8'), part_of(path), package) == []


@pytest.mark.parametrize(('part', 'source'), [
    ('core', 'import dz_ros.files'),
    ('core', 'from dz_ros import nodes'),
    ('core', 'from .. import recording'),
    ('core', 'from ..analysis.metrics import measure'),
    ('core', 'def f():\n    import time'),
    ('core', 'import yaml'),
    ('core', 'from scipy import signal'),
    ('recording', 'from dz_ros.analysis import metrics'),
    ('analysis', 'def f():\n    from dz_ros.recording.reader import read_run'),
    ('cli', 'def f():\n    from dz_ros.nodes import base'),
    ('cli', 'import rclpy'),
    ('nodes', 'from dz_ros.cli.main import main'),
    ('studies', 'from dz_ros.recording.reader import read_run'),
    ('analysis', 'from dz_ros.studies import arena'),
    ('nodes', 'from dz_ros.studies import arena'),
    ('runtime', 'import numpy'),
    ('runtime', 'from dz_ros.core import loop'),
    ('errors', 'import dz_ros.core'),
    ('analysis', 'try:\n    import matplotlib.pyplot\nexcept ImportError:\n    pass'),
])
def test_the_check_finds(part, source):
    assert len(violations(source, part, f'dz_ros.{part}')) == 1


@pytest.mark.parametrize(('part', 'source'), [
    ('core', 'import math\nimport numpy as np\nfrom dz_ros.errors import DzRosError'),
    ('analysis', 'def f():\n    from scipy import signal'),
    ('analysis', 'if TYPE_CHECKING:\n    from matplotlib.figure import Figure'),
    ('nodes', 'import rclpy\nfrom dz_ros.recording import cdr'),
    ('cli', 'from . import table\nfrom ..analysis import metrics'),
])
def test_the_check_lets_pass(part, source):
    assert violations(source, part, f'dz_ros.{part}') == []


def test_every_part_has_its_arrows():
    assert {part_of(path) for path in FILES} <= set(ARROWS)


def test_core_opens_no_file():
    for path in ROOT.joinpath('core').rglob('*.py'):
        calls = [node.func.id for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
                 if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
        assert not {'open', 'print', 'input'} & set(calls), path


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_file_is_too_long_to_read(path):
    assert len(path.read_text(encoding='utf-8').splitlines()) <= 300


@pytest.mark.parametrize('module', ['dz_ros', 'dz_ros.core.loop', 'dz_ros.core.dataset'])
def test_importing_brings_nothing_slow(module):
    code = f'import sys, {module}; print(*sorted(item.partition(".")[0] for item in sys.modules))'
    found = subprocess.run([sys.executable, '-c', code], check=True, capture_output=True,
                           text=True, timeout=60, cwd=ROOT.parent)
    assert not (SLOW | ROS | {'yaml', 'mcap'}) & set(found.stdout.split())
