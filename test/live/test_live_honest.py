# SPDX-License-Identifier: Apache-2.0
"""What the page shows when its server hangs, is slow or has nothing: a real browser, no loop."""

import asyncio
import threading

import numpy as np
import pytest

from dz_ros.errors import LoopError
from dz_ros.live import viewer as viewer_module
from dz_ros.live.access import Access
from dz_ros.live.clock import clock
from dz_ros.live.history import History
from dz_ros.live.source import Source

pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')
pytest.importorskip('playwright', reason='playwright is not installed')
pytestmark = pytest.mark.live

WORD = "document.querySelector('#state-word').innerText"
BUTTONS = "[...document.querySelectorAll('.panels button')]"


class Loopless:
    """A server in a thread of its own, that a browser can look at and a test can freeze.

    Attributes:
        address: To open.
        source: What it shows.
    """

    def __init__(self, source):
        from dz_ros.live.server import Server

        self.source = source
        self._loop = asyncio.new_event_loop()
        self._go, self._frozen, self._ended = (threading.Event() for _ in range(3))
        self._go.set()
        self._server = Server(source, Access())
        self.address = ''
        ready = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(ready,), daemon=True)
        self._thread.start()
        assert ready.wait(20.0)

    def _run(self, ready):
        self._loop.run_until_complete(self._serve(ready))

    async def _serve(self, ready):
        self.address = await self._server.start()
        ready.set()
        while not self._ended.is_set():
            self._frozen.set()
            self._go.wait()
            self.source.add(20)
            self._server.publish()
            for message in self.source.now():
                self._server.broadcast(message)
            await asyncio.sleep(0.1)
        await self._server.close()

    def freeze(self):
        """Stop answering; connections stay."""
        self._go.clear()
        self._frozen.clear()
        assert self._frozen.wait(20.0)

    def thaw(self):
        """Go on."""
        self._go.set()

    def end(self):
        """Stop for good."""
        self.thaw()
        self._ended.set()
        self._thread.join(20.0)
        self._loop.close()


class Fine(Source):
    """A loop that always runs, as far as a page sees."""

    def __init__(self):
        self.stopped, self.acted = [], []
        self.names = ('seq', 'stamp', 'published', 'x0', 'xd0', 'v', 'error', 's_over_epsilon',
                      'interval', 'round_trip')
        self.history = History(len(self.names), 5000)
        self.rows = True
        self.begun = clock()
        self.ended = None       # when the loop ended as planned

    def hello(self):
        return {'mode': 'live', 'rate': 200.0, 'title': 'fine', 'namespace': '/', 'minutes': 1,
                'columns': [{'name': name, 'unit': ''} for name in self.names],
                'bounds': {}, 'parameters': [], 'simulated': True, 'sections': {}}

    @property
    def stops(self):
        return len(self.stopped)

    def estop(self, viewer):
        self.stopped.append(viewer)
        return {'message': 'stopped'}

    async def act(self, _viewer, request, stops):
        self.still(stops)
        self.acted.append(request)
        return {'message': 'done'}

    async def ask(self, _request):
        raise LoopError('nothing to ask for')

    def now(self):
        node = {'name': 'plant_node', 'age': 0.1, 'gone': False, 'level': 0, 'message': 'well',
                'mode': 'running', 'reason': '', 'values': {}}
        ended = [] if self.ended is None else [
            {'kind': 'event', 'event': 'finished', 'node': '/plant_node', 'stamp': 1.0}]
        return [{'kind': 'status', 'time': clock(), 'seq': self.history.head - 1, 'lost': 0,
                 'stamp': clock() - self.begun,
                 'age': 0.0 if self.ended is None else clock() - self.ended, 'rate': 200.0,
                 'nodes': [node], 'recording': None, 'estop': False}, *ended]

    def add(self, count):
        if self.rows:
            rows = np.zeros((count, len(self.names)))
            rows[:, 0] = np.arange(self.history.head, self.history.head + count)
            rows[:, 1] = clock() - self.begun + 0.005 * np.arange(1 - count, 1)
            rows[:, 3] = np.sin(rows[:, 1])
            self.history.append(rows)


@pytest.fixture
def loopless():
    """Return a server without a loop behind it."""
    found = Loopless(Fine())
    yield found
    found.end()


def live(page):
    page.until("document.body.dataset.state === 'live'")
    page.until(f'{BUTTONS}.every((button) => !button.disabled)')


def test_an_estop_that_is_not_answered_reports_it_and_is_asked_again(open_page, loopless):
    page = open_page(loopless.address)
    live(page)
    loopless.freeze()
    page.evaluate("""() => { new MutationObserver(() => {
        window.saidAt ??= performance.now(); }).observe(document.querySelector('#alarm'),
        {childList: true});
        window.addEventListener('keydown', () => { window.pressed ??= performance.now(); }, true);
        }""")
    page.keyboard.press('Escape')
    page.until("document.querySelector('#alarm').innerText.startsWith('E-STOP NOT CONFIRMED')")
    assert page.evaluate('window.saidAt - window.pressed') < 5000.0      # 1 s, on a quiet machine
    page.until(f"{WORD} === 'NO MESSAGE FROM THE SERVER'")
    page.until(f'{BUTTONS}.every((button) => button.disabled)')
    assert page.is_enabled('#estop')
    loopless.thaw()
    page.until("document.querySelector('#alarm').hidden")
    assert loopless.source.stopped
    assert page.inner_text('#answer') == 'stopped'
    live(page)


def test_what_was_asked_before_the_server_hung_is_not_done_after_it(open_page, loopless):
    page = open_page(loopless.address)
    clicked = False
    while not clicked:      # before the page knows; a busy machine may let it know first
        live(page)
        loopless.freeze()
        clicked = page.evaluate("""() => { const button = document.querySelector('#reset');
            if (button.disabled) return false; button.click(); return true; }""")
        if not clicked:
            loopless.thaw()
    page.wait_for_timeout(3500)
    loopless.thaw()
    page.until("document.querySelector('#answer').innerText.startsWith('not done: it was asked')")
    assert loopless.source.acted == []
    live(page)
    page.click('#reset')
    page.until("document.querySelector('#answer').innerText === 'done'")


def test_rows_that_come_late_are_not_live(open_page, loopless, monkeypatch):
    page = open_page(loopless.address)
    live(page)
    # As on a slow link: what arrives now was sent three seconds ago.
    monkeypatch.setattr(viewer_module, 'clock', lambda: clock() - 3.0)
    page.until(f"{WORD} === 'OLD DATA'")
    page.until("document.querySelector('#state-why').innerText.startsWith('the plots are 3.')")
    assert page.inner_text('#tile-command dd') == '–'
    monkeypatch.undo()
    live(page)


def test_a_planned_end_is_not_an_error(open_page, loopless):
    page = open_page(loopless.address)
    live(page)
    loopless.source.ended, loopless.source.rows = clock(), False
    page.until(f"{WORD} === 'LOOP ENDED'")
    assert page.evaluate('document.body.dataset.state') == 'ended'
    assert page.inner_text('#tile-command dd') != '–'       # the last numbers stay
    loopless.end()
    page.until("document.querySelector('#state-why').innerText === 'the server has ended'")
    assert page.evaluate('document.body.dataset.state') == 'ended'


def test_without_rows_nothing_is_live(open_page, loopless):
    page = open_page(loopless.address)
    live(page)
    loopless.source.rows = False
    page.until(f"{WORD} === 'OLD DATA'")
    assert page.evaluate('document.body.dataset.state') == 'gone'
    loopless.source.rows = True
    live(page)


def test_only_the_word_is_read_out_and_keys_work_from_everywhere(open_page, loopless):
    page = open_page(loopless.address)
    live(page)
    assert page.locator('#state-word').get_attribute('role') == 'status'
    assert page.locator('#state').get_attribute('role') is None
    for place in ('#zoom-in', '#events', '#plots', '#reset'):
        page.focus(place)
        page.evaluate('dzRos.view.live()')
        page.keyboard.press('ArrowLeft')
        assert not page.evaluate('dzRos.view.follow'), place
        span = page.evaluate('dzRos.view.length')
        page.keyboard.press('+')
        assert page.evaluate('dzRos.view.length') < span, place
    page.focus('#pulse-size')            # a field keeps its keys
    page.evaluate('dzRos.view.live()')
    page.keyboard.press('ArrowLeft')
    page.keyboard.press('-')
    assert page.evaluate('dzRos.view.follow')
    assert '-' in page.input_value('#pulse-size')
    page.focus('#reset')                # and a button its Space
    page.keyboard.press(' ')
    assert page.evaluate('dzRos.view.follow')
    page.focus('#events')
    page.keyboard.press(' ')
    assert not page.evaluate('dzRos.view.follow')
    page.until("document.querySelector('#answer').innerText === 'done'")
