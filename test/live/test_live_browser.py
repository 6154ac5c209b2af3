"""The page in a real browser: Debian's chromium, without a window, driven by Playwright."""

from importlib.resources import files
import json
import os
from pathlib import Path
import re
import shutil
import signal
import time

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop import simulate
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run

pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')
playwright = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')

CHROMIUM = next((found for name in ('chromium', 'chromium-browser', 'google-chrome')
                 if (found := shutil.which(name))), '')
ROOT = Path(__file__).parents[2]
DZ = ('-m', 'dz_ros')
TIME_OUT = 60e3
"""Longest wait for anything in the page [ms]."""

pytestmark = [pytest.mark.live, pytest.mark.skipif(
    not CHROMIUM, reason='no chromium here: apt-get install chromium')]


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    # It draws without a graphics card, and must not take the time from the loop it shows.
    behind = tmp_path_factory.mktemp('browser') / 'chromium'
    behind.write_text(f'#!/bin/sh\nexec nice -n 10 {CHROMIUM} "$@"\n', encoding='utf-8')
    behind.chmod(0o755)
    with playwright.sync_playwright() as driver:
        arguments = ['--no-sandbox'] if os.geteuid() == 0 else []
        found = driver.chromium.launch(executable_path=behind, args=arguments)
        yield found
        found.close()


@pytest.fixture
def open_page(browser):
    """Return ``open(url, **context) -> page``; a page that complains fails the test."""
    contexts, complaints = [], []

    def open_one(url, **settings):
        settings.setdefault('viewport', {'width': 1400, 'height': 900})
        context = browser.new_context(**settings)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(TIME_OUT)
        page.requests = []
        page.on('request', lambda request: page.requests.append(request.url))
        page.on('pageerror', lambda error: complaints.append(str(error)))
        page.on('console', lambda message: complaints.append(message.text)
                if message.type == 'error' and 'WebSocket' not in message.text else None)
        page.goto(url)
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert complaints == []


@pytest.fixture
def loop(processes, ros_domain, tmp_path):
    """Return (address of the page, process, directory of the recording) of a loop that runs."""
    if not pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run'):
        return None
    run = tmp_path / 'run'
    process = processes(*DZ, 'run', 'servo', '--duration', '600', '--quiet', '--live', '--record',
                        run, '--set', 'safety.fault_after=4000')
    address = process.wait_for_line('live page:').split()[-1]
    return address, process, run


def until(page, expression):
    """Wait until an expression is true in the page.

    Playwright's own waiting would need `eval`, which the page's policy forbids.
    """
    deadline = time.monotonic() + TIME_OUT * 1e-3
    script = expression if expression.startswith('()') else f'() => ({expression})'
    while not page.evaluate(script):
        assert time.monotonic() < deadline, (expression, page.inner_text('#state'))
        page.wait_for_timeout(20)


def wait_live(page):
    until(page, "['live', 'fault'].includes(document.body.dataset.state)")
    until(page, 'dzRos.app.stores[0]?.count > 100')


def children(pid):
    """Return the processes a process has started."""
    return [int(child) for task in Path(f'/proc/{pid}/task').iterdir()
            for child in (task / 'children').read_text().split()]


def command(pid):
    return Path(f'/proc/{pid}/cmdline').read_text()


def value(page, text):
    return page.evaluate(text)


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return the directories of two simulated runs, and the first one's data."""
    folder = tmp_path_factory.mktemp('recorded')
    for name, law in (('first', 'robust'), ('second', 'wang2004')):
        c = Configuration.from_flat({'loop.duration': 20.0, 'controller.law': law})
        save_run(from_run(simulate(c), 10 ** 18), folder / name)
    return folder / 'first', folder / 'second', read_run(folder / 'first')


@pytest.fixture
def served(processes, recorded):
    """Return the address of a page that shows one recorded run."""
    process = processes(*DZ, 'report', '--serve', recorded[0])
    return process.wait_for_line('http').split()[2]


@pytest.mark.ros
def test_the_page_asks_nobody_else_and_its_curves_move(open_page, loop):
    address, _, _ = loop
    page = open_page(address)
    wait_live(page)
    host = re.match(r'http://[^/]+/', address)[0]
    assert len(page.requests) > 15
    assert all(url.startswith((host, host.replace('http', 'ws'))) for url in page.requests)
    assert '#' not in page.url          # the token is out of sight
    canvas = page.locator('#figure-tracking canvas').first
    before, seen = canvas.screenshot(), value(page, 'dzRos.app.stores[0].last')
    until(page, f'dzRos.app.stores[0].last > {seen} + 1.0')
    assert canvas.screenshot() != before
    until(page, "document.querySelector('#tile-time dd').innerText.endsWith('s')")
    page.click('#pause')
    until(page, "document.body.dataset.state === 'paused'")
    held = value(page, 'dzRos.view.end')
    until(page, f'dzRos.app.stores[0].last > {held} + 0.5')
    assert value(page, 'dzRos.view.end') == held
    page.click('#plots', position={'x': 5, 'y': 2})
    page.keyboard.press(' ')
    until(page, "['live', 'fault'].includes(document.body.dataset.state)")


PRESSES, QUICK = 6, 3
"""Of so many presses so many must have the actuator safe within three samples, and each within 30:
on a machine that is busy with other tests a press may find nobody running."""


@pytest.mark.ros
@pytest.mark.parametrize('how', ['click', 'key'])
def test_an_estop_in_the_page_has_the_actuator_safe_within_three_samples(open_page, loop, how):
    address, process, run = loop
    page = open_page(address)
    wait_live(page)
    page.evaluate("""() => { for (const kind of ['pointerdown', 'keydown']) {
        window.addEventListener(kind, () => {
            window.pressed ??= (performance.timeOrigin + performance.now()) / 1e3;
        }, true); } }""")
    presses = []
    for _ in range(PRESSES):
        page.evaluate('() => { window.pressed = undefined; }')
        if how == 'click':
            page.click('#estop')
        else:       # from wherever the focus is, a field included
            page.focus('#kick-size')
            page.keyboard.press('Escape')
        until(page, "document.querySelector('#state-word').innerText === 'E-STOP'")
        until(page, "document.querySelector('#answer').innerText.startsWith('e-stop')")
        presses.append(value(page, 'window.pressed'))
        seen = value(page, 'dzRos.app.stores[0].last')
        until(page, f'dzRos.app.stores[0].last > {seen} + 0.3')
        page.click('#reset')
        until(page, "document.querySelector('#answer').innerText === 'reset'")
        until(page, "document.body.dataset.state === 'live'")
        seen = value(page, 'dzRos.app.stores[0].last')
        until(page, f'dzRos.app.stores[0].last > {seen} + 0.3')
    process.interrupt()
    data = read_run(run)
    actions = [event for event in map(json.loads, (item[2] for item in data.events))
               if event['event'] == 'action' and event['action'] == 'estop']
    assert [(item['done'], item['by']) for item in actions] == [(True, '127.0.0.1')] * PRESSES
    state, truth = data.channels['state'], data.channels['truth']
    took = []
    for pressed in presses:
        first = np.flatnonzero(state.publish_time * 1e-9 > pressed)[0]
        at_press = int(state['seq'][first]) - 1
        # truth says of each sample what the actuator got at its end; safe means 0, and stays 0
        after = (truth['seq'] >= at_press) & (truth['seq'] < at_press + 40)
        moving = truth['seq'][after & (truth['w'] != 0.0)]
        took.append(int(moving.max(initial=at_press) - at_press))
    assert sum(samples < 3 for samples in took) >= QUICK, took
    assert max(took) < 30, took


@pytest.mark.ros
def test_a_refused_gain_says_why_and_an_accepted_one_is_recorded(open_page, loop):
    address, process, run = loop
    page = open_page(address)
    wait_live(page)
    page.click('#section-controller summary')
    field = page.locator('input[name="controller.k_d"]')
    field.fill('-3')
    page.click('#section-controller button[type=submit]')
    answer = page.locator('#section-controller .answer')
    playwright.expect(answer).to_contain_text('controller.k_d = -3: must be a finite number > 0')
    assert answer.get_attribute('data-ok') == 'no'
    field.fill('eleven')
    page.click('#section-controller button[type=submit]')
    playwright.expect(answer).to_contain_text("'eleven': must be a finite number")
    page.fill('input[name="plant.dead_zone.b_r"]', '0.31')
    page.click('#section-plant button[type=submit]')
    playwright.expect(page.locator('#section-plant .answer')).to_contain_text('has taken')
    until(page, """() => { const {data, count} = dzRos.app.stores[0];
        return Math.abs(data.zone_high[count - 1] - 0.31) < 1e-6; }""")
    page.fill('#kick-size', '15')
    page.click('#kick button')
    playwright.expect(page.locator('#kick-answer')).to_contain_text('has taken plant.kick')
    kicked = value(page, 'dzRos.app.stores[0].last')
    until(page, f'dzRos.app.stores[0].last > {kicked} + 1.0')
    process.interrupt()
    data = read_run(run)
    actions = [json.loads(text) for _, node, text in data.events if node == '/live_node']
    assert [(item['action'], item['done']) for item in actions] == [
        ('set', False), ('set', False), ('set', True), ('kick', True)]
    assert actions[2]['values'] == {'plant.dead_zone.b_r': 0.31}
    stated = [json.loads(text) for _, _, text in data.events
              if '"owns": ["loop", "plant"' in text]
    assert stated[-1]['configuration']['plant.kick'][1] == 15.0
    truth = data.channels['truth']
    assert 0 < (truth['disturbance'] < -14.0).sum() <= 10       # 50 ms at 200 Hz


@pytest.mark.ros
def test_loss_of_the_loop_is_shown_within_a_second(open_page, processes, ros_domain):
    pytest.importorskip('rclpy', reason='rclpy is not installed: nodes cannot run')
    loop = processes(*DZ, 'run', 'servo', '--duration', '600', '--quiet')
    page_process = processes('-m', 'dz_ros.nodes.main', 'live_node')
    page = open_page(page_process.wait_for_line('live page:').split()[-1])
    wait_live(page)
    page.evaluate("""() => { new MutationObserver(() => {
        if (document.body.dataset.state === 'gone') window.goneAt ??= Date.now() / 1e3;
        }).observe(document.body, {attributes: true}); }""")
    plant = next(pid for pid in children(loop.pid) if 'plant_node' in command(pid))
    os.kill(plant, signal.SIGSTOP)
    stopped = time.time()
    try:
        until(page, "document.body.dataset.state === 'gone'")
        shown = value(page, 'window.goneAt')
        assert shown - stopped < 1.0
        assert page.inner_text('#state-word') == 'LOOP GONE'
        for tile in ('error', 'layer', 'command', 'time'):      # no old number looks live
            playwright.expect(page.locator(f'#tile-{tile} dd')).to_have_text('–')
    finally:
        os.kill(plant, signal.SIGCONT)
    until(page, "['live', 'fault', 'waiting'].includes(document.body.dataset.state)")
    page_process.end()
    until(page, "document.body.dataset.state === 'off'")
    assert page.inner_text('#state-word') == 'NOT CONNECTED'


@pytest.mark.ros
def test_the_loop_does_not_notice_that_its_page_is_killed(loop):
    _, process, _ = loop
    process.wait_for_line('live page:')
    page = next(pid for pid in children(process.pid) if 'live_node' in command(pid))
    os.kill(page, signal.SIGKILL)
    process.wait_for_line('the live page has ended')
    assert process.poll() is None
    assert any('plant_node' in command(pid) for pid in children(process.pid))
    assert process.interrupt() == 130


@pytest.mark.ros
def test_two_viewers_agree_and_one_without_the_token_only_looks(open_page, loop):
    address, _, _ = loop
    one, other = open_page(address), open_page(address.partition('#')[0])
    for page in (one, other):
        wait_live(page)
    last = min(value(page, 'dzRos.app.stores[0].data.seq[dzRos.app.stores[0].count - 1]')
               for page in (one, other))
    rows = [value(page, f"""(() => {{ const store = dzRos.app.stores[0];
        const at = store.data.seq.lastIndexOf({last}, store.count);
        return store.names.map((name) => [...store.data[name].slice(at - 99, at + 1)]); }})()""")
            for page in (one, other)]
    assert len(rows[0][0]) == 100
    np.testing.assert_equal(rows[0], rows[1])
    assert other.is_disabled('#activate')
    other.keyboard.press('Escape')
    playwright.expect(other.locator('#alarm')).to_contain_text('E-STOP NOT SENT: view only')
    assert 'E-STOP' not in one.inner_text('#state')
    one.click('#deactivate')
    playwright.expect(one.locator('#answer')).to_contain_text('deactivated')
    until(other, "!['live', 'paused'].includes(document.body.dataset.state)")
    one.click('#activate')
    playwright.expect(one.locator('#answer')).to_contain_text('activated')
    until(other, "['live', 'fault'].includes(document.body.dataset.state)")


def test_a_recorded_run_scrubs(open_page, served, recorded):
    page = open_page(served)
    until(page, 'dzRos.app.stores[0]?.count === 4001')
    data = recorded[2]
    assert page.inner_text('#state-word') == 'RECORDED'
    assert not page.is_visible('#estop')
    page.select_option('#span', '5')
    slider = page.locator('#scrub-at')
    slider.fill('0.5')
    until(page, 'Math.abs(dzRos.view.end - 10) < 0.01')
    page.click('#forth')
    until(page, 'Math.abs(dzRos.view.end - 12.5) < 0.01')
    box = page.locator('#figure-error .u-over').bounding_box()
    page.mouse.move(box['x'] + 0.5 * box['width'], box['y'] + 0.5 * box['height'])
    until(page, 'dzRos.view.cursor !== null')
    at = value(page, 'dzRos.view.cursor')
    row = int(np.argmin(np.abs(data.channels['state']['stamp'] - at)))
    error = data.channels['state']['x0'][row] - data.channels['reference']['xd0'][row]
    until(page, f"document.querySelector('#cursor-time').innerText === '{at:.3f} s'")
    shown = page.inner_text('#tile-error dd').replace('−', '-')
    assert float(shown) == pytest.approx(error, rel=1e-2, abs=1e-4)
    page.click('#play')
    end = value(page, 'dzRos.view.end')
    until(page, f'dzRos.view.end > {end} + 0.3')


def test_what_is_seen_is_exported(open_page, served, recorded, tmp_path):
    page = open_page(served)
    until(page, 'dzRos.app.stores[0]?.count === 4001')
    page.evaluate('dzRos.view.look(3, 4)')
    with page.expect_download() as caught:
        page.click('#csv')
    caught.value.save_as(tmp_path / 'seen.csv')
    table = np.genfromtxt(tmp_path / 'seen.csv', delimiter=',', names=True, deletechars='')
    state = recorded[2].channels['state']
    inside = (state['stamp'] >= 3.0) & (state['stamp'] < 4.0)
    assert table['x0'] == pytest.approx(state['x0'][inside], rel=1e-6)
    assert table['stamp_[s]'] == pytest.approx(state['stamp'][inside])
    with page.expect_download() as caught:
        page.click('#png')
    caught.value.save_as(tmp_path / 'seen.png')
    assert (tmp_path / 'seen.png').read_bytes()[:8] == b'\x89PNG\r\n\x1a\n'
    assert (tmp_path / 'seen.png').stat().st_size > 20000


def test_two_runs_lie_over_each_other(open_page, processes, recorded):
    process = processes(*DZ, 'report', '--serve', recorded[0], '--over', recorded[1])
    page = open_page(process.wait_for_line('http').split()[2])
    until(page, 'dzRos.app.stores.length === 2 && dzRos.app.stores[1]?.count === 4001')
    legend = page.inner_text('#figure-error .legend')
    assert 'x̃' in legend
    assert 'x̃ (second)' in legend
    until(page, """() => dzRos.app.plots.shown[1].chart.data.length === 3
        && dzRos.app.plots.shown[1].chart.data[2].some((value) => value != null)""")
    lines = value(page, 'dzRos.app.plots.shown[1].chart.data.slice(1).map((line) => '
                        'Math.max(...line.filter((value) => value != null).map(Math.abs)))')
    assert lines == pytest.approx([2.5, 2.5], rel=1e-3)


@pytest.mark.parametrize('width', [320, 390, 768, 3840])
def test_no_width_scrolls_sideways(open_page, served, width):
    page = open_page(served, viewport={'width': width, 'height': 800})
    until(page, 'dzRos.app.stores[0]?.count === 4001')
    assert value(page, 'document.documentElement.scrollWidth') <= width
    assert value(page, 'document.querySelector("#figure-error canvas").clientWidth') > 0.3 * min(
        width, 600)


def axe(page):
    """Return the serious findings of axe-core."""
    source = pytest.importorskip('axe_playwright_python', reason='axe-core is not installed')
    page.evaluate(files(source).joinpath('axe.min.js').read_text(encoding='utf-8'))
    found = page.evaluate('axe.run()')
    assert len(found['passes']) > 15
    return [(item['id'], [node['html'][:90] for node in item['nodes']])
            for item in found['violations'] if item['impact'] in ('serious', 'critical')]


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_no_serious_finding_on_accessibility_of_a_recorded_run(open_page, served, scheme):
    page = open_page(served, color_scheme=scheme)
    until(page, 'dzRos.app.stores[0]?.count === 4001')
    assert axe(page) == []


@pytest.mark.ros
@pytest.mark.parametrize(('scheme', 'width'), [('light', 1400), ('dark', 390)])
def test_no_serious_finding_on_accessibility_of_a_running_loop(open_page, loop, scheme, width):
    page = open_page(loop[0], color_scheme=scheme, viewport={'width': width, 'height': 900})
    wait_live(page)
    for section in ('controller', 'trajectory'):
        page.click(f'#section-{section} summary')
    assert axe(page) == []
