# SPDX-License-Identifier: Apache-2.0
"""Write the layouts for Foxglove, Lichtblick and PlotJuggler from the labels of the messages.

    python tools/make_layouts.py [CONFIG] [--out DIR] [--namespace NS] [--axis NAME]

What is in config/layouts/ is for `robust` on a plant of order 2; another order, law or namespace
needs its own. A topic's numbers are an array in these tools; a layout names each: as the label
of a series in Foxglove and Lichtblick, as a curve of its own in PlotJuggler. Of a loop of several
axes it has a tab for what concerns all of them and one for each axis, whose row of the arrays it
takes, with names such as ``yaw.x0``; with --axis it is that of one axis alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Container, Iterable
import json
from pathlib import Path
import sys
from typing import Any
import xml.etree.ElementTree as ET

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from dz_ros.core.configuration import Configuration  # noqa: E402
from dz_ros.core.signals import Role, Signal, TERMS  # noqa: E402
from dz_ros.core.units import Units  # noqa: E402
from dz_ros.errors import ConfigurationError  # noqa: E402
from dz_ros.files.configurations import load_configuration  # noqa: E402
from dz_ros.live.columns import shown  # noqa: E402
from dz_ros.live.node_configurations import fields_of  # noqa: E402

COLOURS = ('#0072b2', '#d55e00', '#009e73', '#e69f00', '#cc79a7', '#56b4e9', '#8c8c8c')
ERROR, ALL_AXES = 'error', 'all axes'
"""Curve that only PlotJuggler can compute; tab of all axes, which no axis can be called."""
Names = dict[str, tuple[str, int]]
"""Field, of several axes AXIS.FIELD → its topic and place."""
Plots = list[tuple[str, list[str]]]
"""Title and fields of each plot."""


def names_of(c: Configuration, row: int = 0) -> Names:
    """Return every field of the messages that is worth a curve, by its label.

    Args:
        c: Configuration of the axis.
        row: Which row of the messages is the axis'.
    """
    found: Names = {}
    for topic, fields in fields_of(c).items():
        chosen = shown(fields)
        for place, item in enumerate(fields, row * len(fields)):
            if item in chosen:
                found.setdefault(item.name, (topic, place))
    return found


def plots(c: Configuration, names: Names) -> Plots:
    """Return the plots of an axis: those of the live page, then the law's other signals.

    Signals of different units do not share a plot.
    """
    units = Units.of(c.plant)
    signals = [item for item in (*TERMS, *c.law.signals) if item.name in names]

    def titled(title: str, chosen: list[Signal]) -> Plots:
        return by_unit(title, [(units.resolve(item.unit), item.name) for item in chosen])

    layer = ['s', 's_eps', 'epsilon']
    wanted = [('Error', [ERROR]),
              ('Output and reference', ['xd0', 'x0']),
              ('Command v, behind the dead-zone w', ['v', 'w']),
              ('Filtered error s, layer epsilon', layer),
              *titled('Parts of v', [item for item in signals if item.role is Role.TERM]),
              *titled('Estimates', [item for item in signals if item.role is Role.ESTIMATE]),
              ('Round trip, hold [s]', ['round_trip', 'hold']),
              *titled('Signals of the law', [
                  item for item in c.law.signals if item.name in names
                  and item.role is not Role.ESTIMATE and item.name not in layer])]
    return known_only(wanted, {*names, ERROR})


def by_unit(title: str, fields: Iterable[tuple[str, str]]) -> Plots:
    """Return a plot for each unit, of pairs of unit and field."""
    found: dict[str, list[str]] = {}
    for unit, field in fields:
        found.setdefault(unit, []).append(field)
    return [(title + (f' [{unit}]' if unit not in ('', '1') else ''), chosen)
            for unit, chosen in found.items()]


def known_only(wanted: Plots, names: Container[str]) -> Plots:
    """Return plots without the fields that there are not, and without those left empty."""
    there = [(title, [name for name in fields if name in names]) for title, fields in wanted]
    return [item for item in there if item[1]]


def common_plots(c: Configuration) -> Plots:
    """Return the plots of all axes of a machine; times of messages are those of its first axis."""
    found: Plots = []
    for title, field, unit in (
            ('Error', ERROR, 'x'), ('Output', 'x0', 'x'), ('Command v', 'v', 'v'),
            ('Distance of s from its layer', 's_eps', 'x^(n-1)'),
            ('Status: 0 adapting, 8 the law does not act', 'status', '1')):
        found += by_unit(title, [(Units.of(item.plant).resolve(unit), f'{name}.{field}')
                                 for name, item in c.axes])
    first = c.axis_names[0]
    return [*found, ('Round trip, hold [s]', [f'{first}.round_trip', f'{first}.hold'])]


def foxglove(tabs: dict[str, Plots], names: Names, place: str) -> dict[str, Any]:
    """Return a layout for Foxglove and Lichtblick: live by foxglove-sdk or a bridge, and MCAP.

    One tab is the whole layout. Several are tabs of a panel; the events are in the first one.
    """
    panels: dict[str, Any] = {}
    within: dict[str, list[str]] = {tab: [] for tab in tabs}
    drawn = [(tab, item) for tab, found in tabs.items() for item in known_only(found, names)]
    for number, (tab, (title, fields)) in enumerate(drawn):
        within[tab].append(f'Plot!dz{number}')
        panels[f'Plot!dz{number}'] = {
            'title': title, 'isSynced': True, 'showLegend': True, 'legendDisplay': 'floating',
            'showPlotValuesInLegend': True, 'showXAxisLabels': True, 'showYAxisLabels': True,
            'xAxisVal': 'timestamp', 'followingViewWidth': 20, 'sidebarDimension': 240,
            'foxglovePanelTitle': title,
            'paths': [{'value': f'{place}/{names[name][0]}.data[{names[name][1]}]',
                       'label': name, 'enabled': True, 'timestampMethod': 'receiveTime',
                       'color': COLOURS[at % len(COLOURS)]} for at, name in enumerate(fields)]}
    panels['RawMessages!events'] = {'topicPath': f'{place}/events.data',
                                    'foxglovePanelTitle': 'Events'}
    within[next(iter(tabs))].append('RawMessages!events')
    trees = {tab: _mosaic(inside, 'row') for tab, inside in within.items()}
    if len(trees) > 1:
        panels['Tab!dz'] = {'activeTabIdx': 0, 'tabs': [
            {'title': tab, 'layout': tree} for tab, tree in trees.items()]}
    return {'configById': panels, 'globalVariables': {}, 'userNodes': {},
            'playbackConfig': {'speed': 1},
            'layout': 'Tab!dz' if len(trees) > 1 else trees.popitem()[1]}


def _mosaic(panels: list[str], direction: str) -> Any:
    """Return panels side by side and below each other, halved again and again."""
    if len(panels) == 1:
        return panels[0]
    half = -(-len(panels) // 2)
    other = 'column' if direction == 'row' else 'row'
    return {'direction': direction, 'first': _mosaic(panels[:half], other),
            'second': _mosaic(panels[half:], other),
            'splitPercentage': round(100.0 * half / len(panels), 1)}


def plotjuggler(tabs: dict[str, Plots], names: Names, place: str, live: bool,
                longest: int) -> bytes:
    """Return a layout for PlotJuggler: of live ROS topics, or of an MCAP file.

    Args:
        tabs: Title → plots of each tab, two or more of them.
        names: Where the fields are.
        place: Namespace with its slash, or ''.
        live: Whether it is of topics.
        longest: Numbers of the longest message; PlotJuggler takes no array that is longer than
            `max_array_size`, and the rows of all axes count.
    """
    def under(parent: ET.Element, tag: str, text: str = '', /,
              **attributes: str) -> ET.Element:
        found = ET.SubElement(parent, tag, attributes)
        found.text = text or None
        return found

    root = ET.Element('root')
    window = under(root, 'tabbed_widget', name='Main Window', parent='main_window')
    for tab, found in tabs.items():
        container = under(under(window, 'Tab', tab_name=tab, containers='1'), 'Container')
        columns = under(container, 'DockSplitter', orientation='|', count='2', sizes='0.5;0.5')
        for part in (found[::2], found[1::2]):
            rows = under(columns, 'DockSplitter', orientation='-', count=str(len(part)),
                         sizes=';'.join([f'{1.0 / len(part):.6f}'] * len(part)))
            for title, fields in part:
                plot = under(under(rows, 'DockArea', name=title), 'plot', mode='TimeSeries',
                             style='Lines', flip_x='false', flip_y='false')
                under(plot, 'range', left='0', right='20', bottom='-1', top='1')
                under(plot, 'limitY')
                for at, name in enumerate(fields):
                    under(plot, 'curve', name=name, color=COLOURS[at % len(COLOURS)])
    under(window, 'currentTabIndex', index='0')
    under(root, 'use_relative_time_offset', enabled='1')
    plugins = under(root, 'Plugins')
    allowed = str(max(100, longest))
    topics = [f'{place}/{topic}' for topic in dict.fromkeys(topic for topic, _ in names.values())]
    if live:
        plugin = under(plugins, 'plugin', ID='ROS2 Topic Subscriber')
        under(plugin, 'use_header_stamp', value='false')
        under(plugin, 'discard_large_arrays', value='true')
        under(plugin, 'max_array_size', value=allowed)
        chosen = under(plugin, 'selected_topics')
        for topic in topics:
            under(chosen, 'topic', name=topic)
        under(root, 'previouslyLoaded_Streamer', name='ROS2 Topic Subscriber')
    else:
        under(under(plugins, 'plugin', ID='DataLoad MCAP'), 'parameters', max_array_size=allowed,
              use_timestamp='0', clamp_large_arrays='0', selected_topics=';'.join(topics))
    equations = under(root, 'customMathEquations')
    curves = {name: ('return value', [name]) for name in names}
    for name in names:
        axis, dot, field = name.rpartition('.')
        if field == 'x0':
            curves[f'{axis}{dot}{ERROR}'] = ('return value - v1', [name, f'{axis}{dot}xd0'])
    for name, (function, sources) in curves.items():
        snippet = under(equations, 'snippet', name=name)
        under(snippet, 'global')
        under(snippet, 'function', function)
        first, *others = (f'{place}/{names[item][0]}/data[{names[item][1]}]' for item in sources)
        under(snippet, 'linked_source', first)
        if others:
            more = under(snippet, 'additional_sources')
            for number, source in enumerate(others, 1):
                under(more, f'v{number}', source)
    ET.indent(root, ' ')
    return ET.tostring(root, encoding='UTF-8', xml_declaration=True) + b'\n'


def layouts(c: Configuration, namespace: str = '', axis: str = '') -> dict[str, bytes]:
    """Return file name → contents, of all axes or of one.

    Raises:
        ConfigurationError: There is no such axis.
    """
    longest = max(1, len(c.axes)) * max(len(fields) for fields in fields_of(c).values())
    place = f'/{namespace.strip("/")}' if namespace.strip('/') else ''
    names: Names = {}
    tabs: dict[str, Plots] = {}
    if axis or len(c.axes) < 2:
        own = c.axis(axis) if axis else c
        names = names_of(own, c.axis_names.index(axis) if axis else 0)
        tabs['dz_ros'] = plots(own, names)
    else:
        tabs[ALL_AXES] = common_plots(c)
        for row, (name, item) in enumerate(c.axes):
            found = names_of(item, row)
            names.update((f'{name}.{field}', where) for field, where in found.items())
            tabs[name] = [(title, [f'{name}.{field}' for field in fields])
                          for title, fields in plots(item, found)]
    text = json.dumps(foxglove(tabs, names, place), indent=1, ensure_ascii=False) + '\n'
    return {'foxglove.json': text.encode(),
            'plotjuggler_ros2.xml': plotjuggler(tabs, names, place, True, longest),
            'plotjuggler_mcap.xml': plotjuggler(tabs, names, place, False, longest)}


def main() -> int:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('config', nargs='?', default='robust',
                        help='configuration, as of dz run')
    parser.add_argument('--out', type=Path, default=ROOT / 'config' / 'layouts')
    parser.add_argument('--namespace', default='', help='of the loop')
    parser.add_argument('--axis', default='', help='of several: layouts of this one alone')
    arguments = parser.parse_args()
    try:
        made = layouts(load_configuration(arguments.config), arguments.namespace, arguments.axis)
    except ConfigurationError as error:
        print(f'make_layouts: error: {error}', file=sys.stderr)
        return 2
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, contents in made.items():
        (arguments.out / name).write_bytes(contents)
        print(arguments.out / name)
    return 0


if __name__ == '__main__':
    sys.exit(main())
