# SPDX-License-Identifier: Apache-2.0
"""The serial protocol: bytes as documented, no number that was not sent."""

import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.serial.framing import MAX_BODY
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    FrameError,
    Hello,
    Info,
    MAX_MOTORS,
    MAX_VALUES,
    Mode,
    MotorInfo,
    newer,
    Request,
    State,
    VersionError,
)

U32 = st.integers(0, 2 ** 32 - 1)
SESSION = st.integers(1, 2 ** 32 - 1)
COUNTS = st.integers(-2 ** 31, 2 ** 31 - 1)
SCALE = st.floats(1e-9, 1e9).map(lambda x: float(f'{x:.6g}'))
MOTORS = st.integers(1, MAX_MOTORS)


def rows(item, count):
    """Return what gives an item for each of this number of motors."""
    return st.tuples(*[item] * count)


FRAMES = MOTORS.flatmap(lambda n: st.one_of(
    st.builds(Hello, SESSION, SESSION, st.just(n)),
    st.builds(Command, U32, U32, rows(COUNTS, n), rows(COUNTS, n), st.integers(1, 1000),
              st.sampled_from(Request)),
    st.integers(1, 4).flatmap(lambda values: st.builds(
        Info, U32, rows(st.builds(MotorInfo, st.integers(1, 2 ** 31 - 1), SCALE,
                                  rows(SCALE, values)), n),
        st.text('abc é', max_size=8).map(lambda t: t.rstrip('\0')))),
    st.integers(1, 4).flatmap(lambda values: st.builds(
        State, U32, U32, U32, U32, st.sampled_from(Mode), st.integers(0, 255),
        rows(st.integers(0, 65535), n), rows(rows(COUNTS, values), n)))))


@pytest.mark.slow
@given(FRAMES)
def test_every_frame_comes_back(frame):
    assert decode(frame.body()) == frame


@given(st.binary(max_size=230) | FRAMES.flatmap(lambda frame: st.binary(max_size=216).map(
    lambda tail: frame.body()[:3] + tail)))
def test_whatever_the_bytes_it_is_a_frame_or_an_error(body):
    try:
        frame = decode(body)
    except FrameError:
        return
    if isinstance(frame, Info):     # its scales are rounded, its name is padded
        for motor in frame.each:
            assert frame.values == len(motor.state_scales)
            assert all(0.0 < scale < math.inf for scale in motor.state_scales)
    else:
        assert frame.body() == body


def test_bytes_as_documented():
    assert Hello(0x01020304, 1000).body().hex() == '0101' '04030201' 'e8030000'
    assert Command(5, 6, (-2,), (3,), 15, Request.RUN).body().hex() == (
        '0102' '05000000' '06000000' 'feffffff' '03000000' '0f00' '01')
    assert State(5, 7, 8, 6, Mode.FAULT, 9, (258,), ((-1, 2),)).body().hex() == (
        '0182' '05000000' '07000000' '08000000' '06000000' '03' '09' '0201' 'ffffffff' '02000000')
    info = Info(5, (MotorInfo(30000, 0.5, (0.25, 2.0)),), 'abc').body()
    assert info.hex() == ('0181' '05000000' '02' '30750000' '0000003f' '0000803e' '00000040'
                          '00000000' '00000000' + b'abc'.hex() + '00' * 13)


def test_bytes_of_several_motors_as_documented():
    assert Hello(0x01020304, 1000, 2).body().hex() == '0201' '04030201' 'e8030000' '02'
    assert Command(5, 6, (-2, 7), (3, -1), 15, Request.RUN).body().hex() == (
        '0202' '05000000' '06000000' '0f00' '01' '02' 'feffffff' '03000000' '07000000' 'ffffffff')
    assert State(5, 7, 8, 6, Mode.FAULT, 9, (258, 0), ((-1, 2), (3, 4))).body().hex() == (
        '0282' '05000000' '07000000' '08000000' '06000000' '03' '09' '02' '02'
        '0201' 'ffffffff' '02000000' '0000' '03000000' '04000000')
    info = Info(5, (MotorInfo(30000, 0.5, (0.25,)), MotorInfo(100, 2.0, (4.0,))), 'abc').body()
    assert info.hex() == ('0281' '05000000' '02' '01' + b'abc'.hex() + '00' * 13
                          + '30750000' '0000003f' '0000803e' + '00' * 12
                          + '64000000' '00000040' '00008040' + '00' * 12)


def info(values=1, limit=1, scale=1.0, scales=(1.0,), motors=1):
    """Return the body of an INFO whose last motor is so."""
    body = Info(1, (*[MotorInfo(1, 1.0, scales)] * (motors - 1), MotorInfo(limit, scale, scales)),
                '').body()
    at = 6 if motors == 1 else 7
    return body[:at] + bytes([values]) + body[at + 1:]


def command(hold=1, request=Request.RUN, motors=1):
    return Command(1, 1, (0,) * motors, (0,) * motors, hold, request).body()


def state(mode=Mode.RUN, values=(1,), motors=1):
    return State(1, 1, 1, 1, mode, 0, (0,) * motors, (values,) * motors).body()


@pytest.mark.parametrize(('body', 'at'), [
    (Hello(1, 1, 2).body(), 10), (command(motors=2), 13), (info(motors=2), 6),
    (state(motors=2), 20)])
@pytest.mark.parametrize('count', [0, 1, 3, MAX_MOTORS + 1, 255])
def test_a_number_of_motors_that_cannot_be_is_refused(body, at, count):
    decode(body)
    if body[1] == Hello.KIND and count == 3:
        return      # has no rows that could contradict it
    with pytest.raises(FrameError):
        decode(body[:at] + bytes([count]) + body[at + 1:])


@pytest.mark.parametrize('body', [
    b'', b'\x01', b'\x01\x99', b'\x02\x99', b'\x02\x01', b'\x02\x02', b'\x02\x81', b'\x02\x82',
    *(body for motors in (1, 2, MAX_MOTORS) for body in (
        Hello(1, 1, motors).body()[:-1], Hello(0, 1, motors).body(), Hello(1, 0, motors).body(),
        command(0, motors=motors), command(1001, motors=motors), command(1, 9, motors),
        command(motors=motors) + b'\0', command(motors=motors)[:-8],
        state(9, motors=motors), state(values=(), motors=motors),
        state(values=(1, 2, 3, 4, 5), motors=motors), state(motors=motors) + b'\0',
        info(0, motors=motors), info(5, motors=motors), info(limit=0, motors=motors),
        info(limit=-1, motors=motors), info(scale=0.0, motors=motors),
        info(scales=(0.0,), motors=motors), info(scale=math.nan, motors=motors),
        info(2, scales=(1.0, math.inf), motors=motors), info(motors=motors)[:-24])),
])
def test_frames_of_no_use_are_refused(body):
    with pytest.raises(FrameError):
        decode(body)


def test_another_version_is_named():
    with pytest.raises(VersionError, match='speaks version 3 of the protocol, not 1') as caught:
        decode(b'\x03' + Hello(1, 1).body()[1:])
    assert caught.value.version == 3


def test_scales_are_what_was_meant_not_what_single_precision_makes_of_it():
    sent = Info(1, (MotorInfo(1, 1e-3, (1e-6, 2 * math.pi / 4096)),), 'x')
    (got,) = decode(sent.body()).each
    assert got.command_scale == 1e-3
    assert got.state_scales[0] == 1e-6
    assert got.state_scales[1] == pytest.approx(2 * math.pi / 4096, rel=1e-7)


@given(U32, st.integers(1, 2 ** 31 - 1))
def test_counts_that_wrap_around_are_still_newer(seq, ahead):
    later = (seq + ahead) % 2 ** 32
    assert newer(later, seq)
    assert not newer(seq, later)
    assert not newer(seq, seq)


@pytest.mark.parametrize('motors', range(1, MAX_MOTORS + 1))
def test_the_largest_frames_fit(motors):
    values = (0,) * MAX_VALUES
    bodies = (command(motors=motors), state(values=values, motors=motors),
              info(MAX_VALUES, scales=(1.0,) * MAX_VALUES, motors=motors))
    assert max(map(len, bodies)) <= MAX_BODY
    assert len(bodies[1]) == State.size(motors, MAX_VALUES)
    # Those of one motor are as long as they ever were.
    assert motors > 1 or max(map(len, bodies)) <= 60
