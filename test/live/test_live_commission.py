# SPDX-License-Identifier: Apache-2.0
"""`dz driver commission --live`: the steps are started, confirmed and stopped in the page.

Over 300 lines: one page and its helpers serve the steps with every kind of device.
"""

import json
import socket
import time

import numpy as np
import pytest

from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.identification.commissioning import MOVING, STEPS
from dz_ros.recording.reader import read_run

pytestmark = pytest.mark.live

DZ = ('-m', 'dz_ros')
STALLED = ('sensor', 'identify', 'loop')
"""Steps that a machine without time may spoil: they are repeated, as an operator would."""
TRIES = 4
TIME_OUT = 180.0


def settings(*texts):
    return [word for text in texts for word in ('--set', text)]


def log(folder):
    return [json.loads(line) for line in
            (folder / 'commissioning.jsonl').read_text().splitlines()]


@pytest.fixture
def commission(processes, ros_domain, tmp_path, open_page):
    """Return a function that starts it and opens its page: (page, process, folder)."""
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')

    def start(*words, whole_address=True):
        out = tmp_path / 'first'
        process = processes(*DZ, 'driver', 'commission', *words, '--live', '--out', out)
        address = process.wait_for_line('live page:').split()[-1]
        page = open_page(address if whole_address else address.partition('#')[0])
        page.until("!document.querySelector('#commission').hidden")
        page.process = process
        return page, process, out

    return start


def item(step):
    return f"document.querySelector('#commission-{step}')"


def begin(page, step):
    """Start a step by its button."""
    page.until(f"!{item(step)}.querySelector('button').disabled")
    page.click(f'#commission-{step} button')


def confirm(page):
    page.until("!document.querySelector('#commission-question').hidden")
    page.click('#commission-yes')


def attempts(page, step):
    return page.evaluate(f"""dzRos.app.commissioning.shown.steps.find(
        (item) => item.step === '{step}').attempts""")


def make(page, step, moves):
    """Make a step; return its outcome."""
    before = attempts(page, step)
    begin(page, step)
    if moves:
        confirm(page)
    done = f"""() => dzRos.app.commissioning.shown.running === '' && dzRos.app.commissioning
        .shown.steps.find((item) => item.step === '{step}').attempts === {before + 1}"""
    shown, changed = '', time.monotonic()
    while not page.evaluate(done):      # however long it takes, as long as it goes on
        found = page.inner_text('#state')
        if found != shown:
            shown, changed = found, time.monotonic()
        assert page.process.poll() is None, page.process.output
        assert time.monotonic() - changed < TIME_OUT, (shown, page.process.output)
        page.wait_for_timeout(200.0)
    return page.evaluate(f'{item(step)}.dataset.outcome')


def fill(page, **values):
    for name, value in values.items():
        page.fill(f'#commission-form input[name={name}]', str(value))


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize('serial_device', ['emulated'], indirect=True)
def test_a_serial_device_ends_in_a_loop_that_tracks(commission, serial_device,
                                                    serial_settings, axe):
    page, process, out = begin_with(commission, 'serial', serial_settings)
    assert page.evaluate(f"{item('sign')}.querySelector('button').disabled")
    for value, words in ((2, '--effort = None: must be given'), ('far', "--travel = 'far'")):
        fill(page, travel=value, speed=2, **({} if value == 2 else {'effort': 6}))
        begin(page, 'limits')
        page.until(f"""document.querySelector('#commission-answer').textContent
            .includes("{words}")""")
    fill(page, travel=2)
    ends_in_a_loop_that_tracks(page, process, out, axe)


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize('device', ['cia402', 'joint'])
def test_a_drive_on_a_bus_or_a_joint_ends_in_a_loop_that_tracks(request, commission, device, axe):
    own = request.getfixturevalue(f'{device}_settings')
    page, process, out = begin_with(commission, device, own)
    fill(page, travel=2, speed=2, effort=6)
    ends_in_a_loop_that_tracks(page, process, out, axe)


def made(page, step):
    """Make a step, again where a stall may have spoilt it; return its last outcome."""
    for _ in range(TRIES):
        outcome = make(page, step, step in MOVING)
        if outcome == 'done' or step not in STALLED:
            break
        # A loop that a stall ended has left the device elsewhere than it was identified.
        if 'begin with --from identify' in page.inner_text(f'#commission-{step}'):
            for earlier in STEPS[STEPS.index('identify'):STEPS.index(step)]:
                assert made(page, earlier) == 'done', page.process.output
    return outcome


def begin_with(commission, device, own):
    """Start the commissioning of a device in its page, without limits."""
    return commission(device, *settings(*own), '--repeats', '4', '--ramp', '2',
                      '--pause', '0.2', '--loop-duration', '12')


def ends_in_a_loop_that_tracks(page, process, out, axe):
    """Make every step in the page, one of them twice, and check what came of them."""
    assert make(page, 'limits', False) == 'done'
    for step in STEPS[1:]:
        outcome = made(page, step)
        assert outcome == 'done', (step, page.inner_text(f'#commission-{step}'), process.output)
        if step == 'sensor':        # another viewer, or the same one later, sees the same
            page.reload()
            page.until(f"{item('sensor')}?.dataset.outcome === 'done'")
            # Where states are lost the moves of the identification show it instead.
            words = page.inner_text('#commission-sensor')
            assert 'commands act' in words or 'the identification will' in words
        if step == 'check':         # every step can be repeated
            assert make(page, 'check', False) == 'done'
            assert attempts(page, 'check') == 2
    assert page.inner_text('#commission-loop').count('it tracks')
    assert page.evaluate('dzRos.app.stores[0].count') > 100        # the loop in the same page
    assert str(out / log(out)[-1]['result']['page']) in page.inner_text('#commission-report')
    assert axe(page) == []
    page.click('#commission-end')
    assert process.wait() == 0
    newest = {found['step']: found for found in log(out) if found['outcome'] == 'done'}
    assert list(newest) == list(STEPS)
    assert newest['sign']['result']['left'] < 0.0 < newest['sign']['result']['right']
    assert newest['loop']['result']['error'] <= 0.1 * newest['limits']['result']['amplitude']
    for step in MOVING:
        assert len(read_run(out / newest[step]['folder'] / 'run').channels['state']) > 100


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize('serial_device', ['emulated'], indirect=True)
@pytest.mark.parametrize('how', ['click', 'key'])
def test_an_estop_in_the_page_during_a_pulse_ends_it_safe(commission, serial_device,
                                                          serial_settings, how):
    # So slow a ramp that the device is far from moving by itself when the e-stop comes.
    page, process, out = commission(
        'serial', *settings(*serial_settings), '--ramp', '600', '--travel', '2', '--speed', '2',
        '--effort', '6')
    assert make(page, 'limits', False) == 'done'
    begin(page, 'sign')
    confirm(page)
    page.until("document.querySelector('#commission-moves').textContent.startsWith('sign 1')")
    assert page.inner_text('#state-word') == 'MOVING'
    if how == 'click':
        page.click('#estop')
    else:
        page.focus('#commission-form input[name=travel]')
        page.keyboard.press('Escape')
    page.until(f"{item('sign')}.dataset.outcome === 'failed'")
    assert 'e-stop pressed' in page.inner_text('#commission-sign')
    page.until("document.querySelector('#state-word').innerText === 'E-STOP'")
    assert page.evaluate(f"{item('sign')}.querySelector('button').disabled")
    run = read_run(out / '02-sign' / 'run')
    v = run.channels['command']['v']
    assert np.any(v > 0.0)
    assert v[-1] == 0.0
    assert log(out)[-1]['outcome'] == 'failed'
    # After a reset the step can be made again; a no leaves the device where it is.
    page.click('#reset')
    begin(page, 'sign')
    page.until("!document.querySelector('#commission-question').hidden")
    page.click('#commission-no')
    page.until(f"{item('sign')}.innerText.includes('nothing has moved')")
    # Pressed while it asks: what is answered afterwards moves nothing.
    begin(page, 'sign')
    page.until("!document.querySelector('#commission-question').hidden")
    page.click('#estop')
    page.until("document.querySelector('#commission-question').hidden")
    page.until("dzRos.app.commissioning.shown.running === ''")
    assert [found['outcome'] for found in log(out)] == ['done', 'failed', 'failed', 'failed']
    assert process.interrupt() == 1


@pytest.mark.ros
def test_a_wrong_sign_stops_and_is_stated_in_the_page(commission):
    page, process, out = commission(
        'servo', *settings('plant.x0=[0.0, 0.0]', 'driver.name=mock',
                           'driver.script=["0- reversed"]'),
        '--travel', '1.5', '--speed', '1', '--effort', '4')
    assert make(page, 'limits', False) == 'done'
    assert make(page, 'sign', True) == 'failed'
    assert 'wrong sign: v = ' in page.inner_text('#commission-sign')
    assert page.evaluate(f"{item('sensor')}.querySelector('button').disabled")
    x = read_run(out / '02-sign' / 'run').channels['state']['x0']
    assert 0.0 < np.ptp(x) < 0.1 * 1.5
    page.click('#commission-end')
    assert process.wait() == 1


@pytest.mark.ros
def test_with_yes_the_steps_go_on_by_themselves(processes, ros_domain, tmp_path):
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    out = tmp_path / 'first'
    process = processes(*DZ, 'driver', 'commission', 'servo', '--set', 'plant.x0=[0.0, 0.0]',
                        '--travel', '1.5', '--speed', '1', '--effort', '4', '--yes', '--live',
                        '--until', 'sensor', '--out', out)
    assert process.wait() == 0, process.output
    assert [found['step'] for found in log(out)] == ['limits', 'sign', 'sensor']


@pytest.mark.ros
def test_without_the_token_nothing_can_be_started(commission):
    page, process, out = commission('servo', '--travel', '1', '--speed', '1', '--effort', '4',
                                    whole_address=False)
    page.until("document.querySelector('#state-word').innerText === 'COMMISSIONING'")
    assert page.evaluate(f"{item('limits')}.querySelector('button').disabled")
    answer = page.evaluate("dzRos.app.link.ask('commission', {what: 'step', step: 'limits'})")
    assert 'view only' in answer['message']
    process.interrupt()
    assert not (out / 'commissioning.jsonl').exists()


@pytest.fixture
def ends():
    """The page's end of a commissioning, and the other one."""
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    from dz_ros.nodes.parts.live_commissioning import Commissioning

    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.settimeout(10.0)
    yield Commissioning(theirs.detach()), ours
    ours.close()


def overview(**changed):
    steps = [{'step': step, 'lacking': '' if step == 'limits' else 'limits'} for step in STEPS]
    return json.dumps({'kind': 'commissioning', 'device': 'servo', 'guided': True, 'running': '',
                       'question': '', 'steps': steps, **changed}).encode()


@pytest.mark.parametrize(('shown', 'request_', 'pressed', 'words'), [
    (None, {'what': 'step', 'step': 'limits'}, False, 'not known yet'),
    ({'guided': False}, {'what': 'step', 'step': 'limits'}, False, 'by themselves'),
    ({}, {'what': 'step', 'step': 'limits'}, True, 'reset first'),
    ({}, {'what': 'step', 'step': 'sign'}, False, 'step limits has not been done'),
    ({}, {'what': 'step', 'step': 'other'}, False, 'no such step'),
    ({}, {'what': 'step', 'step': ['limits']}, False, 'no such step'),
    ({}, {'what': 'answer', 'yes': True}, False, 'nothing is asked'),
    ({'question': 'may it?', 'running': 'sign'}, {'what': 'answer', 'yes': True}, True, 'reset'),
    ({'running': 'sign'}, {'what': 'step', 'step': 'limits'}, False, 'is being made'),
    ({'running': 'sign'}, {'what': 'end'}, False, 'is being made'),
    ({}, {'what': {}}, False, 'is expected'),
    ({}, {}, False, 'is expected'),
])
def test_what_cannot_be_done_now_is_refused_and_not_passed_on(ends, shown, request_, pressed,
                                                              words):
    page, other = ends
    if shown is not None:
        other.send(overview(**shown))
        page.news()
    with pytest.raises(LoopError, match=words):
        page.ask(request_, pressed)
    page.estop()
    assert json.loads(other.recv(1000)) == {'do': 'estop'}      # and nothing before it
    assert page.stopped


def test_what_is_asked_is_passed_on_once(ends):
    page, other = ends
    other.send(overview())
    page.news()
    page.ask({'what': 'step', 'step': 'limits', 'values': {'travel': 1.0}}, False)
    assert json.loads(other.recv(1000)) == {'do': 'step', 'step': 'limits',
                                            'values': {'travel': 1.0}}
    with pytest.raises(LoopError, match='step limits is being made'):
        page.ask({'what': 'step', 'step': 'limits'}, False)
    other.close()
    assert page.news()[-1]['gone']
    with pytest.raises(LoopError, match='has ended'):
        page.ask({'what': 'end'}, False)


def test_a_descriptor_that_is_no_socket_is_named(tmp_path):
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    from dz_ros.nodes.parts.live_commissioning import Commissioning

    with (tmp_path / 'file').open('w') as file, pytest.raises(ConfigurationError,
                                                              match='must be the socket'):
        Commissioning(file.fileno())
