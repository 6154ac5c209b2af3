# SPDX-License-Identifier: Apache-2.0
"""Every record type through a file and back: record → MCAP → record, awkward numbers included."""

import struct

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest

from dz_ros.core.records import Command, Reference, State, Status, Terms, Truth
from dz_ros.core.signals import TERM_NAMES
from dz_ros.recording.cdr import ArrayCodec
from dz_ros.recording.channels import ARRAY
from dz_ros.recording.reader import read_run
from dz_ros.recording.writer import RunWriter

AWKWARD = st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 2.2250738585072014e-308,
                           1.7976931348623157e308, -1.7976931348623157e308, float('inf'),
                           float('-inf'), float('nan'), 0.1, 1 / 3])
NUMBERS = st.one_of(AWKWARD, st.floats())
SEQ = st.integers(0, 2 ** 40 - 1)
STAMPS = st.one_of(st.sampled_from([0.0, -0.0, 5e-324, 0.1, 1 / 3]),
                   st.floats(-4e9, 4e9))
SIGNALS = ('theta1', 'theta2', 'phi')


def vectors(size):
    return st.tuples(*[NUMBERS] * size)


RECORDS = {
    'reference': (st.builds(Reference, SEQ, STAMPS, vectors(3)), Reference.labels(2),
                  Reference.from_numbers),
    'state': (st.builds(State, SEQ, STAMPS, vectors(2), SEQ, NUMBERS, NUMBERS), State.labels(2),
              State.from_numbers),
    'command': (st.builds(Command, SEQ, STAMPS, NUMBERS, SEQ, NUMBERS, NUMBERS),
                Command.labels(), Command.from_numbers),
    'terms': (st.builds(Terms, SEQ, STAMPS, vectors(len(TERM_NAMES)), NUMBERS,
                        st.integers(0, 15).map(Status), SEQ, SEQ, vectors(len(SIGNALS))),
              Terms.labels(SIGNALS),
              lambda row: Terms(int(row[0]), row[1], tuple(row[2:10]), row[10],
                                Status(int(row[11])), int(row[12]), int(row[13]),
                                tuple(row[14:]))),
    'truth': (st.builds(Truth, SEQ, STAMPS, NUMBERS, NUMBERS, NUMBERS), Truth.labels(),
              lambda row: Truth(int(row[0]), *row[1:])),
}


def bits(value):
    """A value by its bits: a NaN is itself, −0.0 is not 0.0."""
    if isinstance(value, tuple):
        return tuple(bits(item) for item in value)
    return struct.pack('<d', value) if isinstance(value, float) else value


@settings(max_examples=6 * settings.default.max_examples // 10, deadline=None,
          suppress_health_check=list(HealthCheck))
@pytest.mark.parametrize('name', RECORDS)
@given(data=st.data())
def test_a_record_comes_back_as_it_was(name, data, tmp_path_factory):
    strategy, labels, from_row = RECORDS[name]
    records = data.draw(st.lists(strategy, min_size=1, max_size=6))
    codec = ArrayCodec(labels)
    with RunWriter(tmp_path_factory.mktemp('records') / 'run', {}, {}) as writer:
        writer.add_topic(f'/{name}', ARRAY.name)
        for record in records:
            assert len(record.numbers()) == len(labels)
            writer.write(f'/{name}', codec.encode(record.numbers()), 0, 0)
    channel = read_run(writer.directory).channels[name]
    assert channel.labels == labels
    found = [from_row(row) for row in channel.values.tolist()]
    for written, read in zip(records, found, strict=True):
        assert type(read) is type(written)
        for place in written._fields:
            assert bits(getattr(read, place)) == bits(getattr(written, place)), place
