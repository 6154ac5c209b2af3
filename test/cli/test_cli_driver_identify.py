# SPDX-License-Identifier: Apache-2.0
"""`dz driver identify`: asks, moves, stops, prints, writes; and reads runs.

Over 300 lines: one device and its moves serve all of it.
"""

import json
import os
import signal
import sys
import threading

import pytest

from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run

LIMITS = ('--travel', '1.5', '--speed', '1', '--effort', '4')
QUIET = ('--set', 'plant.noise=[0.001, 0.01]', '--set', 'plant.x0=[0.0, 0.0]')

DEVICE = '''
import os
import signal
from dz_ros.drivers.simulated import SimulatedActuator
from dz_ros.errors import DriverError

commanded = []


class Device(SimulatedActuator):
    """Keeps the wall's time; SIGNAL at command 100."""

    name = 'device'
    lockstep = False

    def command(self, v, t):
        commanded.append(v)
        super().command(v, t)
        if len(commanded) == 100 and os.environ.get('SIGNAL'):
            os.kill(os.getpid(), int(os.environ['SIGNAL']))

    def safe(self, v, t):
        commanded.append(('safe', v))

    def disable(self):
        commanded.append('disabled')
        if os.environ.get('STUCK'):
            raise DriverError('the relay is stuck')


class AtOnce(Device):
    """As fast as it can."""

    name = 'at_once'
    lockstep = True


class Blinking(AtOnce):
    """Has no measurement in one of eleven samples."""

    name = 'blinking'
    asked = 0

    def measure(self):
        self.asked += 1
        return super().measure() if self.asked % 11 else None
'''


@pytest.fixture
def device(tmp_path, monkeypatch):
    """Yield the module of a driver that keeps time."""
    (tmp_path / 'a_device.py').write_text(DEVICE)
    monkeypatch.syspath_prepend(str(tmp_path))
    import a_device
    a_device.commanded.clear()
    yield a_device
    del sys.modules['a_device']


@pytest.mark.slow
def test_from_device_to_ready_configuration_and_again_from_its_run(tmp_path, capsys):
    out = tmp_path / 'found'
    words = ('servo', *QUIET, '--set', 'loop.duration=5', '--set', 'loop.rate=100', '--repeats',
             '4')
    assert main(['driver', 'identify', *words, *LIMITS, '--yes', '--out', str(out)]) == 0
    reported = capsys.readouterr().out
    assert 'simulated is going to move: 4 times ramps and steps both ways' in reported
    assert {item.name for item in out.iterdir()} == {
        'run', 'bounds.yaml', 'identified.yaml', 'identified.json', 'characteristic.png'}
    numbers = json.loads((out / 'identified.json').read_text())
    for name, value in (('b_r', 0.5), ('b_l', -0.6), ('b·m_r', 1.0), ('b·m_l', 1.0)):
        assert numbers['parameters'][name]['low'] <= value <= numbers['parameters'][name]['high']
    assert (out / 'characteristic.png').read_bytes().startswith(b'\x89PNG')
    # The file passes the check, and bounds.yaml on its own is a configuration too.
    assert main(['check', str(out / 'identified.yaml'), '--quick']) == 0
    assert main(['check', str(out / 'bounds.yaml'), '--quick', '--set',
                 'plant.model=servo']) == 0
    assert main(['bag', 'info', str(out / 'run')]) == 0
    capsys.readouterr()
    again = tmp_path / 'again'
    assert main(['driver', 'identify', '--from', str(out / 'run'), '--out', str(again)]) == 0
    assert not (again / 'run').exists()
    for name, item in json.loads((again / 'identified.json').read_text())['parameters'].items():
        assert item['value'] == pytest.approx(numbers['parameters'][name]['value'], rel=2e-2)
    # Neither is ever overwritten.
    assert main(['driver', 'identify', '--from', str(out / 'run'), '--out', str(again)]) == 2
    assert 'exists already' in capsys.readouterr().err


@pytest.mark.slow
def test_short_holes_are_filled_counted_and_still_holes_in_the_recording(tmp_path, capsys, device):
    out = tmp_path / 'found'
    words = ('servo', *QUIET, '--set', 'loop.rate=100', '--repeats', '4', '--set',
             'driver.name=a_device:Blinking')
    assert main(['driver', 'identify', *words, *LIMITS, '--yes', '--out', str(out)]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if 'not measured' in line)
    filled, of = (int(word) for word in line.split() if word.isdigit() and int(word) > 20)
    assert filled == pytest.approx(of / 11, abs=2)
    state = read_run(out / 'run').channels['state']
    assert len(state) == of - filled
    numbers = json.loads((out / 'identified.json').read_text())['parameters']
    again = tmp_path / 'again'
    assert main(['driver', 'identify', '--from', str(out / 'run'), '--out', str(again),
                 '--allow-import', 'a_device']) == 0
    assert line in capsys.readouterr().out
    for name, item in json.loads((again / 'identified.json').read_text())['parameters'].items():
        assert item['value'] == pytest.approx(numbers[name]['value'], rel=2e-2)


@pytest.mark.slow
def test_a_run_of_the_loop_is_enough_as_well(tmp_path, capsys):
    c = Configuration.from_flat({
        'plant.model': 'servo', 'controller.law': 'wang2004', 'loop.duration': 21.0,
        'loop.rate': 100.0, 'plant.noise': [1e-4, 1e-3], 'plant.x0': [0.1, 0.0],
        'controller.lambda': 5.0,
        'trajectory.kind': 'multisine', 'trajectory.amplitudes': [1.0, 0.5],
        'trajectory.frequencies': [1.0, 2.7], 'trajectory.phases': [0.0, 0.0]})
    save_run(from_run(simulate(c)), tmp_path / 'run')
    out = tmp_path / 'found'
    assert main(['driver', 'identify', '--from', str(tmp_path / 'run'), '--out', str(out)]) == 0
    numbers = json.loads((out / 'identified.json').read_text())['parameters']
    for name, value in (('b_r', 0.5), ('b_l', -0.6), ('b·m_r', 1.0), ('b·m_l', 1.0)):
        assert numbers[name]['low'] <= value <= numbers[name]['high']
        assert numbers[name]['value'] == pytest.approx(value, rel=0.1)


@pytest.mark.parametrize(('words', 'reported'), [
    ((), 'CONFIG'),
    (('servo',), '--travel = None: must be given [rad]'),
    (('servo', '--travel', '1', '--effort', '2'), '--speed = None: must be given [rad/s]'),
    (('servo', *LIMITS[:-1], '-1'), '--effort = -1.0: must be a finite number > 0'),
    (('servo', *LIMITS[:-1], 'nan'), '--effort = nan'),
    (('servo', *LIMITS, '--repeats', '2'), '--repeats = 2: must be an integer >= 4'),
    (('servo', *LIMITS, '--set', 'plant.command_limit=3'), '--effort = 4.0: must be <= 3'),
    (('servo', *LIMITS), '--yes = False: there is no terminal to ask'),
    (('--from', 'nowhere'), 'nowhere'),
])
def test_what_cannot_be_done_is_one_line_and_writes_nothing(tmp_path, monkeypatch, capsys, words,
                                                            reported):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys.stdin, 'isatty', lambda: False, raising=False)
    assert main(['driver', 'identify', *words]) == 2
    error = capsys.readouterr().err
    assert reported in error
    assert error.count('\n') == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('answer', ['no', 'y', ''])
def test_only_yes_is_yes(tmp_path, monkeypatch, capsys, device, answer):
    monkeypatch.setattr(sys.stdin, 'isatty', lambda: True, raising=False)
    monkeypatch.setattr('builtins.input', lambda _: answer)
    out = tmp_path / 'found'
    assert main(['driver', 'identify', 'servo', *QUIET, *LIMITS, '--out', str(out), '--set',
                 'driver.name=a_device:Device']) == 2
    assert 'nothing has moved' in capsys.readouterr().err
    assert device.commanded == []
    assert not out.exists()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_gives_the_safe_command_within_a_sample(tmp_path, monkeypatch, capsys, device,
                                                         number):
    monkeypatch.setattr('dz_ros.cli.driver.stop_requests.find_spec', lambda _: None)     # no ROS
    monkeypatch.setenv('SIGNAL', str(int(number)))
    earlier = signal.getsignal(number)
    out = tmp_path / 'found'
    code = main(['driver', 'identify', 'servo', *QUIET, *LIMITS, '--yes', '--out', str(out),
                 '--set', 'driver.name=a_device:Device'])
    assert (code, capsys.readouterr().err) == {
        signal.SIGINT: (130, 'dz: interrupted: the device has had its safe command and is '
                        'disabled; nothing is kept; the same command begins again\n'),
        signal.SIGTERM: (2, 'dz: error: SIGTERM\n'),
        signal.SIGHUP: (2, 'dz: error: SIGHUP\n')}[number]
    assert len([item for item in device.commanded if isinstance(item, float)]) == 100
    assert device.commanded[100:] == [('safe', 0.0), 'disabled']
    assert signal.getsignal(number) is earlier
    assert not out.exists()


def test_after_ctrl_c_a_device_that_may_have_power_is_reported(tmp_path, monkeypatch,
                                                               capsys, device):
    monkeypatch.setattr('dz_ros.cli.driver.stop_requests.find_spec', lambda _: None)     # no ROS
    monkeypatch.setenv('SIGNAL', str(int(signal.SIGINT)))
    monkeypatch.setenv('STUCK', '1')
    assert main(['driver', 'identify', 'servo', *QUIET, *LIMITS, '--yes', '--out',
                 str(tmp_path / 'found'), '--set', 'driver.name=a_device:Device']) == 130
    assert capsys.readouterr().err == (
        'dz: interrupted: letting the device go failed: the relay is stuck; nothing is kept; the '
        'same command begins again\n')
    assert device.commanded[100:] == [('safe', 0.0), 'disabled']


@pytest.mark.slow
def test_complete_moves_are_kept_where_the_device_cannot_be_let_go(tmp_path, monkeypatch, capsys,
                                                                   device):
    monkeypatch.setenv('STUCK', '1')
    out = tmp_path / 'found'
    assert main(['driver', 'identify', 'servo', *QUIET, *LIMITS, '--yes', '--out', str(out),
                 '--set', 'driver.name=a_device:AtOnce', '--set', 'loop.rate=100',
                 '--repeats', '4']) == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        'dz: error: letting the device go failed: the relay is stuck; the moves are kept in '
        f'{out}/run; dz driver identify --from {out}/run goes on')
    assert main(['driver', 'identify', '--from', str(out / 'run'), '--allow-import', 'a_device',
                 '--out', str(tmp_path / 'again')]) == 0


@pytest.mark.parametrize(('number', 'code', 'printed'), [
    (signal.SIGINT, 130, 'dz: interrupted\n'), (signal.SIGTERM, 2, 'dz: error: SIGTERM\n'),
    (signal.SIGHUP, 2, 'dz: error: SIGHUP\n')])
def test_a_signal_ends_a_check_with_the_safe_command(monkeypatch, capsys, device, number, code,
                                                     printed):
    monkeypatch.setattr('dz_ros.cli.driver.stop_requests.find_spec', lambda _: None)     # no ROS
    monkeypatch.setenv('SIGNAL', str(int(number)))
    assert main(['driver', 'check', '--config', 'servo', '--yes', '--set',
                 'driver.name=a_device:Device']) == code
    assert capsys.readouterr().err == printed
    assert device.commanded[100:] == [('safe', 0.0), 'disabled']


@pytest.mark.slow
@pytest.mark.parametrize(('function', 'kept'), [
    ('identify', 'the moves are kept in {out}/run; dz driver identify --from {out}/run goes on'),
    ('propose', 'the moves are kept in {out}/run; dz driver identify --from {out}/run goes on')])
def test_ctrl_c_after_the_moves_names_them_and_they_can_be_used(tmp_path, monkeypatch, capsys,
                                                                function, kept):
    out = tmp_path / 'found'

    def interrupt(*_):
        os.kill(os.getpid(), signal.SIGINT)

    with monkeypatch.context() as patched:
        patched.setattr(f'dz_ros.cli.driver.identify.{function}', interrupt)
        code = main(['driver', 'identify', 'servo', *QUIET, '--repeats', '4', *LIMITS, '--yes',
                     '--out', str(out)])
    assert code == 130
    assert capsys.readouterr().err.splitlines()[-1] == f'dz: interrupted: {kept.format(out=out)}'
    monkeypatch.chdir(tmp_path)
    assert main(['driver', 'identify', '--from', str(out / 'run'), '--out', 'again']) == 0
    assert (tmp_path / 'again' / 'identified.yaml').exists()


def test_ctrl_c_while_a_run_is_read_names_what_is_there(tmp_path, monkeypatch, capsys):
    c = Configuration.from_flat({'plant.model': 'servo', 'controller.law': 'wang2004',
                                 'loop.duration': 1.0})
    save_run(from_run(simulate(c)), tmp_path / 'run')
    out = tmp_path / 'found'

    def interrupt(*_):
        os.kill(os.getpid(), signal.SIGINT)

    words = ['driver', 'identify', '--from', str(tmp_path / 'run'), '--out', str(out)]
    monkeypatch.setattr('dz_ros.cli.driver.identify.identify_log', interrupt)
    assert main(words) == 130
    assert capsys.readouterr().err.splitlines()[-1] == (
        'dz: interrupted: nothing is kept; the same command begins again')
    assert not out.exists()


@pytest.mark.ros
@pytest.mark.parametrize('words', [
    ('identify', 'servo', *QUIET, *LIMITS, '--out', 'found'), ('check', 'a_device:Device')])
def test_the_e_stop_topic_stops_it(tmp_path, monkeypatch, capsys, device, ros_domain, words):
    pytest.importorskip('rclpy')
    from dz_ros.cli.operator import operator

    def press():
        while len(device.commanded) < 50:
            device_moves.wait(0.02)
        with operator('estop') as process:
            process.wait(60.0)

    device_moves = threading.Event()
    presser = threading.Thread(target=press)
    presser.start()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('dz_ros.drivers.conformance.driver_checks.RUN_DURATION', 120.0)
    code = main(['driver', *words, '--yes', '--set', 'driver.name=a_device:Device'])
    presser.join()
    assert code == 2
    assert 'dz: error: e-stop pressed\n' in capsys.readouterr().err
    assert device.commanded[-2:] == [('safe', 0.0), 'disabled']
    assert os.environ['ROS_DOMAIN_ID'] == str(ros_domain)
