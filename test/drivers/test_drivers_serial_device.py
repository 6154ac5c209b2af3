# SPDX-License-Identifier: Apache-2.0
"""The device's machine: its table of modes, its watchdog, and that C and Python are the same."""

import ctypes
from dataclasses import replace
import itertools

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest

from dz_ros.drivers.serial.device import Device, IDLE_PERIOD_US, MIN_PERIOD_US
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
SESSION = 77


def info(motors):
    """Return what a device of so many motors is; they repeat after three."""
    return Info(0, tuple(MOTORS[place % 3] for place in range(motors)), 'bench')


def each(v, motors):
    """Return a command of each motor: of the next one the negative one less."""
    return tuple(v if place % 2 == 0 else -v - 1 for place in range(motors))


class Bench:
    """A device on a bench: hears what the test sends, keeps what it sends and actuates.

    Attributes:
        fault: Code of the last motor.
        actuated: What the first motor was given, in order; None = no power.
        others: What the others were given at the same times.
    """

    def __init__(self, motors=1):
        self.motors, self.fault, self.actuated, self.others = motors, 0, [], []
        self.now = 1000
        self.device = Device(info(motors), self.measure, self.actuate)
        self._receiver = Receiver()

    def measure(self):
        return [(3, -4 - place) for place in range(self.motors)], [
            *[0] * (self.motors - 1), self.fault]

    def actuate(self, v):
        self.actuated.append(None if v is None else v[0])
        self.others.append(None if v is None else v[1:])

    def step(self, *frames, after=1000):
        self.now += after
        sent = self.device.step(b''.join(pack(frame.body()) for frame in frames), self.now)
        return [decode(body) for body in self._receiver.feed(sent)]

    def ask(self, request, seq, v=0, safe=0, hold=50, session=SESSION, after=1000):
        return self.step(Command(session, seq, each(v, self.motors), each(safe, self.motors), hold,
                                 request), after=after)


@pytest.fixture(params=[1, 2, 8])
def cold(request):
    """A device of one motor or several that has been greeted, without power."""
    made = Bench(request.param)
    found, *_ = made.step(Hello(SESSION, 1000, request.param))
    assert found == replace(info(request.param), session=SESSION)
    return made


@pytest.fixture
def bench(cold):
    """A device with power."""
    (state,) = cold.ask(Request.SAFE, 2 ** 32 - 1000)
    assert state.mode is Mode.SAFE
    return cold


@pytest.mark.parametrize('motors', [1, 3])
def test_before_a_greeting_it_says_so_and_takes_nothing(motors):
    bench = Bench(motors)
    states = [frame for _ in range(250) for frame in bench.ask(Request.RUN, 5, v=9, session=0)]
    assert [state.session for state in states] == [0] * len(states)
    assert len(states) == 1 + 250 * 1000 // IDLE_PERIOD_US
    assert bench.actuated == [None]


@pytest.mark.parametrize(('path', 'mode', 'actuated'), [
    ((Request.RUN,), Mode.DISABLED, None),
    ((Request.SAFE,), Mode.SAFE, -2),
    ((Request.SAFE, Request.RUN), Mode.RUN, 7),
    ((Request.SAFE, Request.RUN, Request.SAFE), Mode.SAFE, -2),
    ((Request.SAFE, Request.RUN, Request.DISABLE), Mode.DISABLED, None),
    ((Request.SAFE, Request.DISABLE, Request.RUN), Mode.DISABLED, None),
    ((Request.SAFE, Request.DISABLE), Mode.DISABLED, None),
    ((Request.SAFE, Request.RUN, Request.ESTOP), Mode.ESTOP, None),
    ((Request.ESTOP, Request.RUN), Mode.ESTOP, None),
    ((Request.ESTOP, Request.SAFE), Mode.ESTOP, None),
    ((Request.ESTOP, Request.DISABLE), Mode.ESTOP, None),
    ((Request.ESTOP, Request.RESET), Mode.DISABLED, None),
    ((Request.SAFE, Request.RUN, Request.RESET), Mode.RUN, 7),
    ((Request.ESTOP, Request.RESET, Request.RUN), Mode.DISABLED, None),
    ((Request.ESTOP, Request.RESET, Request.SAFE, Request.RUN), Mode.RUN, 7),
])
def test_table_of_modes(cold, path, mode, actuated):
    for seq, request in enumerate(path):
        (state,) = cold.ask(request, seq, v=7, safe=-2)
    assert (state.mode, state.echo) == (mode, len(path) - 1)
    assert state.values == tuple((3, -4 - place) for place in range(cold.motors))
    assert cold.actuated[-1] == actuated
    assert cold.others[-1] == (None if actuated is None else each(actuated, cold.motors)[1:])


def test_commands_are_clipped_to_the_limit(bench):
    for seq, (v, safe) in enumerate([(501, 0), (-2 ** 31, 0), (2 ** 31 - 1, 0)]):
        bench.ask(Request.RUN, seq, v, safe)
        assert abs(bench.actuated[-1]) == 500
        assert [abs(given) for given in bench.others[-1][:1]] == [300][:bench.motors - 1]
    bench.ask(Request.SAFE, 9, 0, -900)
    assert bench.actuated[-1] == -500
    assert bench.others[-1][:2] == (300, -900)[:bench.motors - 1]


def test_commands_for_another_number_of_motors_are_not_taken(bench):
    bench.ask(Request.RUN, 1, v=7)
    for motors in {1, 2, 3, 8} - {bench.motors}:
        v = (9,) * motors
        for frame in (Hello(SESSION + 1, 1000, motors),
                      Command(SESSION, 5, v, v, 50, Request.ESTOP)):
            (state,) = bench.step(frame)
            assert (state.session, state.echo, state.mode) == (SESSION, 1, Mode.RUN)
    assert bench.actuated[-1] == 7


def test_watchdog_takes_the_safe_command_once_and_a_new_command_wakes_it(bench):
    bench.ask(Request.RUN, 1, v=7, safe=-2, hold=5)
    for _ in range(4):
        (state,) = bench.step()
        assert state.mode is Mode.RUN
    for _ in range(10):
        (state,) = bench.step()
        assert (state.mode, state.trips) == (Mode.SAFE, 1)
    assert bench.actuated[-1] == -2
    (state,) = bench.ask(Request.RUN, 2, v=8)
    assert (state.mode, bench.actuated[-1]) == (Mode.RUN, 8)


def test_old_repeated_and_foreign_commands_are_not_taken(bench):
    bench.ask(Request.RUN, 2 ** 32 - 1, v=1)
    for seq, session in ((2 ** 32 - 1, SESSION), (2 ** 32 - 9, SESSION), (5, SESSION + 1), (5, 0)):
        (state,) = bench.ask(Request.RUN, seq, v=99, session=session)
        assert (state.echo, bench.actuated[-1]) == (2 ** 32 - 1, 1)
    (state,) = bench.ask(Request.RUN, 0, v=2)
    assert (state.echo, bench.actuated[-1]) == (0, 2)


def test_what_is_not_taken_does_not_feed_the_watchdog(bench):
    bench.ask(Request.RUN, 1, v=7, hold=5)
    for _ in range(6):
        (state,) = bench.ask(Request.RUN, 1, v=7, hold=5)
    assert state.mode is Mode.SAFE


def test_a_fault_is_latched_until_reset_and_back_while_it_lasts(bench):
    bench.ask(Request.RUN, 1, v=7)
    bench.fault = 9
    (state,) = bench.step()
    none = (0,) * bench.motors
    latched = (*none[1:], 9)        # of the last motor, and the power of all is off
    assert (state.mode, state.faults) == (Mode.FAULT, latched)
    assert bench.actuated[-1] is bench.others[-1] is None
    (state,) = bench.ask(Request.RESET, 2)
    assert (state.mode, state.faults) == (Mode.FAULT, latched)
    bench.fault = 0
    (state,) = bench.ask(Request.RUN, 3, v=7)
    assert (state.mode, state.faults) == (Mode.FAULT, latched)
    (state,) = bench.ask(Request.RESET, 4)
    assert (state.mode, state.faults) == (Mode.DISABLED, none)


def test_a_new_session_takes_power_away_the_same_one_changes_nothing(bench):
    bench.ask(Request.RUN, 5, v=7)
    info, state = bench.step(Hello(SESSION, 1000, bench.motors))
    assert (state.mode, state.echo) == (Mode.RUN, 5)
    info, state = bench.step(Hello(SESSION + 1, 1000, bench.motors))
    assert (info.session, state.session, state.mode) == (SESSION + 1, SESSION + 1, Mode.DISABLED)
    assert bench.actuated[-1] is None
    bench.ask(Request.SAFE, 1, session=SESSION + 1)         # counts begin anew
    bench.ask(Request.RUN, 2, v=7, session=SESSION + 1)
    assert bench.actuated[-1] == 7


def test_states_come_at_the_period_asked_for_never_two_at_once(bench):
    bench.step(Hello(SESSION, 5000, bench.motors))
    times = [frame.time_us for _ in range(40) for frame in bench.step()]
    assert {b - a for a, b in itertools.pairwise(times)} == {5000}
    assert len(bench.step(after=23_000)) == 1
    bench.step(Hello(SESSION, 1, bench.motors))
    times = [frame.time_us for _ in range(50) for frame in bench.step(after=50)]
    assert {b - a for a, b in itertools.pairwise(times)} == {MIN_PERIOD_US}


# The firmware in C beside the device in Python.

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


def said(motors):
    """Return what gives frames of a host of so many motors."""
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
    own = said(motors).map(lambda frame: frame.body())
    return st.one_of(
        own.map(pack), own.map(pack), own.map(pack), st.binary(max_size=20),
        st.tuples(own, st.integers(0, 300), st.integers(1, 255)).map(
            lambda item: damaged(pack(item[0]), *item[1:])),
        # Damage that the CRC does not show: another version, kind, number of motors, length.
        st.tuples(own, st.integers(0, 300), st.integers(1, 255)).map(
            lambda item: pack(damaged(*item))),
        st.tuples(own, st.integers(-8, 8)).map(lambda item: pack(
            item[0][:item[1]] if item[1] < 0 else item[0] + bytes(item[1]))),
        st.sampled_from((1, 2, 3, 8)).flatmap(said).map(lambda frame: pack(frame.body())),
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
    # A clock that comes round while nobody commands wakes nothing.
    for after in (6_000, 2 ** 31, 2 ** 32 - 6_000, 2 ** 32):
        for body in receiver.feed(device.step(b'', start + 1_000_000 + after)):
            assert decode(body).mode is Mode.SAFE
    assert actuated[-1] == each(0, motors)
    assert isinstance(states[-1], State)
