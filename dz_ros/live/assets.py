# SPDX-License-Identifier: Apache-2.0
"""The page's files, read once; nothing else on this machine can be asked for."""

from __future__ import annotations

from importlib.resources import files

_TYPES = {'html': 'text/html', 'css': 'text/css', 'js': 'text/javascript', 'svg': 'image/svg+xml',
          'txt': 'text/plain'}
_NAMES = (
    'style.css', 'panels.css', 'screens.css', 'main.js', 'link.js', 'store.js', 'frames.js',
    'view.js', 'plots.js', 'painters.js', 'histograms.js', 'readout.js', 'nodes.js', 'actions.js',
    'commissioning.js', 'parameters.js', 'scrub.js', 'summary.js', 'exports.js', 'theme_switch.js',
    'words.js', 'icon.svg',
    'vendor/uPlot.esm.js', 'vendor/uPlot.min.css', 'vendor/uPlot.LICENSE.txt',
)

ASSETS = {'/': 'index.html', **{f'/{name}': name for name in _NAMES}}
"""Path of a request → file in the folder `page`."""


def read_assets() -> dict[str, tuple[str, bytes]]:
    """Return path → (content type, contents)."""
    folder = files('dz_ros.live') / 'page'
    found = {}
    for path, name in ASSETS.items():
        item = folder
        for part in name.split('/'):
            item = item / part
        found[path] = (_TYPES[name.rpartition('.')[2]], item.read_bytes())
    return found
