# SPDX-License-Identifier: Apache-2.0
"""`dz bag audit` on our runs, on bags of other tools, and on live loops."""

from importlib.util import find_spec
import json
from pathlib import Path
import shutil

import numpy as np
import pytest

from dz_ros.cli.main import main
from dz_ros.core.dataset import Channel, RunData
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run

ARRAY, TEXT = 'std_msgs/msg/Float64MultiArray', 'std_msgs/msg/String'
EQUAL = 'every command and every estimate is reproduced bit for bit'


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    run = tmp_path_factory.mktemp('runs') / 'run'
    assert main(['simulate', 'wang2004', '--duration', '2', '--record', str(run)]) == 0
    return run


def foreign(data: RunData, path: Path, storage: str, events: bool = True) -> Path:
    """Write a bag with another library, as `ros2 bag record` would: no metadata of ours."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    layout = store.types['std_msgs/msg/MultiArrayLayout']
    dimension = store.types['std_msgs/msg/MultiArrayDimension']
    plugin = getattr(rosbag2.StoragePlugin, storage.upper())
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        if events:
            topic = writer.add_connection('/events', TEXT, typestore=store)
            for time, _, text in data.events:
                writer.write(topic, time, store.serialize_cdr(store.types[TEXT](text), TEXT))
        for name, channel in data.channels.items():
            topic = writer.add_connection(f'/{name}', ARRAY, typestore=store)
            size, label = len(channel.labels), ','.join(channel.labels)
            for row, time in zip(channel.values, channel.log_time.tolist(), strict=True):
                message = store.types[ARRAY](layout([dimension(label, size, size)], 0), row.copy())
                writer.write(topic, time, store.serialize_cdr(message, ARRAY))
    return path


def stated(data: RunData) -> RunData:
    """Return the run with the event that a controller states its configuration by."""
    return RunData(data.channels, data.configuration, data.info, ((
        int(data.channels['state'].log_time[0]) - 1, '/controller_node', json.dumps({
            'node': '/controller_node', 'event': 'configuration', 'owns': ['controller'],
            'version': '0.1.0', 'configuration': dict(data.configuration), 'seq': 0,
            'memory': [0.85, 0.85, 0.85]})),))


def tampered(data: RunData, name: str, label: str, row: int, value: float) -> RunData:
    channel = data.channels[name]
    values = channel.values.copy()
    values[row, channel.labels.index(label)] = value
    return RunData({**data.channels, name: Channel(
        channel.labels, values, channel.log_time, channel.publish_time)}, data.configuration,
        data.info, data.events)


def test_equal(recorded, capsys):
    assert main(['bag', 'audit', str(recorded)]) == 0
    text = capsys.readouterr().out
    assert text.splitlines()[-1] == EQUAL
    assert 'checked            401' in text


def test_a_tampered_value_is_named(recorded, tmp_path, capsys):
    save_run(tampered(read_run(recorded), 'command', 'v', 123, 1.5), tmp_path / 'b')
    assert main(['bag', 'audit', str(tmp_path / 'b')]) == 1
    text = capsys.readouterr().out
    assert 'first: command.v at seq 123, t = 0.615 s: recorded 1.5, recomputed ' in text
    assert 'differences          1' in text
    assert 'NOT PASSED' in text


def test_json(recorded, capsys):
    assert main(['bag', 'audit', str(recorded), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['passed'] is True
    assert found['checked'] == found['samples'] == 401
    assert found['fields']['command.v'] == {
        'compared': 401, 'differing': 0, 'first': None, 'largest': None}


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bags_of_other_tools(recorded, tmp_path, capsys, storage):
    data = stated(read_run(recorded))
    whole = foreign(data, tmp_path / 'whole', storage)
    assert main(['bag', 'audit', str(whole)]) == 0
    assert 'stated by /controller_node' in capsys.readouterr().out
    bare = foreign(data, tmp_path / 'bare', storage, events=False)
    assert main(['bag', 'audit', str(bare)]) == 1
    assert 'does not state which law and gains were used' in capsys.readouterr().out
    assert main(['bag', 'audit', str(bare), '--config', 'wang2004']) == 0
    assert main(['bag', 'audit', str(bare), '--config', 'wang2004', '--set',
                 'controller.k_d=11']) == 1
    assert 'terms.v_damping at seq 0' in capsys.readouterr().out


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_what_another_tool_did_not_record_is_named_not_passed(recorded, tmp_path, capsys, storage):
    data = read_run(recorded)
    few = RunData({name: data.channels[name] for name in ('state', 'reference', 'command')})
    bag = foreign(few, tmp_path / 'few', storage, events=False)
    assert main(['bag', 'audit', str(bag), '--config', 'wang2004']) == 1
    text = capsys.readouterr().out
    assert 'not checkable: 401 from seq 0 on: its terms are not in the log' in text
    assert 'differences          0' in text
    assert 'terms: the log has no messages of this channel' in text
    wrong = foreign(tampered(few, 'state', 'x0', 9, 0.0), tmp_path / 'wrong', storage)
    assert main(['bag', 'audit', str(wrong), '--config', 'wang2004']) == 1
    assert 'first: command.v at seq 9, ' in capsys.readouterr().out


def test_a_cut_run_is_checked_as_far_as_it_goes(recorded, tmp_path, capsys):
    copy = tmp_path / 'cut'
    shutil.copytree(recorded, copy)
    (mcap,) = copy.glob('*.mcap')
    with mcap.open('r+b') as file:
        file.truncate(mcap.stat().st_size * 6 // 10)
    main(['bag', 'audit', str(copy), '--config', 'wang2004'])
    text = capsys.readouterr().out
    assert 'differences          0' in text
    assert 'note: the log was cut off' in text


@pytest.mark.parametrize('words', [
    ['nowhere'], ['{run}', '--set', 'controller.k_d=11'], ['{run}', '--config', 'nothing'],
    ['{run}', '--config', 'wang2004', '--set', 'controller.kd=1'], []])
def test_mistakes_are_one_line(recorded, capsys, words):
    assert main(['bag', 'audit', *(word.format(run=recorded) for word in words)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.ros
@pytest.mark.skipif(find_spec('rclpy') is None, reason='rclpy is not installed')
@pytest.mark.parametrize('mode', [[], ['--lockstep']], ids=['realtime', 'lockstep'])
def test_live_loops(ros_domain, processes, tmp_path, patient, mode):
    run = tmp_path / 'run'
    loop = processes('-m', 'dz_ros', 'run', '--quiet', '--duration', '2', *mode, *patient,
                     '--record', str(run))
    assert loop.wait(90.0) == 0, loop.output
    judge = processes('-m', 'dz_ros', 'bag', 'audit', str(run))
    assert judge.wait() == 0, judge.output
    assert EQUAL in judge.output
    again = tmp_path / 'again'
    answer = processes('-m', 'dz_ros', 'bag', 'whatif', str(run), '--set', 'loop.seed=1',
                       '--record', str(again), '--out', str(tmp_path / 'out'))
    assert answer.wait() == 0, answer.output
    first, second = read_run(run), read_run(again)
    if mode:
        for name in ('state', 'command', 'terms'):
            columns = [i for i, label in enumerate(first.channels[name].labels)
                       if label not in ('echo_stamp', 'echo_seq', 'round_trip')]
            assert np.array_equal(first.channels[name].values[:, columns],
                                  second.channels[name].values[:, columns])
    else:
        assert 'ms after its state (median)' in answer.output
