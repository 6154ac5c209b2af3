# SPDX-License-Identifier: Apache-2.0
"""The layouts that come with the package: they are what the tool writes, and point at the data."""

import importlib.util
import json
from pathlib import Path
import re
import subprocess
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, from_runs
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import load_configuration
from dz_ros.runs.axes import axis_run

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / 'config' / 'layouts'


@pytest.fixture(scope='module')
def tool():
    spec = importlib.util.spec_from_file_location('make_layouts',
                                                  ROOT / 'tools' / 'make_layouts.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def run():
    return from_run(simulate(load_configuration('robust', ['loop.duration=1.0'])))


def panels(node):
    """Return the panels of a layout or of a tab."""
    return {node} if isinstance(node, str) else panels(node['first']) | panels(node['second'])


def number(run, topic, place):
    """Return the column that a tool would draw, and its name."""
    channel = run.channels[topic]
    return channel.labels[place], channel.values[:, place]


def test_files_are_what_the_tool_writes(tool):
    made = tool.layouts(load_configuration('robust'))
    assert {path.name for path in FOLDER.iterdir()} == set(made)
    for name, contents in made.items():
        assert (FOLDER / name).read_bytes() == contents, f'{name}: python tools/make_layouts.py'


def test_foxglove_s_series_are_the_fields_they_are_called(run):
    layout = json.loads((FOLDER / 'foxglove.json').read_text(encoding='utf-8'))
    assert panels(layout['layout']) == set(layout['configById'])
    seen = set()
    for panel in layout['configById'].values():
        for path in panel.get('paths', ()):
            topic, place = re.fullmatch(r'/(\w+)\.data\[(\d+)\]', path['value']).groups()
            name, values = number(run, topic, int(place))
            assert name == path['label']
            assert np.isfinite(values).all()
            seen.add(name)
    assert {'x0', 'xd0', 'v', 'w', 's', 'theta1', 'phi', 'v_robust', 'round_trip'} <= seen


@pytest.mark.parametrize('name', ['plotjuggler_ros2.xml', 'plotjuggler_mcap.xml'])
def test_plotjuggler_s_curves_exist_and_are_the_fields_they_are_called(run, name):
    root = ET.parse(FOLDER / name).getroot()
    snippets = {item.get('name'): item for item in root.iter('snippet')}
    for label, snippet in snippets.items():
        topic, place = re.fullmatch(r'/(\w+)/data\[(\d+)\]',
                                    snippet.findtext('linked_source')).groups()
        source, _ = number(run, topic, int(place))
        assert source == ('x0' if label == 'error' else label)
    assert snippets['error'].findtext('additional_sources/v1') == '/reference/data[2]'
    curves = {item.get('name') for item in root.iter('curve')}
    assert 'error' in curves
    assert curves <= set(snippets)
    for splitter in root.iter('DockSplitter'):
        assert len(splitter) == int(splitter.get('count')) == len(
            splitter.get('sizes').split(';'))
    live = root.find('previouslyLoaded_Streamer')
    assert (live is not None) == ('ros2' in name)


@pytest.mark.parametrize('flat', [{'plant.model': 'first_order'}, {'controller.law': 'pd'},
                                  {'plant.model': 'valve_actuator'}])
def test_other_loops_have_layouts_as_well(tool, flat):
    made = tool.layouts(Configuration.from_flat(flat), 'left')
    assert b'/left/state.data[2]' in made['foxglove.json']
    assert b'/left/state/data[2]' in made['plotjuggler_ros2.xml']
    assert (b'theta1' in made['foxglove.json']) == (flat.get('controller.law') != 'pd')


def write_layouts(folder, *words):
    """Run the tool as a process."""
    return subprocess.run([sys.executable, ROOT / 'tools' / 'make_layouts.py', *words, '--out',
                           folder], capture_output=True, text=True, check=False)


@pytest.mark.parametrize('axis', ['base', 'yaw'])
def test_the_layouts_of_an_axis_draw_its_row_of_the_messages(tmp_path, axis):
    machine = load_configuration('six_axes', ['loop.duration=0.2'])
    whole = from_runs(simulate_axes(machine), machine)
    own = axis_run(whole, axis)
    done = write_layouts(tmp_path, 'six_axes', '--axis', axis, '--namespace', 'left')
    assert (done.returncode, done.stderr) == (0, '')

    def check(topic, place, label):
        values = whole.channels[topic].values
        assert np.array_equal(values[:, int(place)], own.channels[topic][label]), (topic, label)

    layout = json.loads((tmp_path / 'foxglove.json').read_text(encoding='utf-8'))
    drawn = [path for panel in layout['configById'].values() for path in panel.get('paths', ())]
    assert {'x0', 'xd0', 'v', 'w'} <= {path['label'] for path in drawn}
    for path in drawn:
        check(*re.fullmatch(r'/left/(\w+)\.data\[(\d+)\]', path['value']).groups(), path['label'])
    longest = max(channel.values.shape[1] for channel in whole.channels.values())
    assert longest > 100
    for name in ('plotjuggler_ros2.xml', 'plotjuggler_mcap.xml'):
        root = ET.parse(tmp_path / name).getroot()
        snippets = {item.get('name'): item.findtext('linked_source')
                    for item in root.iter('snippet')}
        assert {'x0', 'xd0', 'v', 'w', 'error'} <= set(snippets)
        for label, source in snippets.items():
            check(*re.fullmatch(r'/left/(\w+)/data\[(\d+)\]', source).groups(),
                  'x0' if label == 'error' else label)
        # PlotJuggler leaves out arrays that are longer than this, whichever row is drawn.
        sizes = [int(item.get('value') or item.get('max_array_size')) for item in root.iter()
                 if item.tag == 'max_array_size' or 'max_array_size' in item.attrib]
        assert sizes == [longest]


@pytest.mark.parametrize('name', ['six_axes', 'rov_planar', 'two_link_arm'])
def test_the_layouts_of_a_machine_have_a_tab_for_all_axes_and_one_for_each(tmp_path, name):
    machine = load_configuration(name, ['loop.duration=0.1'])
    whole = from_runs(simulate_axes(machine), machine)
    runs = {axis: axis_run(whole, axis) for axis in machine.axis_names}
    tabs = ['all axes', *machine.axis_names]
    done = write_layouts(tmp_path, name, '--namespace', 'left')
    assert (done.returncode, done.stderr) == (0, '')

    def check(topic, place, label, field=None):
        axis, _, own = label.partition('.')
        assert np.array_equal(whole.channels[topic].values[:, int(place)],
                              runs[axis].channels[topic][field or own]), label

    layout = json.loads((tmp_path / 'foxglove.json').read_text(encoding='utf-8'))
    every = layout['configById']
    assert layout['layout'] == 'Tab!dz'
    own = {tab['title']: panels(tab['layout']) for tab in every['Tab!dz']['tabs']}
    assert list(own) == tabs
    assert sorted(item for found in own.values() for item in found) == sorted(
        {*every} - {'Tab!dz'})
    assert 'RawMessages!events' in own['all axes']     # mode and e-stop
    for tab, found in own.items():
        labels = {path['label'] for item in found for path in every[item].get('paths', ())}
        if tab == 'all axes':
            assert labels == {f'{axis}.{field}' for axis in machine.axis_names
                              for field in ('x0', 'v', 's_eps', 'status')} | {
                f'{tabs[1]}.round_trip', f'{tabs[1]}.hold'}     # the same in every row
        else:
            assert {f'{tab}.{field}' for field in ('x0', 'xd0', 'v', 'w', 's')} <= labels
            assert {label.partition('.')[0] for label in labels} == {tab}
    for panel in every.values():
        for path in panel.get('paths', ()):
            check(*re.fullmatch(r'/left/(\w+)\.data\[(\d+)\]', path['value']).groups(),
                  path['label'])
    for file in ('plotjuggler_ros2.xml', 'plotjuggler_mcap.xml'):
        root = ET.parse(tmp_path / file).getroot()
        assert [tab.get('tab_name') for tab in root.iter('Tab')] == tabs
        snippets = {item.get('name'): item for item in root.iter('snippet')}
        for label, snippet in snippets.items():
            source = snippet.findtext('linked_source')
            topic, place = re.fullmatch(r'/left/(\w+)/data\[(\d+)\]', source).groups()
            check(topic, place, label, 'x0' if label.endswith('.error') else None)
        assert {f'{axis}.error' for axis in machine.axis_names} <= set(snippets)
        for tab in root.iter('Tab'):
            curves = {item.get('name') for item in tab.iter('curve')}
            assert curves <= set(snippets)
            assert curves & {f'{axis}.error' for axis in machine.axis_names} == (
                {f'{axis}.error' for axis in machine.axis_names}
                if tab.get('tab_name') == 'all axes' else {f'{tab.get("tab_name")}.error'})
        for splitter in root.iter('DockSplitter'):
            assert len(splitter) == int(splitter.get('count')) == len(
                splitter.get('sizes').split(';'))


def test_axes_of_different_units_do_not_share_a_plot(tool):
    made = tool.layouts(load_configuration('rov_planar'))
    drawn = {panel['title']: [path['label'] for path in panel['paths']] for panel in json.loads(
        made['foxglove.json'])['configById'].values() if 'paths' in panel}
    assert drawn['Output [m]'] == ['surge.x0', 'sway.x0']
    assert drawn['Output [rad]'] == ['yaw.x0']
    assert drawn['Command v [N m]'] == ['yaw.v']
    areas = [area for area in ET.fromstring(made['plotjuggler_mcap.xml']).iter('DockArea')
             if area.get('name').startswith('Error [')]
    assert {area.get('name'): [curve.get('name') for curve in area.iter('curve')]
            for area in areas} == {'Error [m]': ['surge.error', 'sway.error'],
                                   'Error [rad]': ['yaw.error']}


def test_what_looking_md_reads_from_a_message_is_the_number_it_names():
    text = (ROOT / 'docs' / 'looking.md').read_text(encoding='utf-8')
    machine = load_configuration('rov_planar', ['loop.duration=0.1'])
    whole = from_runs(simulate_axes(machine), machine)
    paths = re.findall(r'/(state|command)/data\[(\d+)\]', text)
    named = re.search(r'rqt_plot .*# (.*)', text).group(1).split(', ')
    assert len(paths) == len(named) == 2
    for (topic, place), label in zip(paths, named, strict=True):
        axis, _, field = label.partition('.')
        assert np.array_equal(whole.channels[topic].values[:, int(place)],
                              axis_run(whole, axis).channels[topic][field]), label


@pytest.mark.parametrize(('words', 'reported'), [
    (('six_axes', '--axis', 'jaw'), 'must be one of base, shoulder'),
    (('robust', '--axis', 'yaw'), 'the loop has one axis')])
def test_an_axis_that_is_not_there_is_one_line_and_writes_nothing(tmp_path, words, reported):
    done = write_layouts(tmp_path / 'out', *words)
    assert done.returncode == 2
    assert reported in done.stderr
    assert done.stderr.count('\n') == 1
    assert not (tmp_path / 'out').exists()
