# SPDX-License-Identifier: Apache-2.0
"""Import path of this process; this module imports nothing that a folder could shadow."""

import os
import sys


def drop_current_folder() -> None:
    """Take the current folder from Python's path unless it was put there on purpose.

    ``python -m`` puts it first, and an empty item of ``PYTHONPATH``, as a trailing colon leaves
    one, means it too. What happens to lie there, a ``numpy.py`` or the metadata of a package,
    would then be run. The folder in which this package itself lies stays.
    """
    here = os.path.realpath(os.curdir)
    named = [item for item in os.environ.get('PYTHONPATH', '').split(os.pathsep) if item]
    if here == os.path.realpath(__file__ + '/../../..') or here in map(os.path.realpath, named):
        return
    python = os.path.realpath(os.__file__ + '/..')
    until = next((place for place, item in enumerate(sys.path)
                  if item and os.path.realpath(item) == python), len(sys.path))
    sys.path[:until] = [item for item in sys.path[:until]
                        if item and os.path.realpath(item) != here]
