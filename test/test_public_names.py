# SPDX-License-Identifier: Apache-2.0
"""Tests go through public names: what they take that begins with an underscore is counted."""

import ast
from pathlib import Path
import re

MAX_PRIVATE_ACCESSES = 30
"""In all of test/; more of them bind tests to how the code is written."""
PUBLIC = re.compile('__.*__$|_(asdict|fields|make|replace)$')
"""Underscores that are no secret: Python's own names, those of named tuples."""
PRIVATE = re.compile(r'(^|\.)_[A-Za-z]')
"""In a string that names an attribute."""


def private(name):
    return name.startswith('_') and not PUBLIC.match(name)


def accesses(tree):
    """Yield (line, what) for each private name that is not the test's own."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and private(node.attr):
            if not (isinstance(node.value, ast.Name) and node.value.id in ('self', 'cls')):
                yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.lineno, f'import {item.name}') for item in node.names
                        if private(item.name))
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split('.')[-1] in (
                'setattr', 'getattr', 'delattr'):
            yield from ((node.lineno, item.value) for item in node.args[:2]
                        if isinstance(item, ast.Constant) and isinstance(item.value, str)
                        and PRIVATE.search(item.value) and not PUBLIC.match(item.value))


def test_few_private_names_are_taken():
    root = Path(__file__).parent
    found = [f'{path.relative_to(root)}:{line}: {what}' for path in sorted(root.rglob('*.py'))
             for line, what in accesses(ast.parse(path.read_text(encoding='utf-8')))]
    assert len(found) <= MAX_PRIVATE_ACCESSES, '\n'.join(found)
