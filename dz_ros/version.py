# SPDX-License-Identifier: Apache-2.0
"""The version, whose one source is package.xml."""

from __future__ import annotations

from pathlib import Path

NAME = 'dz_ros'


def version() -> str:
    """Return the version of this code.

    The package.xml beside the package answers first: it is there only in a source tree, where an
    installed copy of another version may exist as well.
    """
    manifest = Path(__file__).resolve().parent.parent / 'package.xml'
    if manifest.is_file():
        # Imported late, as below: the command line starts faster.
        import xml.etree.ElementTree as ET

        root = ET.parse(manifest).getroot()
        if root.findtext('name') == NAME:
            return root.findtext('version') or 'unknown'
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed_version

    try:
        return installed_version(NAME)
    except PackageNotFoundError:
        return 'unknown'
