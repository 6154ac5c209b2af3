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
    seen = set()
    for panel in layout['configById'].values():
        for path in panel.get('paths', ()):
            topic, place = re.fullmatch(r'/(\w+)\.data\[(\d+)\]', path['value']).groups()
            name, values = number(run, topic, int(place))
            assert name == path['label']
            assert np.isfinite(values).all()
            seen.add(name)
    assert {'x0', 'xd0', 'v', 'w', 's', 'theta1', 'phi', 'v_robust', 'round_trip'} <= seen

    def panels(node):
        return {node} if isinstance(node, str) else panels(node['first']) | panels(node['second'])

    assert panels(layout['layout']) == set(layout['configById'])


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


@pytest.mark.parametrize(('words', 'reported'), [
    (('six_axes',), '--axis'), (('six_axes', '--axis', 'jaw'), 'must be one of base, shoulder'),
    (('robust', '--axis', 'yaw'), 'the loop has one axis')])
def test_an_axis_that_is_not_there_is_one_line_and_writes_nothing(tmp_path, words, reported):
    done = write_layouts(tmp_path / 'out', *words)
    assert done.returncode == 2
    assert reported in done.stderr
    assert done.stderr.count('\n') == 1
    assert not (tmp_path / 'out').exists()
