# SPDX-License-Identifier: Apache-2.0
"""Which part may import which, read from the source; the picture is in docs/architecture.md.

    errors ← core ← {files, runs, drivers}; {files, runs} ← recording;
    runs ← {report ← studies, live}; {studies, drivers} ← identification ← replay; all ← cli;
    {recording, runs, drivers, live} ← nodes; runtime: stdlib only
"""

import ast
from functools import cache
from pathlib import Path
import re
import subprocess
import sys

import pytest

import dz_ros

ROOT = Path(dz_ros.__file__).parent
FILES = sorted(ROOT.rglob('*.py'))
LEAVES = {'errors', 'plugins', 'version'}  # import nothing of ours; any part may import them
# Part of the package → the other parts it may import, at any depth of the code.
ARROWS = {
    '__init__': LEAVES | {'api'},
    '__main__': LEAVES | {'cli', 'runtime'},
    'errors': set(),
    'plugins': set(),
    'version': set(),
    'core': LEAVES,
    'files': LEAVES | {'core'},
    'runs': LEAVES | {'core'},
    'drivers': LEAVES | {'core', 'runtime'},
    'recording': LEAVES | {'core', 'files', 'runs'},
    'report': LEAVES | {'core', 'runs'},
    'studies': LEAVES | {'core', 'runs', 'report'},
    'identification': LEAVES | {'core', 'drivers', 'runs', 'report', 'studies'},
    'replay': LEAVES | {'core', 'runs', 'identification'},
    'live': LEAVES | {'core', 'runs'},
    'runtime': LEAVES,
    'api': LEAVES | {'core', 'files', 'recording', 'runs', 'report', 'studies'},
    'nodes': LEAVES | {'core', 'files', 'drivers', 'recording', 'runs', 'live', 'runtime'},
    'cli': LEAVES | {'core', 'files', 'drivers', 'recording', 'runs', 'replay', 'report',
                     'studies', 'live', 'identification', 'runtime'},
}
ROS = {'rclpy', 'std_msgs', 'std_srvs', 'rcl_interfaces', 'rosgraph_msgs', 'builtin_interfaces',
       'diagnostic_msgs', 'lifecycle_msgs', 'sensor_msgs', 'launch', 'launch_ros',
       'ament_index_python'}
SLOW = {'matplotlib', 'scipy', 'rosbags', 'numba', 'pandas', 'pyarrow', 'dask',
        'distributed', 'serial', 'can', 'canopen', 'aiohttp', 'flint',
        'foxglove'}  # only inside functions
OUTSIDE_WORLD = {'asyncio', 'ctypes', 'datetime', 'io', 'logging', 'multiprocessing', 'os',
                 'pathlib', 'select', 'shutil', 'signal', 'socket', 'subprocess', 'tempfile',
                 'threading', 'time'}


parsed = cache(ast.parse)


def imports(source, package):
    """Yield (module imported, whether at import time, line) of a source text.

    Args:
        source: The text.
        package: Dotted package that contains it, for relative imports.
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

    yield from visit(parsed(source), True)


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
        elif part == 'core' and top not in sys.stdlib_module_names | {'numpy', 'numba',
                                                                      'flint'}:
            found.append(f'line {line}: core needs numpy and nothing else, not {top}')
    found += [f'line {item.lineno}: {part} must not name {item.value}'
              for item in ast.walk(parsed(source))
              if isinstance(item, ast.Constant) and isinstance(item.value, str)
              and re.fullmatch(r'dz_ros(\.\w+)+:\w+', item.value) and part != 'plugins'
              and item.value.split('.')[1].partition(':')[0] not in ARROWS[part] | {part}]
    return found


@pytest.mark.parametrize('part', sorted({part_of(path) for path in FILES}))
def test_arrows(part):
    found = []
    for path in FILES:
        if part_of(path) == part:
            package = '.'.join(('dz_ros', *path.relative_to(ROOT).parts[:-1]))
            found += [f'{path.relative_to(ROOT)}: {item}' for item in violations(
                path.read_text(encoding='utf-8'), part, package)]
    assert found == []


@pytest.mark.parametrize(('part', 'source'), [
    ('core', 'import dz_ros.files.configurations'),
    ('core', 'from dz_ros import nodes'),
    ('core', 'from .. import recording'),
    ('core', 'from ..runs.metrics import measure'),
    ('core', 'def f():\n    import time'),
    ('core', 'import yaml'),
    ('core', 'from scipy import signal'),
    ('recording', 'from dz_ros.report import plots'),
    ('runs', 'def f():\n    from dz_ros.recording.reader import read_run'),
    ('cli', 'def f():\n    from dz_ros.nodes import base'),
    ('cli', 'import rclpy'),
    ('nodes', 'from dz_ros.cli.main import main'),
    ('studies', 'from dz_ros.recording.reader import read_run'),
    ('report', 'from dz_ros.studies import arena'),
    ('nodes', 'from dz_ros.studies import arena'),
    ('runtime', 'import numpy'),
    ('runtime', 'from dz_ros.core import loop'),
    ('errors', 'import dz_ros.core'),
    ('core', 'X = "dz_ros.nodes.joint_driver:Joint"'),
    ('report', 'try:\n    import matplotlib.pyplot\nexcept ImportError:\n    pass'),
])
def test_the_check_finds(part, source):
    assert len(violations(source, part, f'dz_ros.{part}')) == 1


@pytest.mark.parametrize(('part', 'source'), [
    ('core', 'import math\nimport numpy as np\nfrom dz_ros.errors import DzRosError'),
    ('runs', 'def f():\n    from scipy import signal'),
    ('report', 'if TYPE_CHECKING:\n    from matplotlib.figure import Figure'),
    ('nodes', 'import rclpy\nfrom dz_ros.recording import cdr'),
    ('cli', 'from . import table\nfrom ..runs import metrics'),
])
def test_the_check_lets_pass(part, source):
    assert violations(source, part, f'dz_ros.{part}') == []


def test_every_part_has_its_arrows():
    assert {part_of(path) for path in FILES} <= set(ARROWS)


def test_core_opens_no_file():
    for path in ROOT.joinpath('core').rglob('*.py'):
        calls = [node.func.id for node in ast.walk(parsed(path.read_text(encoding='utf-8')))
                 if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
        assert not {'open', 'print', 'input'} & set(calls), path


@pytest.mark.slow
def test_a_file_of_over_300_lines_states_why():
    silent, tree = [], ROOT.parent
    for path in (*FILES, *(path for folder in ('test', 'benchmarks')
                           for path in sorted(tree.joinpath(folder).rglob('*.py')))):
        text = path.read_text(encoding='utf-8')
        reported = (ast.get_docstring(parsed(text)) or '').lower()
        if not (len(text.splitlines()) <= 301 or 'over 300 lines' in reported
                or 'longer than' in reported):
            silent.append(str(path.relative_to(tree)))
    assert silent == []


@pytest.mark.parametrize('module', ['dz_ros', 'dz_ros.core.loop.offline', 'dz_ros.core.dataset'])
def test_importing_brings_nothing_slow(module):
    code = f'import sys, {module}; print(*sorted(item.partition(".")[0] for item in sys.modules))'
    found = subprocess.run([sys.executable, '-c', code], check=True, capture_output=True,
                           text=True, timeout=300, cwd=ROOT.parent)
    assert not (SLOW | ROS | {'yaml', 'mcap'}) & set(found.stdout.split())


def test_no_class_is_more_than_three_of_ours_deep():
    """But for errors, whose tree errors.py draws, and laws, which extend one another."""
    bases = {}
    for path in FILES:
        if part_of(path) == 'errors' or path.parent.name == 'laws':
            continue
        for item in ast.walk(parsed(path.read_text(encoding='utf-8'))):
            if isinstance(item, ast.ClassDef):
                names = [ast.unparse(base).rpartition('.')[2] for base in item.bases]
                bases.setdefault(item.name, set()).update(names)

    def depth(name):
        return 1 + max((depth(base) for base in bases[name] if base in bases and base != name),
                       default=0)

    assert {name: depth(name) for name in bases if depth(name) > 3} == {}
