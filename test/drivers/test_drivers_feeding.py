# SPDX-License-Identifier: Apache-2.0
"""The thread for slow devices: newest wins, nothing waits, nothing is lost at the end."""

import threading
import time

import pytest

from dz_ros.drivers.feeder import Feeder, Order
from dz_ros.errors import DriverError

TIME_OUT = 20.0


class Device:
    """Answers when the test lets it; notes every order."""

    def __init__(self):
        self.orders = []
        self.turn = threading.Semaphore(0)
        self.asked = threading.Semaphore(0)
        self.answer = (1.0, 2.0)

    def __call__(self, order):
        self.asked.release()
        assert self.turn.acquire(timeout=TIME_OUT)
        if order is not None:
            self.orders.append(order)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def until(condition):
    deadline = time.monotonic() + TIME_OUT
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


@pytest.fixture
def device():
    made = Device()
    yield made
    for _ in range(1000):
        made.turn.release()


@pytest.fixture
def feeder(device):
    made = Feeder(device, 0.005, fresh=TIME_OUT)
    made.start()
    yield made
    for _ in range(100):
        device.turn.release()
    made.stop(TIME_OUT)


def test_orders_the_device_is_too_slow_for_are_replaced_by_the_newest(device, feeder):
    assert device.asked.acquire(timeout=TIME_OUT)   # it is busy now
    for v in range(10):
        feeder.put(float(v), 0.005 * v)
    assert feeder.replaced == 9
    device.turn.release(2)
    until(lambda: device.orders)
    assert device.orders == [Order(9.0, 0.045)]


def test_the_loop_s_side_never_waits(device, feeder):
    assert device.asked.acquire(timeout=TIME_OUT)   # and keeps the thread
    assert feeder.newest() is None
    feeder.put(1.0, 0.0)
    assert feeder.fault() == ''
    assert device.orders == []      # all this while the device has not answered


def test_a_measurement_comes_in_and_grows_old(device):
    feeder = Feeder(device, 0.005, fresh=0.05)
    feeder.start()
    device.turn.release()
    until(lambda: feeder.newest() == (1.0, 2.0))
    until(lambda: feeder.newest() is None)
    device.turn.release(1000)
    feeder.stop(TIME_OUT)


def test_what_it_raises_is_a_fault_until_it_works_again(device, feeder):
    device.answer = OSError('bus off\nno carrier')
    device.turn.release()
    until(lambda: feeder.fault() == 'bus off no carrier')
    feeder.forgive()
    assert feeder.fault() == ''
    device.answer = RuntimeError()
    device.turn.release()
    until(lambda: feeder.fault() == 'RuntimeError')
    device.answer = (3.0, 4.0)
    device.turn.release()
    until(lambda: feeder.fault() == '' and feeder.newest() == (3.0, 4.0))


def test_stopping_lets_the_last_order_out(device, feeder):
    device.turn.release(1000)
    until(lambda: feeder.exchanges > 0)
    feeder.put(7.0, 1.0)
    feeder.put(0.0, 1.0, safe=True)
    feeder.stop(TIME_OUT)
    assert device.orders[-1] == Order(0.0, 1.0, safe=True)
    asked = feeder.exchanges
    feeder.stop(TIME_OUT)
    assert feeder.exchanges == asked


def test_a_device_that_holds_the_thread_is_left_behind_with_a_reason(device):
    feeder = Feeder(device, 0.005)
    feeder.start()
    assert device.asked.acquire(timeout=TIME_OUT)
    with pytest.raises(DriverError, match='has not answered'):
        feeder.stop(0.05)


def test_a_thread_that_was_left_behind_is_not_revived_by_the_next_start(device):
    feeder, before = Feeder(device, 0.005, fresh=TIME_OUT), set(threading.enumerate())
    feeder.start()
    assert device.asked.acquire(timeout=TIME_OUT)
    left, = set(threading.enumerate()) - before
    with pytest.raises(DriverError, match='left behind'):
        feeder.stop(0.05)
    feeder.put(9.0, 0.0)        # too late for the one, not for the other
    feeder.start()
    assert device.asked.acquire(timeout=TIME_OUT)       # the new thread's; both are held
    device.answer = OSError('of the old one, or the new one')
    device.turn.release(2)
    left.join(TIME_OUT)
    assert not left.is_alive()
    device.answer = (5.0, 6.0)
    device.turn.release(1000)
    until(lambda: feeder.newest() == (5.0, 6.0))
    feeder.put(1.0, 0.0)
    until(lambda: device.orders == [Order(1.0, 0.0)])
    feeder.stop(TIME_OUT)


def test_a_start_knows_nothing_of_before(device, feeder):
    device.turn.release()
    until(lambda: feeder.newest() == (1.0, 2.0))
    device.answer = OSError('bus off')
    device.turn.release()
    until(feeder.fault)
    for _ in range(3):      # the third one is not answered
        assert device.asked.acquire(timeout=TIME_OUT)
    with pytest.raises(DriverError):
        feeder.stop(0.02)
    feeder.put(3.0, 0.0)
    feeder.start()
    assert feeder.newest() is None
    assert feeder.fault() == ''
    device.turn.release(1000)
    until(lambda: feeder.exchanges > 3)
    assert device.orders == []


def test_the_longest_exchange_is_measured(device, feeder):
    device.turn.release()
    until(lambda: feeder.exchanges > 0)
    assert feeder.take_slowest() > 0.0
