# SPDX-License-Identifier: Apache-2.0
"""Configurations in files: found, read as YAML 1.2, written, refused with key and line.

Over 300 lines: a file of each kind of mistake is in the text of its test.
"""

import math
import os
from pathlib import Path
import re

from hypothesis import given
from hypothesis import strategies as st
import pytest
import yaml

from dz_ros.core.axes_keys import is_machines, parts
from dz_ros.core.configuration import Configuration
from dz_ros.errors import ConfigurationError
from dz_ros.files.configurations import (
    configuration_folders,
    find_configuration,
    flat_parameters,
    load_configuration,
    shipped_configurations,
    write_parameters,
)


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding='utf-8')
    return path


def message(function, *arguments) -> str:
    """Return the one line with which a call is refused."""
    with pytest.raises(ConfigurationError) as caught:
        function(*arguments)
    text = str(caught.value)
    assert '\n' not in text
    return text


def test_no_file_is_the_default_configuration():
    assert load_configuration(None).to_flat() == Configuration.from_flat({}).to_flat()


@pytest.mark.parametrize('text', [
    'plant:\n  b: 0.5\n  dead_zone: {b_r: 0.3}\n',
    '/**:\n  ros__parameters:\n    plant:\n      b: 0.5\n      dead_zone: {b_r: 0.3}\n',
    '/**: {ros__parameters: {plant.b: 0.5, plant.dead_zone.b_r: 0.3}}\n',
    '/*/plant_node: {ros__parameters: {plant: {b: 0.5, dead_zone.b_r: 0.3}}}\n',
    '/left/plant_node: {ros__parameters: {plant: {b: 0.5, dead_zone: {b_r: 3e-1}}}}\n',
    'left: {plant_node: {ros__parameters: {plant: {b: 0.5, dead_zone: {b_r: .3}}}}}\n',
    '/left: {"*": {ros__parameters: {plant: {b: 0.5, dead_zone: {b_r: .3}}}}}\n',
    '/right/plant_node: {ros__parameters: {plant: {b: 9.0}}}\n'
    '/**/actuator_node: {ros__parameters: {plant: {b: 0.5, dead_zone: {b_r: .3}}}}\n'
    'camera_node: {ros__parameters: {exposure: 3}}\n',
])
def test_every_form_of_file_gives_the_same_keys(tmp_path, text):
    file = write(tmp_path / 'c.yaml', text)
    assert flat_parameters(file, namespace='left') == {'plant.b': 0.5, 'plant.dead_zone.b_r': 0.3}


def test_sections_of_nodes_are_merged_in_the_order_of_the_file(tmp_path):
    file = write(tmp_path / 'c.yaml', """
/**: {ros__parameters: {plant: {b: 0.5, a1: 2.0}}}
plant_node: {ros__parameters: {plant: {b: 0.7}, use_sim_time: true}}
controller_node: {ros__parameters: {controller: {lambda: 2}, qos_overrides: {x: 1}}}
""")
    assert flat_parameters(file) == {'plant.b': 0.7, 'plant.a1': 2.0, 'controller.lambda': 2}


@pytest.mark.parametrize(('text', 'part'), [
    ('plant:\n  b: 1\n  b: 2\n', 'line 3: b is given twice'),
    ('plant: {b: 1}\nplant.b: 2\n', 'given twice'),
    ('plant:\n  b: [1\n', 'line 3'),
    ('plant:\n\tb: 1\n', 'line 2'),
    ('', 'is empty'),
    ('# nothing\n', 'is empty'),
    ('- 1\n- 2\n', 'mapping'),
    ('plant:\n  b:\n', 'plant.b = None: has no value'),
    ('/**: {ros__parameters: 3}\n', 'ros__parameters of /** must be a mapping'),
    ('/**: {ros__parameters: {plant: {b: 1}}, plant: {b: 2}}\n', 'below ros__parameters'),
    ('/**: {ros__parameters: {plant: {b: 1}}}\nplant: {b: 2}\n', 'beside ros__parameters'),
    ('a: &x {b: 1}\nc: *x\n', 'aliases'),
])
def test_a_file_that_cannot_be_used_is_one_line_that_reports_where(tmp_path, text, part):
    assert part in message(flat_parameters, write(tmp_path / 'c.yaml', text))


@pytest.mark.parametrize(('text', 'part'), [
    ('plant: {bb: 1}', 'did you mean plant.b'),
    ('nonsense: {b: 1}', 'unknown key'),
    ('plant: 3', 'unknown key'),
    ('plant: {b: true}', 'plant.b = True: must be a finite number > 0'),
    ('plant: {b: .nan}', 'must be a finite number'),
    ('loop: {rate: 200 Hz}', "loop.rate = '200 Hz': must be a finite number"),
    ('1: {b: 1}', 'unknown key'),
])
def test_what_a_file_reports_is_checked(tmp_path, text, part):
    assert part in message(load_configuration, write(tmp_path / 'c.yaml', text))


def test_files_that_are_no_files(tmp_path):
    assert 'no such file' in message(flat_parameters, tmp_path / 'missing.yaml')
    assert 'wang2004' in message(flat_parameters, 'missing')
    assert 'directory' in message(flat_parameters, tmp_path)
    binary = tmp_path / 'c.yaml'
    binary.write_bytes(b'\xff\xfe\x00\x01')
    assert 'UTF-8' in message(flat_parameters, binary)


def test_a_file_that_must_not_be_read(tmp_path, monkeypatch):
    file = write(tmp_path / 'c.yaml', 'plant: {b: 1}')

    def refuse(*_, **__):
        raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr(Path, 'read_text', refuse)
    assert 'cannot be read: Permission denied' in message(flat_parameters, file)


def test_shipped_configurations_are_found_by_name_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert 'wang2004' in shipped_configurations()
    for name in ('wang2004', 'wang2004.yaml'):
        assert find_configuration(name).name == 'wang2004.yaml'
    own = write(tmp_path / 'wang2004', 'plant: {b: 0.5}')
    assert find_configuration('wang2004') == own.relative_to(tmp_path)
    assert 'no such file' in message(find_configuration, 'elsewhere/wang2004')


def test_configurations_of_a_workspace_are_found_through_the_ament_prefix(tmp_path, monkeypatch):
    folder = tmp_path / 'install' / 'dz_ros' / 'share' / 'dz_ros' / 'config'
    folder.mkdir(parents=True)
    write(folder / 'only_here.yaml', 'plant: {b: 0.5}')
    assert 'only_here' not in shipped_configurations()
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere::{tmp_path}/install/dz_ros')
    assert folder in configuration_folders()
    assert flat_parameters('only_here') == {'plant.b': 0.5}


@pytest.mark.parametrize(('override', 'expected'), [
    ('controller.lambda=2', {'controller.lambda': 2}),
    ('controller.lambda = 2e0', {'controller.lambda': 2.0}),
    ('plant.x0=[1, -2.5]', {'plant.x0': [1, -2.5]}),
    ('plant.dead_zone={b_r: 0.3, b_l: -1}',
     {'plant.dead_zone.b_r': 0.3, 'plant.dead_zone.b_l': -1}),
    ('controller.law=my.module:Law', {'controller.law': 'my.module:Law'}),
    ('trajectory.repeat=yes', {'trajectory.repeat': True}),
    ('plant.model="=x"', {'plant.model': '=x'}),
])
def test_overrides_are_yaml(override, expected):
    assert flat_parameters(None, [override]) == expected


def test_the_last_override_counts_and_stands_above_the_file(tmp_path):
    file = write(tmp_path / 'c.yaml', 'plant: {b: 0.5}')
    assert flat_parameters(file, ['plant.b=1', 'plant.b=2']) == {'plant.b': 2}


@pytest.mark.parametrize('override', [
    '', '=', '=1', 'plant.b', 'plant.b=', 'plant.b=~', 'plant.x0=[1', 'plant.x0=[1, ~', 'x=1',
    'plant.b=one', 'plant.b=[1]', 'loop.delay=0.5', 'loop.seed=-1', 'loop.rate=.inf',
    'plant.model=nope', 'plant.model=no.such:Module', 'plant.b=!!float x', 'plant={}',
    'controller.theta_0=[1, 2, 3]', 'plant.x0={a: }',
])
def test_overrides_that_cannot_be_used(override):
    if override == 'plant={}':      # nothing is reported, so nothing is wrong
        assert flat_parameters(None, [override]) == {}
    else:
        assert message(load_configuration, None, [override])


NUMBERS = st.floats(-1e300, 1e300)


@given(st.lists(NUMBERS, min_size=2, max_size=2), st.floats(1e-300, 1e300),
       st.text(st.characters(exclude_categories=['Cs', 'Cc']), max_size=10), st.integers(0, 2**62))
def test_what_is_written_is_read_again_bit_for_bit(tmp_path_factory, x0, b, word, seed):
    configuration = Configuration.from_flat({
        'plant.x0': x0, 'plant.b': b, 'loop.seed': seed, 'loop.peers': [word, 'yes', '1e3', '~']})
    path = tmp_path_factory.mktemp('written') / 'p.yaml'
    write_parameters(configuration, path)
    assert load_configuration(path).to_flat() == configuration.to_flat()


@pytest.mark.parametrize('name', sorted(shipped_configurations()))
def test_written_files_are_what_ros_reads(name, tmp_path):
    configuration = load_configuration(name)
    path = tmp_path / 'p.yaml'
    write_parameters(configuration, path)
    text = path.read_text(encoding='utf-8')
    assert '[]' not in text     # rcl refuses it to a node that declares all it is given
    written = yaml.safe_load(text)['/**']['ros__parameters']    # YAML 1.1, as other tools read it
    for key, value in configuration.to_flat().items():
        if configuration.axes and not parts(key)[0] and not is_machines(key):
            continue        # of several axes, each has its own
        branch = written
        for part in key.split('.'):
            branch = branch.get(part, {}) if isinstance(branch, dict) else branch
        if isinstance(value, list) and not value:
            assert branch == {}
            continue
        assert branch == value, key
        assert type(branch) is type(value), key
        if isinstance(value, list):
            assert all(type(item) in (float, str) for item in branch), key
    with pytest.raises(FileExistsError):
        write_parameters(configuration, path)


def test_rcl_itself_reads_what_is_written(tmp_path, ros_domain):
    rclpy = pytest.importorskip('rclpy', reason='needs rclpy')
    configuration = load_configuration(None, [
        'controller.epsilon=1e-5', 'plant.x0=[1e-300, -2]', 'loop.peers=["yes", "1"]'])
    path = tmp_path / 'p.yaml'
    write_parameters(configuration, path)
    context = rclpy.Context()
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    try:
        node = rclpy.create_node('reader', context=context,
                                 automatically_declare_parameters_from_overrides=True)
        read = {key: parameter.value
                for key, parameter in node.get_parameters_by_prefix('').items()}
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    for key, value in configuration.to_flat().items():
        if value != []:
            found = list(read[key]) if isinstance(value, list) else read[key]
            assert found == value, key
            assert type(found) is type(value), key


def test_a_node_takes_an_empty_list_that_is_not_the_default(tmp_path, ros_domain):
    rclpy = pytest.importorskip('rclpy', reason='needs rclpy')
    from dz_ros.nodes.ros.parameters import configure
    path = tmp_path / 'p.yaml'
    write_parameters(load_configuration(None, ['loop.peers=[]']), path)
    for words in (['--params-file', str(path)], ['-p', 'loop.peers:=[]']):
        context = rclpy.Context()
        rclpy.init(args=['--ros-args', *words], context=context)
        try:
            node = rclpy.create_node('reader', context=context)
            assert configure(node, 'loop').loop.peers == ()
            node.destroy_node()
        finally:
            rclpy.shutdown(context=context)


WAYPOINTS = """# from the plotter
t, x
0, 0.0

1.5, 1e0
 2 , -3
"""


def test_waypoints_are_read_beside_the_configuration(tmp_path, monkeypatch):
    (tmp_path / 'paths').mkdir()
    write(tmp_path / 'paths' / 'w.csv', WAYPOINTS)
    file = write(tmp_path / 'paths' / 'c.yaml', 'trajectory: {kind: waypoints, file: w.csv}')
    monkeypatch.chdir(tmp_path)
    expected = {'trajectory.kind': 'waypoints', 'trajectory.times': [0.0, 1.5, 2.0],
                'trajectory.positions': [0.0, 1.0, -3.0]}
    assert flat_parameters(file) == expected
    assert flat_parameters(None, ['trajectory.kind=waypoints', 'trajectory.file=paths/w.csv']) \
        == expected
    trajectory = load_configuration(file).trajectory
    for t, x in zip(expected['trajectory.times'], expected['trajectory.positions'], strict=True):
        assert math.isclose(trajectory(t)[0], x, abs_tol=1e-12)


def test_waypoints_stand_alone_once_they_are_read(tmp_path):
    write(tmp_path / 'w.csv', WAYPOINTS)
    file = write(tmp_path / 'c.yaml', 'trajectory: {kind: waypoints, file: w.csv}')
    configuration = load_configuration(file)
    copy = tmp_path / 'elsewhere' / 'p.yaml'
    copy.parent.mkdir()
    write_parameters(configuration, copy)
    assert load_configuration(copy).to_flat() == configuration.to_flat()


@pytest.mark.parametrize(('content', 'part'), [
    (b'', 'no way-points'),
    (b't,x\n', 'no way-points'),
    (b'0,1\n1,two\n', "line 2: must be two finite numbers t, x, found '1,two'"),
    (b'0,1\n1\n', 'line 2'),
    (b'0,1\n1,2,3\n', 'line 2'),
    (b'0,1\n1,nan\n', 'line 2'),
    (b'0,inf\n', 'line 1'),
    (b'0,1\n\n1,1\n1,2\n', 'line 4: times must increase, 1 follows 1'),
    (b'0,1\nt,x\n', 'line 2'),
    (b'0;1\n', 'line 1'),
    (b'\xff\xfe', 'UTF-8'),
])
def test_waypoints_that_cannot_be_used(tmp_path, content, part):
    (tmp_path / 'w.csv').write_bytes(content)
    override = f'trajectory.file={tmp_path / "w.csv"}'
    text = message(flat_parameters, None, [override])
    assert part in text
    assert text.startswith('trajectory.file = ')


def test_waypoints_that_are_not_there(tmp_path):
    assert 'no such file' in message(flat_parameters, None, ['trajectory.file=/nowhere/w.csv'])
    os.mkfifo(tmp_path / 'pipe')
    with (tmp_path / 'large').open('wb') as file:
        file.truncate(2**40)
    for name, why in ((tmp_path, 'is not a file'), (tmp_path / 'pipe', 'is not a file'),
                      ('/dev/zero', 'is not a file'), (tmp_path / 'large', 'is larger than')):
        assert why in message(flat_parameters, None, [f'trajectory.file={name}'])
    assert 'path of a CSV' in message(flat_parameters, None, ['trajectory.file=3'])
    write(tmp_path / 'w.csv', '0,0\n1,1\n')
    file = write(tmp_path / 'c.yaml', 'trajectory: {file: w.csv, times: [0.0, 1.0]}')
    assert re.search(r'trajectory.times .* leave one out', message(flat_parameters, file))


@pytest.mark.parametrize('name', [name for name in shipped_configurations()
                                  if not load_configuration(name).make_driver().lockstep])
def test_a_device_whose_measurement_stands_still_is_noticed(name):
    """Wherever it stands, the reference goes further away from it than the limit."""
    for configuration in load_configuration(name).each:
        limit = configuration.safety.error_limit
        x_d = [configuration.trajectory(k * 0.05)[0] for k in range(400)]
        assert 0.0 < limit < (max(x_d) - min(x_d)) / 2.0
        assert abs(configuration.x0[0] - x_d[0]) < limit      # yet it can start


def test_every_driver_of_a_device_has_such_a_configuration():
    found = {load_configuration(name).driver_settings.name for name in shipped_configurations()}
    assert {'joint', 'serial', 'cia402'} <= found
