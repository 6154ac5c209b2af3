# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import Channel, from_run, RunData
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import RecordingError, RunExistsError
from dz_ros.recording.mcap_file import McapFile
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run

SLOW = settings(suppress_health_check=[HealthCheck.function_scoped_fixture],
                max_examples=settings.default.max_examples // 4)
TIMES = st.integers(0, 2**62)


def test_a_simulated_run_comes_back_bit_for_bit(tmp_path):
    run = simulate(Configuration.from_flat({'loop.duration': 2.0, 'plant.noise': [1e-3, 1e-2]}))
    data = from_run(run, 1_700_000_000_000_000_000)
    save_run(data, tmp_path / 'run')
    found = read_run(tmp_path / 'run')
    assert found.channels['state'].values[:, 2:4].tobytes() == run.x_measured.tobytes()
    assert found.channels['command']['v'].tobytes() == run.v.tobytes()
    assert found.channels['truth'].values[:, 2:].tobytes() == run.truth.tobytes()
    assert Configuration.from_flat(found.configuration).to_flat() == run.configuration.to_flat()
    again = simulate(Configuration.from_flat(found.configuration))
    assert again.v.tobytes() == run.v.tobytes()
    assert found.info['mode'] == 'offline'
    assert {'started', 'host', 'platform', 'python', 'dz_ros', 'plant', 'law',
            'seed'} <= set(found.info)


def test_the_order_in_the_file_is_that_of_the_loop(tmp_path, make_run):
    data = make_run(3)
    same_time = RunData({name: replace(channel, log_time=np.arange(3))
                         for name, channel in reversed(data.channels.items())}, events=(
        (1, '/a', 'first'), (1, '/b', 'second')))
    save_run(same_time, tmp_path / 'run')
    found = [item.topic for batch in McapFile(tmp_path / 'run/run_0.mcap').batches()
             for item in batch]
    sample = ['/reference', '/state', '/command', '/terms', '/truth']
    assert found == [*sample, *sample, '/events', '/events', *sample]


def test_the_namespace_stays(tmp_path, make_run):
    data = replace(make_run(3), info={'namespace': '/left'})
    save_run(data, tmp_path / 'run')
    file = McapFile(tmp_path / 'run/run_0.mcap')
    list(file.batches())
    assert set(file.topics) == {f'/left/{name}' for name in (*data.channels, 'events')}
    assert read_run(tmp_path / 'run').info['namespace'] == '/left'


def test_refusals(tmp_path, make_run):
    data = make_run(3)
    save_run(data, tmp_path / 'run')
    with pytest.raises(RunExistsError):
        save_run(data, tmp_path / 'run')
    for name in ('speed', 'events'):
        with pytest.raises(RecordingError, match=f'no run has a channel {name}'):
            save_run(RunData({name: data.channels['state']}), tmp_path / 'other')
    assert not (tmp_path / 'other').exists()


@st.composite
def runs(draw):
    """Return any run: any numbers, any times, as many messages a channel as come."""
    channels = {}
    for name in draw(st.lists(st.sampled_from(['reference', 'state', 'command', 'terms']),
                              unique=True, min_size=1)):
        labels = ('seq', 'stamp', *(f'{name}{i}' for i in range(draw(st.integers(0, 9)))))
        count = draw(st.integers(1, 8))
        row = st.lists(st.floats(), min_size=len(labels), max_size=len(labels))
        values = draw(st.lists(row, min_size=count, max_size=count))
        for item in values:     # the first two distinguish messages and place them in time
            item[:2] = draw(st.integers(0, 2 ** 40 - 1)), draw(st.floats(-4e9, 4e9))
        log, publish = (draw(st.lists(TIMES, min_size=count, max_size=count)) for _ in range(2))
        channels[name] = Channel(labels, np.array(values), np.array(sorted(log)),
                                 np.array(publish))
    events = draw(st.lists(st.tuples(TIMES, st.just(''), st.text(
        st.characters(exclude_categories=['Cs'], exclude_characters='\0{'))), max_size=4))
    return RunData(channels, draw(st.dictionaries(
        st.sampled_from(['loop.rate', 'plant.x0', 'controller.law']),
        st.one_of(st.floats(allow_nan=False), st.integers(), st.booleans(), st.text(
            st.characters(exclude_categories=['Cs'])), st.lists(st.floats(allow_nan=False))))),
        {}, tuple(sorted(events, key=lambda item: item[0])))


@SLOW
@given(runs())
def test_record_read_record(place, data):
    first, second = place(), place()
    save_run(data, first)
    found = read_run(first)
    save_run(found, second)
    for read in (found, read_run(second)):
        assert read.events == data.events
        assert read.configuration == data.configuration
        assert set(read.channels) == set(data.channels)
        for name, channel in data.channels.items():
            assert read.channels[name].labels == channel.labels
            assert read.channels[name].values.tobytes() == channel.values.tobytes()
            assert read.channels[name].log_time.tolist() == channel.log_time.tolist()
            assert read.channels[name].publish_time.tolist() == channel.publish_time.tolist()
