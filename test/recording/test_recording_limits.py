# SPDX-License-Identifier: Apache-2.0
"""Files made to break their reader: a line and exit code 2, or read with a note, within 1 GB.

Every verb reads every file; a process for each kind of file prints its largest memory.

Over 300 lines: each kind of file is made here, and all are read by the same process.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
import importlib.util
import json
from pathlib import Path
import re
import resource
import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest
import zstandard

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.recording.run_description import sealed
from dz_ros.recording.run_source import open_source
from dz_ros.recording.save import save_run

pytestmark = pytest.mark.slow

MEMORY = 1024
"""MiB."""
LATER = 1_700_000_001_000_000_000
CPU = 600
"""A verb that takes more processor time does not end [s]."""
SCRIPT = """
import contextlib, io, json, resource, sys, traceback
resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[1]), int(sys.argv[1])))
from pathlib import Path
from dz_ros.cli.main import main
from dz_ros.errors import DzRosError

def page(run):
    from dz_ros.live.recorded_source import Recorded
    from dz_ros.recording.reader import read_run
    Recorded({'a': read_run(Path(run))}).hello()

def replay(run):
    from dz_ros.recording.bag_metadata import read_qos
    from dz_ros.recording.exchanges import Exchanges
    from dz_ros.recording.player import Player
    from dz_ros.recording.run_source import open_source
    for topic in open_source(Path(run)).recorded_topics().values():
        read_qos(topic.qos)
    player = Player(lambda since: open_source(Path(run)).batches(since), paused=True)
    while player.step() is not None:
        pass
    for _ in Exchanges(open_source(Path(run))):
        pass

found = []
for words in json.loads(sys.argv[2]):
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            if words[0] in ('page', 'replay'):
                code = globals()[words[0]](words[1]) or 0
            else:
                code = main(words)
    except DzRosError as error:
        code, err = 2, io.StringIO(str(error))
    except BaseException:
        code, err = 'traceback', io.StringIO(traceback.format_exc())
    found.append((code, err.getvalue().strip(), out.getvalue()))
# VmHWM, not ru_maxrss: that one begins at the peak of the process that started this one
peak = Path('/proc/self/status').read_text().partition('VmHWM:')[2].split()[0]
print(json.dumps([found, int(peak) // 1024]))
"""


def parts_module():
    spec = importlib.util.spec_from_file_location(
        'mcap_parts', Path(__file__).with_name('mcap_parts.py'))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


parts = parts_module()


def run(*commands):
    """Return (exit code, errors, output) of each; memory must have been enough."""
    done = subprocess.run([sys.executable, '-c', SCRIPT, str(CPU), json.dumps(commands)],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found, memory = json.loads(done.stdout.splitlines()[-1])
    for words, (code, errors, _) in zip(commands, found, strict=True):
        assert code in (0, 1, 2), f'{words}: {errors}'
        if code == 2:       # what takes longer than 3 s shows its progress besides
            own = [line for line in errors.splitlines() if not re.search(r': \d+ s$', line)]
            assert len(own) == 1, words
            assert len(errors) < 2000
            assert 'report issue' not in errors
    assert memory < MEMORY
    return found


def each(paths, tmp_path):
    """Return what every verb reports of each recording: verb → (code, errors, output).

    What-if, which draws for seconds what it can read, is asked of the first one alone.
    """
    asked, commands = [], []
    for place, path in enumerate(map(str, paths)):
        words = {'info': ['bag', 'info', path],
                 'recover': ['bag', 'recover', path, str(tmp_path / f'recovered{place}')],
                 'audit': ['bag', 'audit', path], 'report': ['report', path, '--json'],
                 'compare': ['bag', 'compare', path, path, '--json'],
                 'page': ['page', path], 'replay': ['replay', path]}
        if not place:
            words['whatif'] = ['bag', 'whatif', path, '--set', 'controller.epsilon=0.1', '--out',
                               str(tmp_path / 'whatif')]
        asked.append(words)
        commands += words.values()
    answers = iter(run(*commands))
    return [{verb: next(answers) for verb in words} for words in asked]


READERS = ('audit', 'report', 'compare', 'page')
NOTING = ('audit', 'report', 'compare')
"""Verbs that note what was left out."""


def noted(answer):
    """Return what a verb printed, errors and output."""
    return answer[1] + answer[2]


@pytest.fixture(scope='module')
def data():
    run = from_run(simulate(Configuration.from_flat({'loop.duration': 0.5})),
                   1_700_000_000_000_000_000)
    return replace(run, configuration={**run.configuration, 'loop.duration': 0.5})


BOMB = 'a: &a [x, x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{new}: &{new} [{", ".join([f"*{old}"] * 10)}]\n'
    for old, new in zip('abcdefghi', 'bcdefghij', strict=True))
MERGES = 'a: &a {k: 1}\n' + ''.join(f'{new}: &{new}\n  <<: [{", ".join([f"*{old}"] * 9)}]\n'
                                    for old, new in zip('abcdefghi', 'bcdefghij', strict=True))


def indented(text):
    return ''.join(f'    {line}\n' for line in text.splitlines())


DEEP = '[' * 5000


def saved(data, folder, count):
    """Return this number of runs."""
    first = save_run(data, folder / 'run0').directory
    return [first, *(shutil.copytree(first, folder / f'run{k}') for k in range(1, count))]


def test_metadata_yaml(data, tmp_path):
    texts = (BOMB, MERGES, 'rosbag2_bagfile_information:\n  version: 9\n  custom_data:\n'
             + indented(BOMB), 'a: &a [*a]\n', DEEP, '{a: ' * 5000, 'x' * 20_000_000,
             'rosbag2_bagfile_information: {version: ' + '9' * 5000 + '}')
    paths = saved(data, tmp_path, len(texts))
    for path, text in zip(paths, texts, strict=True):
        (path / 'metadata.yaml').write_text(text)
    for found in each(paths, tmp_path):
        assert all(item[0] == 0 for item in found.values())
        assert 'metadata.yaml: it cannot be read' in found['info'][2]


class Records:
    """The run as records, among which others are put."""

    def __init__(self, data, folder):
        source = open_source(save_run(data, folder / 'source').directory)
        found = [item for batch in source.batches() for item in batch]
        numbers = {key: place + 1 for place, key in enumerate(source.topics)}
        self.folder = folder
        self.count = 0
        self.plain = b''.join(
            parts.schema(numbers[key], topic.type_name, topic.definition.encode())
            + parts.channel(numbers[key], numbers[key], topic.name)
            for key, topic in source.topics.items()) + b''.join(
            parts.message(numbers[item.topic], item.log_time, item.payload) for item in found)

    def file(self, extra, outside=b''):
        """Return a file with other records at its end, or before it."""
        self.count += 1
        path = self.folder / f'records{self.count}.mcap'
        path.write_bytes(parts.HEAD + outside + parts.chunk(self.plain + extra) + parts.TAIL)
        return path


def test_odd_qos_texts(data, tmp_path):
    records = Records(data, tmp_path)
    texts = (BOMB, MERGES, DEEP, '- history: 99\n  depth: 1e308\n', '- 3', '&',
             '- {history: [1], depth: {a: b}, reliability: 1.5}')
    paths = [records.file(parts.schema(90, 'std_msgs/msg/String', b'string data\n')
                          + parts.channel(90, 90, '/odd', qos=text)
                          + parts.message(90, 1, b'\0\1\0\0\1\0\0\0\0')) for text in texts]
    for found in each(paths, tmp_path):
        assert found['info'][0] == found['recover'][0] == found['report'][0] == 0


def claiming(size):
    """Return a zstd frame that claims a size."""
    return b'\x28\xb5\x2f\xfd\xe0' + struct.pack('<Q', size) + b'\x01\x00\x00'


@cache
def zeros():
    """Return a zstd frame that becomes 2 GiB and does not report it."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    piece = bytes(2**20)
    return b''.join(packer.compress(piece) for _ in range(2048)) + packer.flush()


def lengths():
    """Yield name and records that claim what they are not."""
    for size in (2**31, 2**50, 2**63, 2**64 - 1):
        yield f'record-{size}', parts.record(3, b'abc', size)
        yield f'private-{size}', parts.record(0x90, b'abc', size)
        yield f'zstd-{size}', parts.chunk(b'', claiming(size), 'zstd', size)
        yield f'zstd-other-{size}', parts.chunk(b'', claiming(size), 'zstd', 100)
        yield f'lz4-{size}', parts.chunk(b'', b'\x04\x22\x4d\x18' + bytes(20), 'lz4', size)
        yield f'plain-{size}', parts.chunk(b'', b'abc', '', size)
        yield f'stored-{size}', parts.chunk(b'', b'abc', '', 3, size)
        yield f'inner-{size}', parts.chunk(parts.record(5, b'abc', size))
    long = struct.pack('<I', 2**32 - 1)
    yield 'schema-name', parts.record(3, b'\1\0' + long + b'abc')
    yield 'schema-data', parts.record(3, b'\1\0' + parts.text('a') * 2 + long)
    yield 'channel-map', parts.record(4, bytes(4) + parts.text('/a') + parts.text('cdr') + long)
    yield 'metadata-map', parts.record(12, parts.text('a') + long)
    yield 'attachment', parts.record(9, bytes(16) + long)
    yield 'compression', parts.record(6, bytes(28) + long)
    yield 'bomb', parts.chunk(b'', zeros(), 'zstd', 2**28 - 1)
    yield 'bomb-reported', parts.chunk(b'', zeros(), 'zstd', 2**31)
    small = parts.message(1, 5, b'\0\1\0\0')
    yield 'messages', parts.chunk(parts.schema(1, 'a/msg/B', b'') + parts.channel(1, 1, '/a')
                                  + small * 1_100_000)


def test_absurd_lengths(tmp_path):
    paths = []
    for name, records in lengths():
        paths.append(tmp_path / f'{name}.mcap')
        paths[-1].write_bytes(parts.HEAD + records + parts.TAIL)
    for path, found in zip(paths, each(paths, tmp_path), strict=True):
        assert all(found[verb][0] == 2 for verb in (*READERS, 'recover')), path


def test_files_that_become_gigabytes(tmp_path):
    paths = [tmp_path / 'x.mcap.zstd', tmp_path / 'x.db3.zstd']
    for path in paths:
        path.write_bytes(zeros())
    for found in each(paths, tmp_path):
        assert all('expands to more than' in found[verb][1] for verb in READERS)


def test_absurd_messages(data, tmp_path):
    records = Records(data, tmp_path)
    start = b'\0\1\0\0'
    compressed = (claiming(2**50), zeros())
    payloads = (*compressed, start + b'\xff' * 4, start + b'\xff' * 64,
                start + bytes(8) + b'\xff' * 4, start + struct.pack('<I', 1) + b'\xff' * 4,
                b'', b'\0\1', start + bytes(2**21))
    paths = [records.file(parts.message(1, LATER, payload)) for payload in payloads]
    for payload, found in zip(payloads, each(paths, tmp_path), strict=True):
        if payload in compressed:
            assert all(found[verb][0] == 2 for verb in READERS), payload[:20]
        else:
            assert all('1 message left out: ' in noted(found[verb]) for verb in NOTING), (
                payload[:20])


def test_times_that_are_none(data, tmp_path):
    records = Records(data, tmp_path)
    paths = [records.file(parts.message(1, time, b'\0\1\0\0'))
             for time in (2**63, 2**64 - 1, 2**63 + 2**53)]
    for found in each(paths, tmp_path):
        assert all('no times' in found[verb][1] for verb in (*READERS, 'info'))
        assert 'no times' in found['recover'][2]


def test_numbers_that_count_nothing(data, tmp_path):
    cases = [(topic, label, value) for topic in ('state', 'terms') for label, values in (
        ('seq', (np.nan, np.inf, 1e308, 2.0**53, -1.0, 0.5)),
        ('stamp', (np.nan, -np.inf, 1e308, 2.0**53))) for value in values]
    paths = []
    for topic, label, value in cases:
        channel = data.channels[topic]
        values = channel.values.copy()
        values[50, channel.labels.index(label)] = value
        paths.append(save_run(replace(data, channels={
            **data.channels, topic: replace(channel, values=values)}),
            tmp_path / f'run{len(paths)}').directory)
    for (topic, label, _), found in zip(cases, each(paths, tmp_path), strict=True):
        assert all(f'1 message left out: topic /{topic}: message 50: {label} is '
                   in noted(found[verb]) for verb in NOTING)
        assert found['page'][0] == 0
        assert found['recover'][0] == 0


def test_labels_renamed(data, tmp_path):
    paths = []
    for topic, channel in data.channels.items():
        names = tuple(name if name in ('seq', 'stamp') else f'other_{name}'
                      for name in channel.labels)
        paths.append(save_run(replace(data, channels={**data.channels, topic: replace(
            channel, labels=names)}), tmp_path / topic).directory)
    each(paths, tmp_path)


@pytest.mark.parametrize(('topic', 'columns', 'value'), [
    ('state', slice(2, None), 1e308), ('state', slice(2, None), np.nan), ('state', 0, 2.0**52),
    ('command', slice(3, None), np.nan), ('command', slice(3, None), 1e300)])
def test_numbers_that_nothing_can_be_computed_from(data, tmp_path, topic, columns, value):
    values = data.channels[topic].values.copy()
    values[:, columns] = value if columns != 0 else value + values[:, 0]
    path = str(save_run(replace(data, channels={**data.channels, topic: replace(
        data.channels[topic], values=values)}), tmp_path / 'run').directory)
    out = str(tmp_path / 'out')
    run(['bag', 'audit', path], ['report', path, '--json'], ['report', path, '--out', out],
        ['bag', 'whatif', path, '--fit', '--out', f'{out}-fit'], ['page', path],
        ['driver', 'identify', '--from', path, '--out', f'{out}-identified'])


def test_single_numbers_too_large_for_any_axis(data, tmp_path):
    paths = []
    for topic in ('state', 'terms'):
        values = data.channels[topic].values.copy()
        values[3::17, 2:], values[9::17, 2:] = 1e308, -1e308
        paths.append(str(save_run(replace(data, channels={**data.channels, topic: replace(
            data.channels[topic], values=values)}), tmp_path / topic).directory))
    found = run(*(['report', path, '--out', f'{path}-out'] for path in paths))
    assert [code for code, *_ in found] == [0] * len(paths), found


def test_long_lists_of_a_configuration(data, tmp_path):
    points = [float(k) for k in range(500_000)]
    flat = {**data.configuration, 'trajectory.kind': 'waypoints', 'trajectory.times': points,
            'trajectory.positions': points}
    path = str(save_run(replace(data, configuration=flat), tmp_path / 'run').directory)
    begin = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    found = run(['bag', 'audit', path], ['report', path, '--json'], ['page', path])
    assert 'at most 50000 are taken' in found[1][1]
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begin < 60.0


def test_configurations(data, tmp_path):
    paths = [save_run(replace(data, configuration={**data.configuration, **change}),
                      tmp_path / f'run{place}').directory for place, change in enumerate((
                          {'loop.duration': 1e308}, {'loop.rate': 1e308}, {'loop.duration': 1e9},
                          {'plant.x0': ['a']}, {'foo': 1}, {'controller.law': 'x' * 500},
                          {'plant.substeps': 10**400}))]
    each(paths, tmp_path)


def test_deep_json(data, tmp_path):
    records = Records(data, tmp_path)
    deep = '[' * 100_000
    paths = [records.file(b'', parts.metadata(name, sealed(
        {'flat': deep, 'serialized_metadata': deep})))
        for name in ('dz_ros.configuration', 'dz_ros.info', 'rosbag2')]
    start = int(data.channels['state'].log_time[0])
    paths += [save_run(replace(data, events=((start, '/controller_node', text),)),
                       tmp_path / f'run{place}').directory for place, text in enumerate((
                           deep, '{"event": "configuration", "configuration": {"a": ' + deep,
                           '[1]', 'null', '{"event": {}, "node": []}'))]
    found = each(paths, tmp_path)
    assert all('nested too deeply' in found[0][verb][1] for verb in READERS)


def test_parameter_files(tmp_path):
    commands = []
    for place, text in enumerate((
            BOMB, DEEP, 'a: ' + '9' * 5000, 'x' * 20_000_000,
            '/**:\n  ros__parameters:\n' + indented(BOMB), 'loop: {duration: 1e308}',
            'loop: {rate: .nan}')):
        path = tmp_path / f'evil{place}.yaml'
        path.write_text(text)
        commands += [['check', str(path)], ['simulate', str(path)]]
    assert [item[0] for item in run(*commands)] == [2] * len(commands)
