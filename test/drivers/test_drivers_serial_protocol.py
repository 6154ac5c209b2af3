# SPDX-License-Identifier: Apache-2.0
"""The serial protocol: bytes as documented, no number that was not sent."""

import math
import struct

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.serial import protocol
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    FrameError,
    Hello,
    Info,
    Mode,
    newer,
    Request,
    State,
    VersionError,
)

U32 = st.integers(0, 2 ** 32 - 1)
SESSION = st.integers(1, 2 ** 32 - 1)
COUNTS = st.integers(-2 ** 31, 2 ** 31 - 1)
SCALE = st.floats(1e-9, 1e9).map(lambda x: float(f'{x:.6g}'))
FRAMES = st.one_of(
    st.builds(Hello, SESSION, SESSION),
    st.builds(Command, U32, U32, COUNTS, COUNTS, st.integers(1, 1000), st.sampled_from(Request)),
    st.integers(1, 4).flatmap(lambda n: st.builds(
        Info, U32, st.just(n), st.integers(1, 2 ** 31 - 1), SCALE,
        st.tuples(*[SCALE] * n), st.text('abc é', max_size=8).map(lambda t: t.rstrip('\0')))),
    st.builds(State, U32, U32, U32, U32, st.sampled_from(Mode), st.integers(0, 255),
              st.integers(0, 65535), st.lists(COUNTS, min_size=1, max_size=4).map(tuple)))


@given(FRAMES)
def test_every_frame_comes_back(frame):
    assert decode(frame.body()) == frame


@given(st.binary(max_size=80) | FRAMES.flatmap(lambda frame: st.binary(max_size=60).map(
    lambda tail: frame.body()[:3] + tail)))
def test_whatever_the_bytes_it_is_a_frame_or_an_error(body):
    try:
        frame = decode(body)
    except FrameError:
        return
    if isinstance(frame, Info):     # its scales are rounded, its name is padded
        assert frame.values == len(frame.state_scales)
        assert all(0.0 < scale < math.inf for scale in frame.state_scales)
    else:
        assert frame.body() == body


def test_bytes_as_documented():
    assert Hello(0x01020304, 1000).body().hex() == '0101' '04030201' 'e8030000'
    assert Command(5, 6, -2, 3, 15, Request.RUN).body().hex() == (
        '0102' '05000000' '06000000' 'feffffff' '03000000' '0f00' '01')
    assert State(5, 7, 8, 6, Mode.FAULT, 9, 258, (-1, 2)).body().hex() == (
        '0182' '05000000' '07000000' '08000000' '06000000' '03' '09' '0201' 'ffffffff' '02000000')
    info = Info(5, 2, 30000, 0.5, (0.25, 2.0), 'abc').body()
    assert info.hex() == ('0181' '05000000' '02' '30750000' '0000003f' '0000803e' '00000040'
                          '00000000' '00000000' + b'abc'.hex() + '00' * 13)


@pytest.mark.parametrize('body', [
    b'', b'\x01', b'\x01\x99', Hello(1, 1).body()[:-1], Hello(0, 1).body(), Hello(1, 0).body(),
    Command(1, 1, 0, 0, 0, Request.RUN).body(), Command(1, 1, 0, 0, 1001, Request.RUN).body(),
    Command(1, 1, 0, 0, 1, 9).body(), State(1, 1, 1, 1, 9, 0, 0, (1,)).body(),
    State(1, 1, 1, 1, Mode.RUN, 0, 0, ()).body(),
    State(1, 1, 1, 1, Mode.RUN, 0, 0, (1, 2, 3, 4, 5)).body(),
    State(1, 1, 1, 1, Mode.RUN, 0, 0, (1,)).body() + b'\0',
    Info(1, 0, 1, 1.0, (), '').body(), Info(1, 5, 1, 1.0, (), '').body(),
    Info(1, 1, 0, 1.0, (1.0,), '').body(), Info(1, 1, -1, 1.0, (1.0,), '').body(),
    Info(1, 1, 1, 0.0, (1.0,), '').body(), Info(1, 1, 1, 1.0, (0.0,), '').body(),
    Info(1, 1, 1, math.nan, (1.0,), '').body(), Info(1, 2, 1, 1.0, (1.0, math.inf), '').body(),
])
def test_frames_of_no_use_are_refused(body):
    with pytest.raises(FrameError):
        decode(body)


def test_another_version_is_named():
    with pytest.raises(VersionError, match='speaks version 2 of the protocol, not 1') as caught:
        decode(b'\x02' + Hello(1, 1).body()[1:])
    assert caught.value.version == 2


def test_scales_are_what_was_meant_not_what_single_precision_makes_of_it():
    sent = Info(1, 2, 1, 1e-3, (1e-6, 2 * math.pi / 4096), 'x')
    got = decode(sent.body())
    assert got.command_scale == 1e-3
    assert got.state_scales[0] == 1e-6
    assert got.state_scales[1] == pytest.approx(2 * math.pi / 4096, rel=1e-7)


@given(U32, st.integers(1, 2 ** 31 - 1))
def test_counts_that_wrap_around_are_still_newer(seq, ahead):
    later = (seq + ahead) % 2 ** 32
    assert newer(later, seq)
    assert not newer(seq, later)
    assert not newer(seq, seq)


def test_largest_frame_fits():
    sizes = [struct.calcsize('<BBIBif4f16s'), State.LAYOUT.size + 4 * protocol.MAX_VALUES]
    assert max(sizes) <= 60
