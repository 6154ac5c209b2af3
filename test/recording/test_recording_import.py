# SPDX-License-Identifier: Apache-2.0
"""Columns of other tools' files become runs: signals, factors, times, gaps; nothing is made up.

Over 300 lines: all of it maps columns of the same made-up logs.
"""

import time
import tracemalloc
import warnings

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import own_period
from dz_ros.core.records import State
from dz_ros.errors import ConfigurationError, MessageError, RecordingError
from dz_ros.recording import import_csv
from dz_ros.recording.import_columns import Column, read_bag
from dz_ros.recording.import_csv import read_table, table_names
from dz_ros.recording.import_map import check_signals, parse_source, split_map
from dz_ros.recording.import_run import import_run
from dz_ros.recording.message_fields import MessageType, MOST_NUMBERS
from dz_ros.recording.run_source import open_source

PERIOD = 0.005
COLUMNS = ('t', 'x', 'x-dot', 'angle_deg', 'angle', 'a b', 'v')


def axis(**changes):
    return Configuration.from_flat({'plant.model': 'axis', 'loop.rate': 1.0 / PERIOD, **changes})


@pytest.mark.parametrize(('text', 'column', 'factor', 'offset'), [
    ('angle_deg*0.0174533', 'angle_deg', 0.0174533, 0.0), ('angle*deg', 'angle', np.pi / 180, 0.0),
    ('x-dot', 'x-dot', 1.0, 0.0), ('x-1', 'x', 1.0, -1.0), ('x / 60 + .5', 'x', 1 / 60, 0.5),
    ('"a b"*-1', 'a b', -1.0, 0.0), ('v*1e-3-2E0', 'v', 1e-3, -2.0),
    ('x-dot/rpm', 'x-dot', 30 / np.pi, 0.0)])
def test_a_source_is_column_factor_and_offset(text, column, factor, offset):
    found = parse_source(text, COLUMNS)
    assert found.column == column
    assert (found.factor, found.offset) == pytest.approx((factor, offset))


@pytest.mark.parametrize(('text', 'reported'), [
    ('q', 'begins with no column of the file; these are t, x'),
    ('x*furlong', 'furlong is no unit'),
    ('x*(2)', r"'\*\(2\)' is no factor"), ('x*0', 'finite number, not 0'), ('x*1e999', 'finite'),
    ('x**2', 'is no factor'), ('x*2*3', 'is no factor'), ('__import__("os")', 'begins with no'),
    ('x+1e999', 'the offset must be a finite number')])
def test_what_is_no_source_is_named_and_nothing_is_evaluated(text, reported):
    with pytest.raises(ConfigurationError, match=reported) as caught:
        parse_source(text, COLUMNS)
    assert '\n' not in str(caught.value)


def test_a_map_names_each_signal_once():
    assert split_map('stamp=t, x0="a,b"*2,v=v') == {'stamp': 't', 'x0': '"a,b"*2', 'v': 'v'}
    for text, reported in (('x0', 'SIGNAL=COLUMN'), ('x0=a,x0=b', 'a second time'),
                           ('', 'must be')):
        with pytest.raises(ConfigurationError, match=reported):
            split_map(text)
    with pytest.raises(ConfigurationError, match='is no signal of a run of order 2'):
        check_signals(['x7'], 2)


@pytest.mark.parametrize(('text', 'values'), [
    ('t,x\n0,1\n1,2\n', [1, 2]), ('t;x\r\n0;1,\r\n', None),
    ('# t\tx\n0\t1\n\n#no\n1\tnan\n', [1, np.nan]),
    ('\ufefft, x\n0, \n1,NULL\n', [np.nan, np.nan]),
    ('t;x\n0,005;1,5\n0,01;-,25e1\n', [1.5, -2.5]), ('t,x\ns,m\n0,1\n', [1]),
    ('t,x\ns,-\n0,1\n', [1]), ('t;x\n;mm\n0;1\n', [1])])
def test_tables_are_read_whatever_separates_their_cells(tmp_path, text, values):
    path = tmp_path / 'a.csv'
    path.write_text(text, encoding='utf-8')
    assert table_names(path) == ('t', 'x')
    if values is None:
        with pytest.raises(RecordingError, match="line 2: x is '1,', not a number"):
            read_table(path, ['x'])
        return
    assert read_table(path, ['x']).chosen['x'].values == pytest.approx(values, nan_ok=True)


def test_times_may_be_dates(tmp_path):
    path = tmp_path / 'a.csv'
    path.write_text('t,x\n2024-05-01T12:00:00.005Z,1\n2024-05-01 14:00:00.010+02:00,2\n'
                    '2024-05-01T12:00:00.015,3\n', encoding='utf-8')
    times = read_table(path, ['t']).chosen['t'].values
    assert times - 1714564800.0 == pytest.approx([0.005, 0.010, 0.015], abs=1e-6)


@pytest.mark.parametrize(('text', 'reported'), [
    ('t,x\ns,m\nms,mm\n0,1\n', "line 3: x is 'mm', not a number"),
    ('t,x\n0,1_000\n', "x is '1_000', not a number"),
    ('t,x\n0,1\ns,m\n', "line 3: x is 'm', not a number"),
    ('t,x\n0,2024-13-01T12:00:00\n', "x is '2024-13-01T12:00:00', not a number"),
    ('t;x\n0;1,234,567\n', "x is '1,234,567', not a number"),
    ('', 'is empty'), ('0,1\n1,2\n', 'must name the columns'),
    ('t,x\n0\n', 'line 2 has 1 cells'),
    ('t,x\n0,' + '1' * 200000, 'field larger than field limit'),
    ('t,x\n0,' + '1' * 2000000, 'a line is longer than'), ('#', 'must name the columns'),
    ('t,x\n\n0,"1\n2"\n', "line 4: x is '1.n2', not a number"),
    ('x' * 200000, 'field larger than field limit'),
    ('x,x\n', 'two columns'), ('t,x\n0,abc\n', "x is 'abc', not a number")])
def test_what_is_no_table_is_named(tmp_path, text, reported):
    path = tmp_path / 'a.csv'
    path.write_text(text, encoding='utf-8')
    with pytest.raises(RecordingError, match=reported):
        read_table(path, list(table_names(path))[-1:])


def table(t, **columns):
    return ({name: Column(np.asarray(values, dtype=float))
             for name, values in {'t': t, **columns}.items()},
            {'stamp': parse_source('t', ['t']),
             **{name: parse_source(name, [name]) for name in columns}})


def motion(count=400):
    t = np.arange(count) * PERIOD
    return t, np.sin(3.0 * t), 2.0 * np.cos(t)


def test_a_run_holds_what_the_columns_report_and_names_the_rest():
    t, x, v = motion()
    columns, sources = table(t + 7.0, x0=x, xd0=x, v=v)
    done = import_run(columns, sources, axis(), False, 10 ** 18)
    state, command = done.run.channels['state'], done.run.channels['command']
    assert state.labels == State.labels(2)
    assert state['stamp'] == pytest.approx(t, abs=1e-9)
    assert state['seq'].tolist() == list(range(len(t)))
    assert np.array_equal(state['x0'], x)
    assert np.array_equal(command['v'], v)
    # The velocity is observed, and reported to be.
    assert state['x1'][100:] == pytest.approx(3.0 * np.cos(3.0 * t[100:]), abs=0.02)
    assert done.run.info['observed'] == 'x1'
    reference = done.run.channels['reference']
    inner = slice(10, -10)
    assert reference['xd1'][inner] == pytest.approx(3 * np.cos(3 * t)[inner], abs=1e-4)
    assert reference['xd2'][inner] == pytest.approx(-9 * np.sin(3 * t)[inner], abs=1e-2)
    reported = '; '.join(done.notes)
    assert 'xd1, xd2 missing' in reported
    assert 'x1 is missing: observed from x0' in reported
    assert "missing: the law's terms, truth, round trips" in reported
    assert 'terms' not in done.run.channels
    trajectory = Configuration.from_flat(done.run.configuration).trajectory
    there = [0.0] * 3
    trajectory.evaluate(1.0, trajectory.constants, there)
    assert there == pytest.approx([np.sin(3.0), 3 * np.cos(3.0), -9 * np.sin(3.0)], rel=1e-2)


def test_gaps_stay_gaps_and_rows_out_of_order_are_left_out():
    t, x, v = motion()
    keep = np.r_[0:100, 130:400]
    order = np.r_[0:50, 40, 50:len(keep)]
    t, x, v = (item[keep][order] for item in (t, x, v))
    for resample in (False, True):
        done = import_run(*table(t, x0=x, v=v), axis(), resample, 0)
        seq = done.run.channels['state']['seq']
        assert 30 - 1 <= int(seq[-1]) + 1 - len(seq) <= 30
        reported = '; '.join(done.notes)
        assert 'are gaps and stay gaps' in reported
        assert '1 rows of x0 do not come after the row before: left out' in reported
        assert 'missing: reference' in reported


def irregular():
    """Return name → times of rows, and the number of the sample that each is."""
    random, number = np.random.default_rng(3), np.arange(6000)
    regular = PERIOD * number
    some = np.sort(random.choice(6000, 4500, replace=False))
    some[0] = 0
    # Every half second a stall of nine rows, which then come at once.
    stalled = regular.copy()
    for first in range(50, 5900, 100):
        stalled[first:first + 9] = stalled[first + 9] - 1e-4 * np.arange(9, 0, -1)
    kept = np.r_[0:2000, 2300:6000]
    return {
        'rate 0.1 % lower': (regular * 1.001, number),
        'rate 1 % lower': (regular * 1.01, number),
        'rate 1 % higher': (regular * 0.99, number),
        'jitter': (regular * 1.001 + random.normal(0.0, 0.4e-3, 6000), number),
        'much jitter': (regular + random.uniform(-2e-3, 2e-3, 6000), number),
        'one in four is missing': (regular[some] + random.normal(0.0, 0.2e-3, 4500), some),
        'stalls': (stalled, number),
        'a long gap': (regular[kept] + random.normal(0.0, 0.2e-3, len(kept)), kept),
        'rows twice': (np.sort(np.r_[regular, regular[::50] + 1e-4]), number)}


@pytest.mark.parametrize('name', irregular())
def test_only_rows_that_are_missing_are_gaps(name):
    """A log at another rate than loop.rate by a little slips by a sample again and again."""
    t, number = irregular()[name]
    done = import_run(*table(t, x0=np.sin(t), v=np.cos(t)), axis(), False, 0)
    seq = done.run.channels['state']['seq']
    assert len(seq) == len(number)
    # How many are missing in a long gap follows from the rate, as well as jitter lets it be known.
    assert seq == pytest.approx(number - number[0], abs=1.0 if name == 'a long gap' else 0.0)
    assert any('gaps' in note for note in done.notes) == (number[-1] + 1 > len(number))
    assert any('share a sample' in note for note in done.notes) == (name == 'rows twice')


@pytest.mark.parametrize('share', [0.0, 0.001, 0.018, -0.018])
def test_the_run_has_the_rate_of_its_rows(share):
    t = np.arange(1000) * PERIOD * (1.0 + share)
    done = import_run(*table(t, x0=np.sin(t), v=np.cos(t)), axis(), False, 0)
    assert done.run.configuration['loop.rate'] == pytest.approx(1.0 / t[1], rel=1e-5)
    assert any('is that of the rows' in note for note in done.notes) == (share != 0.0)


@pytest.mark.parametrize('rows', [6, 20, 100, 1000])
@pytest.mark.parametrize('jumps', [(), (2.0,), (0.1, 0.1), (2.0, 2.0), (0.05, 0.05, 0.05)])
def test_jitter_and_a_clock_that_is_set_are_no_other_rate(rows, jumps):
    for seed in range(5):
        t = PERIOD * (np.arange(rows) + np.random.default_rng(seed).uniform(-0.1, 0.1, rows))
        for place, jump in enumerate(jumps, 1):
            t[place * rows // (len(jumps) + 1):] += jump
        assert own_period(np.arange(float(rows)), t, PERIOD) == PERIOD


@pytest.mark.parametrize('factor', [1e-3, 1e3])
def test_resampling_refuses_times_of_another_unit(factor):
    t, x, v = motion()
    with pytest.raises(RecordingError, match='is the unit of the time another'):
        import_run(*table(t * factor, x0=x, v=v), axis(), True, 0)


def test_resampling_has_the_last_row():
    t = np.arange(2501) * 0.01
    done = import_run(*table(t + 0.1, x0=np.sin(t), v=np.cos(t)), axis(), True, 0)
    state = done.run.channels['state']
    assert len(state['seq']) == 5001
    assert np.isfinite(state['x0']).all()
    assert state['x0'][-1] == pytest.approx(np.sin(t[-1]))
    assert not any('no number' in note for note in done.notes)


def test_resampling_interpolates_states_and_holds_commands():
    t = np.arange(200) * 0.01 + np.random.default_rng(0).uniform(-1e-3, 1e-3, 200)
    x, v = 2.0 * t, np.round(5.0 * t)
    with pytest.raises(ConfigurationError, match=r'rows are .* ms apart: give --resample, or'):
        import_run(*table(t, x0=x, v=v), axis(), False, 0)
    done = import_run(*table(t, x0=x, v=v), axis(), True, 0)
    state = done.run.channels['state']
    assert np.diff(state['stamp']) == pytest.approx(PERIOD)
    assert state['x0'] == pytest.approx(2.0 * (state['stamp'] + t[0]), abs=1e-9)
    assert set(done.run.channels['command']['v'].tolist()) <= set(v.tolist())


@pytest.mark.parametrize('resample', [False, True])
@pytest.mark.parametrize(('first', 'last'), [(0.0, 1e12), (0.0, 5e9), (0.0, 1e308),
                                             (-1e308, 1e308)])
def test_times_of_no_run_are_refused_before_anything_is_made_of_them(resample, first, last):
    t, x, v = motion()
    columns, sources = table(np.r_[first, t[1:], last], x0=np.r_[x, 0.0], v=np.r_[v, 0.0])
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(RecordingError, match='the rows last'):
            import_run(columns, sources, axis(), resample, 0)


def test_resampling_does_not_fill_a_day_of_silence():
    t, x, v = motion()
    columns, sources = table(np.r_[t, 1e5], x0=np.r_[x, 0.0], v=np.r_[v, 0.0])
    with pytest.raises(RecordingError, match=r'less than 8\.389e\+04 s at 200 Hz, resampled'):
        import_run(columns, sources, axis(), True, 0)
    done = import_run(columns, sources, axis(), False, 0)
    assert 'are gaps and stay gaps' in '; '.join(done.notes)


@pytest.mark.parametrize('start', [-10 ** 17, 2 ** 63 - 1])
def test_a_file_of_any_date_gives_times_of_a_recording(start):
    t, x, v = motion()
    done = import_run(*table(t, x0=x, v=v), axis(), False, start)
    times = done.run.channels['state'].log_time
    assert times.min() >= 0
    assert np.all(np.diff(times) > 0)


def test_numbers_beyond_the_largest_are_no_numbers():
    t, x, v = motion()
    columns, _ = table(t, x0=x, v=v)
    sources = {'stamp': parse_source('t', ['t']), 'x0': parse_source('x0', ['x0']),
               'v': parse_source('v*1e308', ['v'])}
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        done = import_run(columns, sources, axis(), False, 0)
    assert any(note.startswith('v is no number in') for note in done.notes)


def test_columns_of_another_time_are_named():
    t = np.arange(50) * PERIOD
    columns = {'x': Column(np.sin(t), t), 'v': Column(t, t + 1e9)}
    with pytest.raises(RecordingError, match=r'v has no number at the times of x0: .* 1000000000'):
        import_run(columns, {'x0': parse_source('x', None), 'v': parse_source('v', None)}, axis(),
                   False, 0)


def test_a_column_without_numbers_is_named_and_one_with_some_is_kept():
    t, x, v = motion()
    with pytest.raises(RecordingError, match='x1 is no number in any row: leave it out of --map'):
        import_run(*table(t, x0=x, x1=np.full(len(t), np.nan), v=v), axis(), False, 0)
    done = import_run(*table(t, x0=np.where(np.arange(len(t)) % 10, x, np.nan), v=v), axis(),
                      False, 0)
    assert 'x0 is no number in 40 of 400 samples' in done.notes
    with pytest.raises(ConfigurationError, match='of a plant of order 3 only x2 can be observed'):
        import_run(*table(t, x0=x, v=v), axis(**{'plant.model': 'valve_actuator'}), False, 0)


def test_a_table_with_very_many_columns_is_read_as_fast_as_its_text(tmp_path):
    path, begin = tmp_path / 'a.csv', time.process_time()
    path.write_text(','.join(f'c{i}' for i in range(140_000)) + '\n')
    assert len(table_names(path)) == 140_000
    assert time.process_time() - begin < 5.0


@pytest.mark.slow
def test_a_long_table_is_not_held_as_text(tmp_path, monkeypatch):
    path = tmp_path / 'a.csv'
    path.write_text('t,x\n' + '1,1\n' * 100_000)
    tracemalloc.start()
    try:
        found = read_table(path, ['t', 'x'])
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(found.chosen['x'].values) == 100_000
    assert most < 6 * 2 * 8 * 100_000
    monkeypatch.setattr(import_csv, 'MOST_ROWS', 1000)
    with pytest.raises(RecordingError, match='more than 1000 rows'):
        read_table(path, ['t', 'x'])


# Bags.

def joint_bag(path, storage, count=50):
    """Write joint states by rosbags, as a bag of another tool; return position and effort."""
    rosbags = pytest.importorskip('rosbags.rosbag2', reason='rosbags is not installed')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kinds = store.types
    position = np.sin(np.arange(count) * PERIOD)
    with rosbags.Writer(path, version=9, storage_plugin=getattr(rosbags.StoragePlugin,
                                                                storage)) as writer:
        topic = writer.add_connection('/arm/joints', 'sensor_msgs/msg/JointState',
                                      typestore=store)
        for k in range(count):
            stamp = kinds['builtin_interfaces/msg/Time'](
                sec=100, nanosec=int(k * PERIOD * 1e9))
            header = kinds['std_msgs/msg/Header'](stamp=stamp, frame_id='odd')
            message = kinds['sensor_msgs/msg/JointState'](
                header=header, name=['a', 'elbow'], position=np.array([0.0, position[k]]),
                velocity=np.array([]), effort=np.array([0.0, 2.0 * k]))
            writer.write(topic, 10 ** 18 + k * 5_100_000,
                         store.serialize_cdr(message, message.__msgtype__))
    return position


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
def test_joint_states_of_a_bag(tmp_path, storage):
    position = joint_bag(tmp_path / 'bag', storage)
    wanted = ['/arm/joints/position[elbow]', '/arm/joints/effort[1]']
    found = read_bag(open_source(tmp_path / 'bag'), wanted)
    assert found.chosen[wanted[0]].values == pytest.approx(position)
    assert found.chosen[wanted[0]].times == pytest.approx(100 + np.arange(50) * PERIOD)
    sources = {'x0': parse_source(wanted[0], None), 'v': parse_source(f'{wanted[1]}/2', None)}
    done = import_run(found.chosen, sources, axis(), False, 0)
    assert done.run.channels['command']['v'] == pytest.approx(np.arange(50))
    for column, reported in (('/leg/position[0]', 'no topic of /leg.*there are /arm/joints'),
                             ('/arm/joints/position[7]', 'no field .*position'),
                             ('/arm/joints/torque', 'no field')):
        with pytest.raises(RecordingError, match=reported):
            read_bag(open_source(tmp_path / 'bag'), [column])


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
def test_topics_without_a_header_have_the_times_of_the_log(tmp_path, storage):
    rosbags = pytest.importorskip('rosbags.rosbag2', reason='rosbags is not installed')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kinds = store.types
    layout = kinds['std_msgs/msg/MultiArrayLayout'](dim=[], data_offset=0)
    made = {'/state': lambda k: kinds['std_msgs/msg/Float64MultiArray'](
                layout=layout, data=np.array([0.5 * k, 7.0])),
            '/u': lambda k: kinds['std_msgs/msg/Int16'](data=-k),
            '/note': lambda k: kinds['std_msgs/msg/String'](data='text')}
    with rosbags.Writer(tmp_path / 'bag', version=9, storage_plugin=getattr(
            rosbags.StoragePlugin, storage)) as writer:
        topics = {name: writer.add_connection(name, make(0).__msgtype__, typestore=store)
                  for name, make in made.items()}
        for k in range(40):
            for name, make in made.items():
                message = make(k)
                writer.write(topics[name], 10 ** 18 + k * 5_000_000,
                             store.serialize_cdr(message, message.__msgtype__))
    found = read_bag(open_source(tmp_path / 'bag'), ['/state/data[0]', '/u/data'])
    assert found.chosen['/u/data'].times == pytest.approx(1e9 + np.arange(40) * PERIOD)
    sources = {'x0': parse_source('/state/data[0]*mm', None),
               'v': parse_source('/u/data*0.1', None)}
    run = import_run(found.chosen, sources, axis(), False, 0).run
    assert run.channels['state']['x0'] == pytest.approx(5e-4 * np.arange(40))
    assert run.channels['command']['v'] == pytest.approx(-0.1 * np.arange(40))
    with pytest.raises(RecordingError, match='no field /note/data'):
        read_bag(open_source(tmp_path / 'bag'), ['/note/data'])


def test_messages_that_are_not_what_their_definition_reports():
    kind = MessageType('a/msg/B', 'float64[<=3] x\nuint8 CONSTANT=3\na/C c # of it\n===\n'
                       'MSG: a/C\nint32[2] y\nbool z')
    body = bytes.fromhex('01000000 00000000') + np.array([1.5]).tobytes() + np.array(
        [-2, 7], dtype='<i4').tobytes() + b'\x01'
    whole = b'\x00\x01\x00\x00' + body
    assert kind.decode(whole) == {'x[0]': 1.5, 'c.y[0]': -2.0, 'c.y[1]': 7.0, 'c.z': 1.0}
    for payload, reported in ((whole[:-3], 'ends before its last field'),
                              (b'\x00\x07', 'plain CDR'),
                              (b'\x00\x01\x00\x00' + b'\xff' * 8, 'elements')):
        with pytest.raises(MessageError, match=reported):
            kind.decode(payload)
    with pytest.raises(MessageError, match='does not define how'):
        MessageType('a/msg/Unknown', '')


def test_a_definition_cannot_claim_more_than_the_payload_holds():
    begin = time.process_time()
    nothing = '===\nMSG: a/Empty\nuint8 NONE=0'
    chain = '\n'.join(f'===\nMSG: a/T{i}\n' + '\n'.join(
        f'a/T{i + 1} {name}' for name in 'abcdefgh') for i in range(15)
        ) + '\n===\nMSG: a/T15\nuint8 NONE=0'
    for text in (f'a/Empty[16777216] x\n{nothing}', f'a/T0 t\n{chain}', 'string[16777216] x',
                 f'a/Many[16777216] x\n===\nMSG: a/Many\na/Empty[16777216] y\n{nothing}'):
        with pytest.raises(MessageError, match='ends before its last field'):
            MessageType('a/msg/B', text).decode(b'\x00\x01\x00\x00' + bytes(4096))
    with pytest.raises(MessageError, match='no elements'):
        MessageType('a/msg/B', 'uint8[0] x')
    with pytest.raises(MessageError, match='elements'):
        MessageType('a/msg/B', f'uint8[{"9" * 9999}] x').decode(b'\x00\x01\x00\x00')
    assert time.process_time() - begin < 2.0


def test_of_a_large_message_the_first_numbers_are_kept():
    count = MOST_NUMBERS + 5
    kind = MessageType('a/msg/Image', 'uint8 kind\nuint8[] data\nuint8 last')
    found = kind.decode(b'\x00\x01\x00\x00\x07\0\0\0' + np.uint32(count).tobytes()
                        + bytes([1]) * count + b'\x02')
    assert (len(found), found['kind'], found['data[0]']) == (MOST_NUMBERS, 7.0, 1.0)


def test_a_type_without_fields_takes_a_byte_as_in_idl():
    kind = MessageType('a/msg/B', 'a/Empty x\nuint8 y\n===\nMSG: a/Empty\n')
    assert kind.decode(b'\x00\x01\x00\x00\x00\x09') == {'y': 9.0}
