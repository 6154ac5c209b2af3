# SPDX-License-Identifier: Apache-2.0
"""Sphinx configuration of the site: `make site`; rosdoc2 reads it too."""

from datetime import date
from pathlib import Path
import re
import sys
import xml.etree.ElementTree as ET

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / 'tools')]

import make_reference  # noqa: E402

manifest = ET.parse(ROOT / 'package.xml').getroot()
project = 'dz_ros'
author = manifest.findtext('author')
release = version = manifest.findtext('version')
copyright = f'{date.today().year}, {author}'
extensions = ['myst_nb', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
source_suffix = {'.ipynb': 'myst-nb', '.md': 'myst-nb'}
nb_execution_mode = 'force'
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_render_image_options = {'alt': 'figure of the run'}
root_doc = 'index'
html_theme = 'furo'
html_title = f'dz_ros {release}'
html_static_path: list[str] = []
html_theme_options = {'source_directory': 'docs/'}
myst_enable_extensions = ['colon_fence', 'dollarmath']
myst_heading_anchors = 4
autodoc_typehints = 'signature'
autodoc_member_order = 'bysource'
add_module_names = False
napoleon_google_docstring = True
nitpicky = False
OUTSIDE = r'(?<!!)\[([^\]]+)\]\({}[^)]*\)'
"""Link to a file of the project outside docs/: the site shows its text alone."""


def _inside_only(app, name, source):        # noqa: ARG001
    """Replace links that lead out of the site by their text."""
    if not name.startswith('reference/'):
        up = re.escape('../' * (1 + name.count('/')))
        source[0] = re.sub(OUTSIDE.format(up), r'\1', source[0])


def _write_reference(app):
    """Write the generated pages."""
    make_reference.main(Path(app.srcdir) / 'reference')


def setup(app):
    """Connect the two steps above."""
    app.connect('builder-inited', _write_reference)
    app.connect('source-read', _inside_only)
