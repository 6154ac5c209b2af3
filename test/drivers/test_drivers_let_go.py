# SPDX-License-Identifier: Apache-2.0
"""Power at the devices of several axes: given to those of one device, always taken away again."""

import os
import signal
import sys
from types import SimpleNamespace

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.driven import NoParameters
from dz_ros.drivers.beside import Beside, beside_others
from dz_ros.drivers.conformance import driver_checks
from dz_ros.drivers.contract import Driver
from dz_ros.drivers.hosted_axes import HostedDrivers
from dz_ros.errors import DriverError
from dz_ros.identification.experiment.moves import Experiment
from dz_ros.identification.experiment.plan import Limits, Plan
from dz_ros.identification.experiment.session import run_session, StoppedError
from dz_ros.runtime.os_signals import stop_on_signals

AXES = ('x', 'y', 'z')
BOARD, OTHER = object(), object()


class Powered(Driver):
    """An axis with power or without; raises what the test has planned for its calls."""

    name = 'powered'
    summary = 'of this test'
    order = 0
    lockstep = True
    Parameters = NoParameters
    device = BOARD

    def __init__(self, parameters, configuration):
        super().__init__(parameters, configuration)
        self.powered = self.opened = False
        self.wrong = ''
        self.calls = []
        self.plan = {}

    def _call(self, name):
        self.calls.append(name)
        planned = self.plan.get(name)
        found = planned.pop(0) if planned else None
        if isinstance(found, BaseException):
            raise found
        if found is not None:
            found()

    def open(self):
        self.opened = True
        self._call('open')

    def enable(self):
        self.powered = True
        self._call('enable')

    def command(self, v, t):
        self._call('command')

    def safe(self, v, t):
        self._call('safe')

    def disable(self):
        self._call('disable')
        self.powered = False

    def close(self):
        self.opened = False
        self._call('close')

    def measure(self):
        return (0.0, 0.0)

    def fault(self):
        return self.wrong

    def resume(self):
        self._call('resume')
        self.wrong = ''


@pytest.fixture
def machine(monkeypatch):
    """The configuration of three axes whose driver is that of this file."""
    monkeypatch.setitem(sys.modules, 'powered_driver', SimpleNamespace(Here=Powered))
    return Configuration.from_flat({'plant.model': 'servo', 'loop.timing': 'lockstep',
                                    'driver.name': 'powered_driver:Here',
                                    'loop.axes': list(AXES)})


@pytest.fixture
def hosts(machine):
    return HostedDrivers(machine)


@pytest.fixture
def drivers(hosts):
    """The drivers of the axes."""
    return [item.driver for item in hosts.each]


def off(drivers):
    return not any(item.powered or item.opened for item in drivers)


def identified(machine, hosts, stopped=lambda: 'e-stop pressed'):
    """Run an experiment of axis y, the others beside it."""
    c = machine.axis('y')
    experiment = Experiment(Limits(1.5, 1.0, 4.0), Plan(repeats=4), c.plant.order, c.loop.period,
                            c.safety.safe_command)
    return run_session(c, experiment, lambda seq: seq, stopped, Beside(hosts, 1, True))


@pytest.mark.parametrize('error', [KeyboardInterrupt(), OSError('no power'), SystemExit(3)])
@pytest.mark.parametrize('place', range(3))
def test_after_an_enable_that_is_interrupted_no_axis_has_power(hosts, drivers, place, error):
    drivers[place].plan['enable'] = [error]
    hosts.open()
    with pytest.raises(DriverError if isinstance(error, OSError) else type(error)):
        hosts.enable()
    assert not any(item.powered for item in drivers)
    assert all(item.opened for item in drivers)
    assert [item.calls.count('enable') for item in drivers] == [1] * (place + 1) + [0] * (
        2 - place)


def test_an_enable_that_fails_names_what_could_not_be_disabled_again(hosts, drivers):
    drivers[2].plan['enable'] = [DriverError('no power')]
    drivers[2].plan['disable'] = [DriverError('the brake is open')]
    drivers[0].plan['disable'] = [DriverError('the relay is stuck')]
    hosts.open()
    with pytest.raises(DriverError) as caught:
        hosts.enable()
    assert str(caught.value) == (
        'axis z: no power; letting the device go failed: the brake is open; letting the device go '
        'failed: axis x: the relay is stuck')
    assert not drivers[1].powered


@pytest.mark.parametrize('place', range(3))
def test_after_an_open_that_is_interrupted_none_is_open(hosts, drivers, place):
    drivers[place].plan['open'] = [KeyboardInterrupt()]
    with pytest.raises(KeyboardInterrupt):
        hosts.open()
    assert off(drivers)
    assert drivers[place].calls == ['open', 'close']


@pytest.mark.parametrize('name', ['disable', 'safe'])
@pytest.mark.parametrize('place', range(3))
def test_an_interrupt_while_one_axis_is_let_go_keeps_power_from_all(hosts, drivers, place, name):
    hosts.open()
    hosts.enable()
    drivers[place].plan[name] = [KeyboardInterrupt()]
    with pytest.raises(KeyboardInterrupt):
        hosts.let_go((0.0,) * 3, 0.0)
    assert off(drivers)
    assert all('safe' in item.calls for item in drivers)


@pytest.mark.parametrize(('name', 'place'), [('enable', 1), ('disable', 0), ('disable', 2),
                                             ('safe', 0), ('command', 1)])
def test_an_identification_that_is_interrupted_leaves_no_axis_with_power(
        machine, hosts, drivers, name, place):
    drivers[place].plan[name] = [KeyboardInterrupt()]
    samples = iter(('', '', ''))
    with pytest.raises(KeyboardInterrupt):
        identified(machine, hosts, lambda: next(samples, 'SIGINT'))
    assert off(drivers)
    for item in drivers if name != 'enable' else drivers[:place]:
        assert item.calls.index('enable') < item.calls.index('safe') < item.calls.index(
            'disable') < item.calls.index('close')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_further_signals_do_not_interrupt_the_end(machine, hosts, drivers, number):
    def press():
        os.kill(os.getpid(), number)

    drivers[0].plan.update(safe=[press], disable=[press, press], close=[press])
    drivers[2].plan['disable'] = [press]
    with stop_on_signals() as stopping:
        stopping.stop('SIGINT')
        with pytest.raises(StoppedError, match=r'^SIGINT$') as caught:
            identified(machine, hosts, lambda: stopping.reason)
    assert caught.value.failed == ''
    assert off(drivers)
    assert [item.calls.count('disable') for item in drivers] == [1, 1, 1]
    assert drivers[0].plan == {'safe': [], 'disable': [press], 'close': []}


def test_what_goes_wrong_with_the_end_is_reported(machine, hosts, drivers):
    drivers[0].plan['disable'] = [DriverError('the relay is stuck')]
    drivers[2].plan['close'] = [DriverError('still busy')]
    with pytest.raises(StoppedError) as caught:
        identified(machine, hosts)
    assert caught.value.reason == 'e-stop pressed'
    assert caught.value.failed == 'axis x: the relay is stuck; axis z: still busy'
    assert str(caught.value) == ('e-stop pressed; letting the device go failed: '
                                 'axis x: the relay is stuck; axis z: still busy')
    assert [item.calls[-1] for item in drivers] == ['close'] * 3


def test_the_kit_closes_what_it_could_not_disable_and_reports_both(machine, hosts, drivers,
                                                                   monkeypatch):
    monkeypatch.setattr(driver_checks, 'RUN_DURATION', 0.0)
    for place, item in enumerate(drivers):
        item.plan['disable'] = [DriverError(f'relay {place} is stuck')] * 9
    drivers[1].plan['close'] = [DriverError('still busy')] * 9
    found = {item.name: item for item in driver_checks.check_contract(
        machine.axis('y'), 0.1, False, hosted=Beside(hosts, 1))}
    both = ('axis x: relay 0 is stuck; axis y: relay 1 is stuck; axis z: relay 2 is stuck; '
            'axis y: still busy')
    assert (found['restart'].passed, found['restart'].words) == (False, both)
    assert not any(item.opened for item in drivers)
    assert [item.calls.count('open') - item.calls.count('close') for item in drivers] == [0] * 3


def test_only_the_axes_of_one_device_are_held_together(machine, monkeypatch):
    made = []

    def for_axes(each):
        made[:] = [Powered(item.driver_parameters, item) for item in each]
        for item, device in zip(made, (BOARD, OTHER, OTHER), strict=True):
            item.device = device
        return made

    monkeypatch.setattr(Powered, 'for_axes', for_axes)
    held = beside_others(machine, 'y')
    assert held.others == ('z',)
    assert held.note == ('its device is that of z too: enabled with it, at the safe command')
    held.open()
    held.enable()
    assert [item.powered for item in made] == [False, True, True]
    held.command(1.0, 0.0)
    assert held.let_go(0.0, 0.0) == ''
    assert made[0].calls == []
    made[0].device = None
    monkeypatch.setattr(Powered, 'for_axes', lambda _each: made)
    assert beside_others(machine, 'x') is None


@pytest.mark.parametrize(('faults', 'answer'), [
    (('', 'late', ''), ''),
    (('late', 'late', 'late'), ''),                                 # one line
    (('trip', '', ''), 'axis x: trip'),
    (('', 'late', 'trip'), 'axis y: late; axis z: trip'),
])
def test_after_a_stall_a_fault_of_another_axis_waits_for_the_operator(hosts, drivers, faults,
                                                                      answer):
    held = Beside(hosts, 1, True)
    for item, fault in zip(drivers, faults, strict=True):
        item.wrong = fault
    assert held.resume() == answer
    assert [item.calls for item in drivers] == [[] if answer else ['resume']] * 3
