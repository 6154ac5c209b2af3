# SPDX-License-Identifier: Apache-2.0
"""The firmware in C beside the device in Python: the same bytes, commands and faults."""

import ctypes

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.serial.device import Device
from dz_ros.drivers.serial.framing import cobs_decode, cobs_encode, pack, Receiver
from dz_ros.drivers.serial.protocol import (
    Command,
    decode,
    Hello,
    Info,
    Mode,
    MotorInfo,
    Request,
    State,
)

MOTORS = (MotorInfo(500, 0.5, (0.25, 2.0)), MotorInfo(300, 1.0, (0.5, 4.0)),
          MotorInfo(2 ** 31 - 1, 1e-3, (1e-6, 1e-6)))


def info(motors):
    """Return what a device of this number of motors is; they repeat after three."""
    return Info(0, tuple(MOTORS[place % 3] for place in range(motors)), 'bench')


def each(v, motors):
    """Return a command of each motor: of the next one the negative one less."""
    return tuple(v if place % 2 == 0 else -v - 1 for place in range(motors))


class Hardware(ctypes.Structure):
    READ = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint8),
                            ctypes.c_size_t)
    WRITE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint8),
                             ctypes.c_size_t)
    MEASURE = ctypes.CFUNCTYPE(ctypes.c_uint16, ctypes.c_void_p, ctypes.c_uint8,
                               ctypes.POINTER(ctypes.c_int32))
    ACTUATE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint8, ctypes.c_int,
                               ctypes.c_int32)
    _fields_ = [('read', READ), ('write', WRITE), ('measure', MEASURE), ('actuate', ACTUATE),
                ('self', ctypes.c_void_p)]


class Motor(ctypes.Structure):
    _fields_ = [('limit', ctypes.c_int32), ('command_scale', ctypes.c_float),
                ('state_scales', ctypes.c_float * 4)]


def description(found):
    """Return the description of a device in C."""
    class Description(ctypes.Structure):
        _fields_ = [('values', ctypes.c_uint8), ('motors', Motor * found.motors),
                    ('name', ctypes.c_char * 16)]

    return Description(found.values, (Motor * found.motors)(*(
        Motor(item.limit, item.command_scale, (ctypes.c_float * 4)(*item.state_scales))
        for item in found.each)), found.name.encode())


class Firmware:
    """The device in C, with the interface of the one in Python."""

    def __init__(self, library, info, measure, actuate):
        self._library = library
        self._in, self._out = b'', b''

        def read(_, data, size):
            piece, self._in = self._in[:size], self._in[size:]
            ctypes.memmove(data, piece, len(piece))
            return len(piece)

        def write(_, data, size):
            self._out += ctypes.string_at(data, size)

        self._given = []

        def sense(_, motor, values):
            rows, codes = measure()
            for place, value in enumerate(rows[motor]):
                values[place] = value
            return codes[motor]

        def give(_, motor, powered, v):
            assert motor == len(self._given)        # one after the other
            assert powered or v == 0
            self._given.append(v if powered else None)
            if motor == info.motors - 1:
                actuate(None if None in self._given else tuple(self._given))
                self._given = []

        self._hardware = Hardware(Hardware.READ(read), Hardware.WRITE(write),
                                  Hardware.MEASURE(sense), Hardware.ACTUATE(give), None)
        self._description = description(info)
        self._memory = ctypes.create_string_buffer(1024)
        library.dz_device_init(self._memory, ctypes.byref(self._hardware),
                               ctypes.byref(self._description))

    def step(self, received, now):
        self._in, self._out = received, b''
        self._library.dz_device_step(self._memory, ctypes.c_uint32(now % 2 ** 32))
        assert not self._in, 'the firmware did not read everything'
        return self._out


@pytest.fixture(scope='module', params=[1, 2, 3, 8])
def library(request, firmware_library):
    """The firmware for a number of motors, `motors`."""
    found = ctypes.CDLL(str(firmware_library(request.param)))
    found.motors = request.param
    found.dz_crc32.restype = ctypes.c_uint32
    found.dz_cobs_encode.restype = found.dz_cobs_decode.restype = ctypes.c_size_t
    found.dz_crc32.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
    found.dz_cobs_encode.argtypes = found.dz_cobs_decode.argtypes = [
        ctypes.c_char_p, ctypes.c_size_t, ctypes.c_char_p]
    return found


@given(st.binary(max_size=600))
def test_cobs_in_c_is_cobs_in_python(library, data):
    buffer = ctypes.create_string_buffer(800)
    size = library.dz_cobs_encode(data, len(data), buffer)
    assert buffer.raw[:size] == cobs_encode(data)
    size = library.dz_cobs_decode(data, len(data), buffer)
    expected = cobs_decode(data)
    assert (None if size == 2 ** (8 * ctypes.sizeof(ctypes.c_size_t)) - 1
            else buffer.raw[:size]) == expected


def test_crc_in_c_has_the_check_value(library):
    assert library.dz_crc32(b'123456789', 9) == 0xCBF43926


SMALL = st.integers(0, 3)
NUMBERS = st.integers(-2 ** 31, 2 ** 31 - 1)


def reported(motors):
    """Return what gives frames of a host of this number of motors."""
    return st.one_of(
        st.builds(Hello, SMALL, st.sampled_from((0, 1, 1000, 5000, 2 ** 32 - 1)),
                  st.just(motors)),
        st.builds(lambda v, safe, *rest: Command(*rest[:2], each(v, motors), each(safe, motors),
                                                 *rest[2:]),
                  st.integers(-2 ** 31 + 1, 2 ** 31 - 1), st.integers(-600, 600), SMALL,
                  st.integers(0, 6) | st.integers(2 ** 32 - 3, 2 ** 32 - 1),
                  st.sampled_from((0, 1, 5, 1000, 1001)), st.integers(0, 5)))


def pieces(motors):
    """Return what gives pieces of what a line brings: of its host, of another one, damage."""
    own = reported(motors).map(lambda frame: frame.body())
    return st.one_of(
        own.map(pack), own.map(pack), own.map(pack), st.binary(max_size=20),
        st.tuples(own, st.integers(0, 300), st.integers(1, 255)).map(
            lambda item: damaged(pack(item[0]), *item[1:])),
        # Damage that the CRC does not show: another version, kind, number of motors, length.
        st.tuples(own, st.integers(0, 300), st.integers(1, 255)).map(
            lambda item: pack(damaged(*item))),
        st.tuples(own, st.integers(-8, 8)).map(lambda item: pack(
            item[0][:item[1]] if item[1] < 0 else item[0] + bytes(item[1]))),
        st.sampled_from((1, 2, 3, 8)).flatmap(reported).map(lambda frame: pack(frame.body())),
        st.just(b'\x01' * 80), st.just(b'\x01' * 230))


def steps(motors):
    """Return what gives steps: bytes, time that passes [µs], a measured value, fault codes."""
    return st.lists(st.tuples(
        st.lists(pieces(motors), max_size=3).map(lambda found: b''.join(found)[:256]),
        st.integers(0, 3000) | st.just(40_000), NUMBERS, st.sampled_from((0, 0, 0, 0, 3)).flatmap(
            lambda code: st.integers(0, motors - 1).map(
                lambda motor: [code * (place == motor) for place in range(motors)]))),
        max_size=40)


def damaged(frame, at, by):
    """Return a frame with a byte changed."""
    place = at % len(frame)
    return frame[:place] + bytes([frame[place] ^ by]) + frame[place + 1:]


def greeted(motors, *commands):
    """Return bytes: a greeting and commands (seq, v, safe, hold, request)."""
    return [pack(Hello(1, 1000, motors).body()), *(pack(Command(
        1, seq, each(v, motors), each(safe, motors), hold, request).body())
        for seq, v, safe, hold, request in commands)]


@pytest.mark.slow
@settings(max_examples=2 * settings.default.max_examples, deadline=None,
          suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_firmware_and_emulated_device_send_and_actuate_the_same(library, data):
    beside(library, data.draw(steps(library.motors)))


def test_a_trip_in_the_microsecond_it_is_due_is_the_same(library):
    hello, safe, run = greeted(library.motors, (0, 5, 6, 1, 2), (1, 5, 6, 1, 1))
    none = [0] * library.motors
    beside(library, [(hello, 0, 0, none), (safe, 5, 0, none), (run, 5, -1, none),
                     (b'', 999, 1, none), (b'', 1, 1, none), (b'', 1, 1, [*none[1:], 4])])


def beside(library, found):
    """Let the device in C and the one in Python go through the same."""
    now, motors = 5, library.motors
    sensed, actuated, devices = [None, None], ([], []), []
    devices.append(Device(info(motors), lambda: sensed, actuated[0].append))
    sensed[:] = [(0, 0)] * motors, [0] * motors
    devices.append(Firmware(library, info(motors), lambda: sensed, actuated[1].append))
    for received, after, value, codes in found:
        now += after
        sensed[:] = [(value, -value - 1 - place % 2 * (value < 0))
                     for place in range(motors)], codes
        sent = [device.step(received, now) for device in devices]
        assert sent[0] == sent[1]
        assert actuated[0] == actuated[1]


def test_the_firmwares_clock_may_wrap_around(library):
    motors, actuated = library.motors, []
    sensed = [(0, 0)] * motors, [0] * motors
    device = Firmware(library, info(motors), lambda: sensed, actuated.append)
    receiver = Receiver()
    start = 2 ** 32 - 500_000
    device.step(b''.join(greeted(motors, (0, 0, 0, 5, Request.SAFE))), start)
    states = []
    for k in range(1, 1001):
        _, run = greeted(motors, (k, k, 0, 5, Request.RUN))
        sent = device.step(run, start + 1000 * k)
        states += [decode(body) for body in receiver.feed(sent)]
    assert [state.mode for state in states] == [Mode.RUN] * 1000
    assert [v[0] for v in actuated[-1000:]] == [min(k, 500) for k in range(1, 1001)]
    if motors > 1:
        assert [v[1] for v in actuated[-1000:]] == [max(-k - 1, -300) for k in range(1, 1001)]
    # A clock that comes round without commands wakes nothing.
    for after in (6_000, 2 ** 31, 2 ** 32 - 6_000, 2 ** 32):
        for body in receiver.feed(device.step(b'', start + 1_000_000 + after)):
            assert decode(body).mode is Mode.SAFE
    assert actuated[-1] == each(0, motors)
    assert isinstance(states[-1], State)
