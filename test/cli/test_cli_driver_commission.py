# SPDX-License-Identifier: Apache-2.0
"""`dz driver commission`: limits, sign, sensor, identification, proposal, check; again.

Over 300 lines: the steps of one verb, with the same device and folder of earlier steps.
"""

import json
import os
from pathlib import Path
import re
import shlex
import signal
import sys
import types

import numpy as np
import pytest

from dz_ros.cli.driver.commission_loop import from_where_it_stands
from dz_ros.cli.driver.commission_state import StepFailedError
from dz_ros.cli.main import main
from dz_ros.core.configuration import Configuration
from dz_ros.files.configurations import load_configuration
from dz_ros.identification.commissioning import StepLog
from dz_ros.identification.estimation.sensor import resolution
from dz_ros.recording.reader import read_run

LIMITS = ('--travel', '1.5', '--speed', '1', '--effort', '4')
DEVICE = ('servo', '--set', 'plant.x0=[0.0, 0.0]', '--set', 'plant.noise=[0.0, 0.005]', '--set',
          'plant.resolution=0.0005', '--set', 'loop.delay=1')


def log(folder):
    return [json.loads(line) for line in
            (folder / 'commissioning.jsonl').read_text().splitlines()]


@pytest.mark.slow
def test_the_commands_of_the_page(tmp_path, monkeypatch, capsys):
    """From a device to a checked configuration, and again from a step."""
    out = tmp_path / 'servo-first'
    page = (Path(__file__).parents[2] / 'docs' / 'commissioning.md').read_text(encoding='utf-8')
    first, second = (shlex.split(line)[1:] for line in page.splitlines()
                     if line.startswith('dz driver commission') and '--live' not in line)
    monkeypatch.chdir(tmp_path)
    assert main([*first, *DEVICE[1:], '--repeats', '4', '--until', 'check']) == 0
    printed = capsys.readouterr().out
    assert 'the device follows the command' in printed
    assert re.search(r'one step of the position is 0\.0005 rad; '
                     r'noise at rest \S+ rad, 0\.00\d+ rad/s; ', printed)
    assert '0 errors' in printed
    steps = {item['step']: item for item in log(out)}
    assert [item['step'] for item in log(out)] == [
        'limits', 'sign', 'sensor', 'identify', 'propose', 'check']
    assert {item['outcome'] for item in log(out)} == {'done'}
    assert steps['sign']['result']['left'] < -0.6 < 0.5 < steps['sign']['result']['right']
    assert steps['sensor']['result']['delay'] == steps['identify']['result']['delay'] == 1
    assert steps['sensor']['result']['noise'][1] == pytest.approx(0.005, rel=0.3)
    assert steps['identify']['result']['b_r'] == pytest.approx(0.5, abs=0.05)
    for number, step in ((2, 'sign'), (3, 'sensor'), (4, 'identify')):
        assert len(read_run(out / f'{number:02d}-{step}' / 'run').channels['state']) > 100
    c = load_configuration(out / '05-propose' / 'proposed.yaml')
    assert c.safety.command_limit == 4.0
    assert c.trajectory.name == 'point_to_point'
    assert c.driver_settings.resolution == 0.0      # the simulated one knows its own
    # What was given is kept; a step again is another attempt beside the first.
    before = (out / '05-propose' / 'proposed.yaml').read_text()
    assert main(second) == 0
    assert (out / '05-propose' / 'proposed.yaml').read_text() == before
    again = load_configuration(out / '08-propose' / 'proposed.yaml')
    distance = again.trajectory.parameters.goal - again.trajectory.parameters.start
    assert distance == pytest.approx(0.3)
    assert [item['step'] for item in log(out)][6:] == ['limits', 'propose', 'check']
    assert main(['driver', 'commission', *DEVICE, *LIMITS, '--yes', '--out', str(out)]) == 2
    assert 'exists already' in capsys.readouterr().err


def test_the_wrong_sign_stops_at_once_and_is_named(tmp_path, capsys):
    out = tmp_path / 'first'
    code = main(['driver', 'commission', *DEVICE, '--set', 'driver.name=mock', '--set',
                 'driver.script=["0- reversed"]', *LIMITS, '--yes', '--out', str(out)])
    assert code == 1
    printed = capsys.readouterr()
    assert 'wrong sign: v = ' in printed.err
    assert f'stopped at step sign; once it is mended: --from sign --out {out}' in printed.out
    assert [(item['step'], item['outcome']) for item in log(out)] == [('limits', 'done'),
                                                                      ('sign', 'failed')]
    assert 'moves the device left' in log(out)[1]['words']
    # What it did is recorded: it moved little, and had the safe command after that.
    moves = read_run(out / '02-sign' / 'run')
    x = moves.channels['state']['x0']
    assert 0.0 < np.ptp(x) < 0.1 * 1.5
    # Mended, from this step on.
    assert main(['driver', 'commission', '--from', 'sign', '--until', 'sign', '--set',
                 'driver.script=[]', '--yes', '--out', str(out)]) == 0
    assert log(out)[-1]['outcome'] == 'done'


def test_a_device_that_does_not_move_is_named(tmp_path, capsys):
    out = tmp_path / 'first'
    assert main(['driver', 'commission', *DEVICE, *LIMITS[:-1], '1', '--yes', '--out',
                 str(out)]) == 1
    assert 'no motion right up to |v| = 1: allow more effort' in capsys.readouterr().err


def test_limits_are_asked_where_they_are_not_given(tmp_path, monkeypatch):
    asked, answers = [], iter(['1.5', '4', '1', 'yes', 'no'])

    def answer(question):
        asked.append(question)
        return next(answers)

    monkeypatch.setattr(sys.stdin, 'isatty', lambda: True, raising=False)
    monkeypatch.setattr('builtins.input', answer)
    out = tmp_path / 'first'
    assert main(['driver', 'commission', *DEVICE, '--out', str(out)]) == 2
    assert asked[:3] == ['How far may it move from where it stands [rad]? ',
                         'How large may |v| be [A]? ', 'How fast may it move [rad/s]? ']
    assert log(out)[0]['result']['travel'] == 1.5
    assert [item['outcome'] for item in log(out)] == ['done', 'done', 'failed']
    assert log(out)[2]['words'] == 'nothing has moved'


def test_a_configuration_given_later_is_kept_for_later_steps(tmp_path):
    out = tmp_path / 'first'
    turned = ['--set', 'driver.name=mock', '--set', 'driver.script=["0- reversed"]']
    again = ['driver', 'commission', '--until', 'sign', '--yes', '--out', str(out), '--from']
    assert main(['driver', 'commission', *DEVICE, *turned, *LIMITS, *again[2:-1]]) == 1
    assert main([*again, 'sign', '--set', 'driver.script=[]']) == 0
    assert main([*again, 'sign']) == 0      # by what was given last
    assert [item['outcome'] for item in log(out)] == ['done', 'failed', 'done', 'done']
    assert load_configuration(out / 'configuration.yaml').driver_settings.name == 'mock'
    assert 'reversed' in (out / 'configuration.yaml').read_text()
    assert 'reversed' not in (out / '03-configuration.yaml').read_text()
    assert not (out / '04-configuration.yaml').exists()


@pytest.mark.parametrize(('words', 'text'), [
    ((), "CONFIG = '': must name the configuration"),
    (('servo',), '--travel = None: must be given [rad]'),
    (('servo', *LIMITS, '--amplitude', '2'), '--amplitude = 2.0: must be > 0 and at most the tra'),
    (('servo', *LIMITS, '--loop-duration', '1'), '--loop-duration = 1.0: must be >= 5'),
    (('servo', *LIMITS, '--live', '--until', 'sign'), "--until = 'sign': is not for --live"),
    (('servo', *LIMITS, '--from', 'sign'), 'must be the folder of earlier steps'),
    (('servo', *LIMITS, '--set', 'plant.command_limit=3'), '--effort = 4.0: must be <= 3'),
    (('servo', *LIMITS, '--set', 'safety.nothing=3'), 'safety.nothing'),
])
def test_what_cannot_be_done_is_one_line_and_writes_nothing(tmp_path, monkeypatch, capsys, words,
                                                            text):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys.stdin, 'isatty', lambda: False, raising=False)
    assert main(['driver', 'commission', *words, '--out', 'first']) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count('\n') == 1
    assert not list(tmp_path.iterdir())


def test_without_a_terminal_nothing_moves_unless_allowed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys.stdin, 'isatty', lambda: False, raising=False)
    out = tmp_path / 'first'
    assert main(['driver', 'commission', *DEVICE, *LIMITS, '--out', str(out)]) == 2
    assert '--yes = False: there is no terminal to ask' in capsys.readouterr().err
    assert [item['step'] for item in log(out)] == ['limits', 'sign']


@pytest.mark.parametrize('line', [
    'nothing', '[]', '{}', '{"step": "sign"}', '[' * 100_000,
    '{"step": "sign", "begun": "", "outcome": "", "words": "", "folder": "../x", "result": {}}',
    '{"step": "up", "begun": "", "outcome": "done", "words": "", "folder": "", "result": {}}'])
def test_a_log_that_is_none_is_named(tmp_path, capsys, line):
    out = tmp_path / 'first'
    out.mkdir()
    (out / 'commissioning.jsonl').write_text(line + '\n')
    assert main(['driver', 'commission', *DEVICE, *LIMITS, '--from', 'sensor', '--yes', '--out',
                 str(out)]) == 2
    assert 'line 1 is no attempt of a step' in capsys.readouterr().err


@pytest.mark.parametrize('step', ['sensor', 'propose', 'check', 'loop', 'report'])
def test_a_step_whose_earlier_ones_are_missing_names_them(tmp_path, capsys, step):
    out = tmp_path / 'first'
    out.mkdir()
    assert main(['driver', 'commission', *DEVICE, *LIMITS, '--from', step, '--yes', '--out',
                 str(out)]) in (1, 2)
    assert 'begin with --from ' in capsys.readouterr().err


def test_a_motion_that_takes_more_than_the_effort_is_named_before_it_is_tried():
    from dz_ros.cli.driver.commission_loop import lacks
    from dz_ros.studies.tune import Proposal

    c = Configuration.from_flat({})
    good = {'lost': 0, 'reason': '', 'error_max': 0.04, 'v_peak_run': 3.0}
    weak, lost = {**good, 'error_max': 0.06}, {**good, 'lost': 1, 'reason': 'diverged'}
    for rows, text in (({'before, delay 0': lost, 'after, delay 0': good}, ''),
                       ({'after, delay 0': good, 'after, delay 1': weak}, 'allow more --effort'),
                       ({'after, delay 0': lost}, 'lost in simulation: diverged')):
        found = lacks(Proposal(c, c, {}, rows), 0.5)
        assert text in found
        assert bool(text) == bool(found)


@pytest.mark.parametrize(('left', 'words'), [
    (None, []), (0.5, ['--set', 'trajectory.start=0.5', '--set', 'trajectory.goal=0.25']),
    (-0.5, ['--set', 'trajectory.start=-0.5', '--set', 'trajectory.goal=-0.25']), (1.5, None)])
def test_a_loop_tried_again_begins_where_the_one_before_left_the_device(tmp_path, left, words):
    attempts = [{'step': 'identify', 'outcome': 'done', 'result': {'position': 0.0}}]
    if left is not None:
        attempts.append({'step': 'loop', 'outcome': 'failed', 'result': {'position': left}})
    (tmp_path / 'commissioning.jsonl').write_text(''.join(json.dumps(
        {'number': number, 'begun': '2026-01-01T00:00:00+00:00', 'words': 'x', 'folder': '',
         **item}) + '\n' for number, item in enumerate(attempts, 1)), encoding='utf-8')
    state = types.SimpleNamespace(log=StepLog(tmp_path), limits=types.SimpleNamespace(travel=2.0),
                                  answered=types.SimpleNamespace(amplitude=0.25))
    c = load_configuration('serial')
    if words is None:
        with pytest.raises(StepFailedError, match='bring it back and begin with --from identify'):
            from_where_it_stands(state, c)
    else:
        assert from_where_it_stands(state, c) == words


def test_one_step_of_a_position():
    generator = np.random.default_rng(1)
    slow = 0.3 * np.sin(np.arange(2000) * 0.01)
    for step in (1e-4, 2.0 * np.pi / 4096):
        assert resolution(np.floor(slow / step) * step) == pytest.approx(step)
    assert resolution(slow) == 0.0
    assert resolution(slow + generator.normal(0.0, 1e-4, 2000)) == 0.0
    assert resolution(np.zeros(100)) == 0.0
    assert resolution(np.full(100, np.nan)) == 0.0


def test_a_velocity_of_the_other_sign_is_named():
    from dz_ros.identification.experiment.plan import Limits, Plan
    from dz_ros.identification.experiment.pulses import SignTest, WrongSignError

    c = Configuration.from_flat({'plant.model': 'servo', 'plant.x0': [0.0, 0.0]})
    device = c.make_driver()
    test = SignTest(Limits(1.5, 1.0, 4.0), Plan(), 2, c.loop.period)

    def moved():
        for k in range(10_000):
            device.advance(k * c.loop.period, k)
            x, speed = device.measure()
            device.command(test.command((x, -speed)), k * c.loop.period)

    with pytest.raises(WrongSignError, match='wrong sign'):
        moved()


INTERRUPTED = """
import os
import re
import signal
from dz_ros.drivers.simulated import SimulatedActuator

received = []


class Device(SimulatedActuator):
    '''Interrupted at the command of that number.'''

    name = 'device'
    instant = 0

    def command(self, v, t):
        received.append(v)
        super().command(v, t)
        if len(received) == Device.instant:
            os.kill(os.getpid(), signal.SIGINT)

    def safe(self, v, t):
        received.append('safe')
        super().safe(v, t)

    def disable(self):
        received.append('disabled')
        super().disable()
"""


def test_ctrl_c_during_a_move_leaves_the_device_safe_and_names_how_to_go_on(tmp_path, monkeypatch,
                                                                            capsys):
    (tmp_path / 'interrupted_device.py').write_text(INTERRUPTED)
    monkeypatch.syspath_prepend(str(tmp_path))
    import interrupted_device
    out = tmp_path / 'first'
    words = ['driver', 'commission', *DEVICE, *LIMITS, '--yes', '--out', str(out), '--set',
             'driver.name=interrupted_device:Device']
    for step, extra in (('sign', []), ('sensor', ['--from', 'sensor'])):
        if extra:
            interrupted_device.Device.instant = 0
            assert main([*words, '--from', 'sign', '--until', 'sign']) == 0
        interrupted_device.received.clear()
        interrupted_device.Device.instant = 300
        capsys.readouterr()
        assert main([*words, *extra]) == 130
        assert capsys.readouterr().err.splitlines()[-1] == (
            'dz: interrupted: the device has had its safe command and is disabled; the steps '
            f'before {step} are kept; dz driver commission --from {step} --out {out} goes on')
        *numbers, end = interrupted_device.received
        assert end == 'disabled'
        assert all(isinstance(item, float) for item in numbers[:300])
        assert set(numbers[300:]) <= {'safe', 0.0}      # nothing else after the signal
        assert (log(out)[-1]['outcome'], log(out)[-1]['words']) == ('failed', 'interrupted')
        moves = read_run(out / log(out)[-1]['folder'] / 'run')
        assert len(moves.channels['state']) >= 300      # what it did is recorded
    del sys.modules['interrupted_device']


@pytest.mark.slow
@pytest.mark.parametrize(('step', 'function'), [('identify', 'commission_moves.identify'),
                                                ('propose', 'commission_loop.propose')])
def test_ctrl_c_while_it_computes_names_how_to_go_on(tmp_path, monkeypatch, capsys, step,
                                                     function):
    out = tmp_path / 'first'

    def interrupt(*_):
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(f'dz_ros.cli.driver.{function}', interrupt)
    assert main(['driver', 'commission', *DEVICE, *LIMITS, '--repeats', '4', '--yes', '--out',
                 str(out)]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == (
        f'dz: interrupted: the steps before {step} are kept; dz driver commission --from {step} '
        f'--out {out} goes on')
    assert (log(out)[-1]['step'], log(out)[-1]['words']) == (step, 'interrupted')
    assert log(out)[-2]['outcome'] == 'done'
