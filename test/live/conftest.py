# SPDX-License-Identifier: Apache-2.0
"""A server around a source without a loop; a real browser: Debian's chromium, by Playwright."""

import asyncio
from functools import partial
from importlib.resources import files
import json
import os
import shutil
import time

import numpy as np
import pytest

from dz_ros.errors import ConfigurationError
from dz_ros.live.access import Access
from dz_ros.live.clock import clock
from dz_ros.live.history import ANSWER, History, pack
from dz_ros.live.source import Source

aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')

TIME_OUT = 180e3
"""Longest wait for anything in the page [ms]."""
LOOK_AGAIN = 100.0
"""Between two looks at the page, each of which takes a browser some milliseconds [ms]."""


class Puppet(Source):
    """Something to show that notes what is asked of it."""

    def __init__(self):
        self.history = History(2, 5000)
        self.stopped, self.acted = [], []
        self.answer = pack(ANSWER, 1, np.zeros((1, 2)), 0, 0.0)

    def hello(self):
        return {'mode': 'live', 'columns': [{'name': 'seq', 'unit': ''}], 'rate': 100.0}

    def now(self):
        return [{'kind': 'status', 'age': 0.0}]

    @property
    def stops(self):
        return len(self.stopped)

    def estop(self, viewer):
        self.stopped.append(viewer)
        return {'message': 'stopped'}

    async def act(self, viewer, request, stops):
        self.still(stops)
        self.acted.append(request)
        if request['do'] == 'disturbance_pulse':
            raise ConfigurationError('disturbance_pulse', 1, 'must be gentle')
        await asyncio.sleep(0.05)
        self.still(stops)
        return {'message': 'done'}

    async def ask(self, request):
        return self.answer

    def add(self, count):
        first = self.history.head
        self.history.append(np.column_stack([np.arange(first, first + count)] * 2).astype(float))


class Page:
    """What a test does to a server: `get`, `viewer`."""

    def __init__(self, server, source, access):
        self.server, self.source, self.access = server, source, access
        self.session = aiohttp.ClientSession()

    @property
    def port(self):
        return self.server.port

    @property
    def base(self):
        return f'http://127.0.0.1:{self.port}'

    async def viewer(self, token=None, origin=None, seconds=0.0, hello=True, more=(), **headers):
        """Return a WebSocket after its hello, with `more` in it; `token` None is the right one."""
        ws = await self.session.ws_connect(
            self.base + '/ws', headers={'Origin': origin or self.base, **headers}, max_msg_size=0)
        if hello:
            await ws.send_json({**dict(more), 'hello': 1, 'seconds': seconds,
                                'token': self.access.token if token is None else token})
        return ws

    async def ask(self, ws, what, number=1, **details):
        """Return the result of a request."""
        await ws.send_json({'do': what, 'id': number, 'asked': clock(), **details})
        return await texts(ws, 'result')


async def texts(ws, kind):
    """Return the next text of a kind; fail where the connection ends before it."""
    while True:
        message = await ws.receive(20.0)
        assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
        if message.type is aiohttp.WSMsgType.TEXT:
            found = json.loads(message.data)
            if found['kind'] == kind:
                return found


async def ended(ws):
    """Return the code a connection ends with."""
    while True:
        message = await ws.receive(20.0)
        if message.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED,
                            aiohttp.WSMsgType.CLOSING, aiohttp.WSMsgType.ERROR):
            return ws.close_code


@pytest.fixture
def with_page():
    """Return a function that runs ``test(page)`` with a server; keywords go to its `Access`.

    The server shows a `Puppet` unless another source is given.
    """
    from dz_ros.live.server import Server

    def run(test, shown=None, **rules):
        async def work():
            source = Puppet() if shown is None else shown
            access = Access(**rules)
            server = Server(source, access)
            await server.start()
            page = Page(server, source, access)
            try:
                await asyncio.wait_for(test(page), 120.0)
            finally:
                await page.session.close()
                await server.close()

        asyncio.run(work())

    run.texts, run.ended = texts, ended
    return run


BEHIND = """#!/bin/sh
# A page of its own for the address bar's suggestions would take most of the time of a page.
for word do
  case $word in --disable-features=*) word=$word,WebUIOmniboxPopup,WebUIOmniboxAimPopup;; esac
  set -- "$@" "$word"
  shift
done
exec nice -n 5 {} "$@"
"""
"""Starts a browser that takes no time from what it shows."""


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    """A browser without a window; none here: the test is skipped."""
    playwright = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    playwright.expect.set_options(timeout=TIME_OUT)
    program = next(filter(None, map(shutil.which, ('chromium', 'chromium-browser',
                                                   'google-chrome'))), None)
    if program is None:
        pytest.skip('no chromium here: apt-get install chromium')
    # It draws without a graphics card, and must not take the time from the loop it shows, nor
    # wait for ever where other tests run as well.
    behind = tmp_path_factory.mktemp('browser') / 'chromium'
    behind.write_text(BEHIND.format(program), encoding='utf-8')
    behind.chmod(0o755)
    with playwright.sync_playwright() as driver:
        arguments = ['--no-sandbox'] if os.geteuid() == 0 else []
        found = driver.chromium.launch(executable_path=behind, args=arguments)
        yield found
        found.close()


@pytest.fixture
def open_page(browser):
    """Return ``open(url, **context) -> page``; a page that complains fails the test.

    A page has `requests`, the addresses it asked for, and `until(expression)`.
    """
    contexts, complaints = [], []

    def open_one(url, **settings):
        settings.setdefault('viewport', {'width': 1400, 'height': 900})
        context = browser.new_context(**settings)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(TIME_OUT)
        page.requests, page.until = [], partial(_until, page)
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


def _until(page, expression):
    """Wait until an expression is true in the page.

    Playwright's own waiting would need `eval`, which the page's policy forbids.
    """
    deadline = time.monotonic() + TIME_OUT * 1e-3
    script = expression if expression.startswith('()') else f'() => ({expression})'
    while not page.evaluate(script):
        assert time.monotonic() < deadline, (expression, page.inner_text('#state'))
        page.wait_for_timeout(LOOK_AGAIN)


@pytest.fixture
def axe():
    """Return the function that gives the serious findings of axe-core on a page."""
    source = pytest.importorskip('axe_playwright_python', reason='axe-core is not installed')

    def findings(page):
        page.evaluate(files(source).joinpath('axe.min.js').read_text(encoding='utf-8'))
        found = page.evaluate('axe.run()')
        assert len(found['passes']) > 15
        return [(item['id'], [node['html'][:90] for node in item['nodes']])
                for item in found['violations'] if item['impact'] in ('serious', 'critical')]

    return findings
