# SPDX-License-Identifier: Apache-2.0
"""What nonsense, floods and silence do to the page's server: they harm their sender alone.

Over 300 lines: all of it needs the same server and viewers that break rules.
"""

import asyncio
import contextlib
import json
import math
import socket

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.laws import LAWS
from dz_ros.live import connections as connections_module
from dz_ros.live import server as server_module
from dz_ros.live import viewer as viewer_module
from dz_ros.live.columns import Layout, usable
from dz_ros.live.history import HEAD, History, MOST_BYTES
from dz_ros.live.joiner import Joiner, MOST_NUMBERS
from dz_ros.live.node_configurations import labels_of

aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')


NONSENSE = ['', 'x', '[]', '1', 'null', '"estop"', '{', '{}', '{"do": "estop"}',
            '{"do": "estop", "id": true}', '{"do": "estop", "id": -1}', '{"do": 7, "id": 1}',
            '{"do": "estop", "id": 1e99}', '{"do": "exec", "id": 1}', '{"id": 1, "do": NaN}',
            '{"do": "estop", "id": 99999999999999999999}', '[' * 9000, '{"a":' * 2000,
            '{"hello": 1}', b'\x00\x01', b'',
            '{"do": "disturbance_pulse", "id": 1, "acceleration": 1e400}',
            '{"do": "set", "id": 1, "values": {"x": [-1e999]}}',
            '{"do": "set", "id": 1, "values": {"x": "\\ud800"}}',
            '{"do": "set", "id": 1, "values": {"\\udfff": 1}}', '{"\\ud800": 1}']


@pytest.mark.parametrize('nonsense', NONSENSE, ids=range(len(NONSENSE)))
def test_nonsense_ends_that_connection_alone(with_page, nonsense):
    async def test(page):
        good = await page.viewer()
        await with_page.texts(good, 'hello')
        bad = await page.viewer()
        await with_page.texts(bad, 'hello')
        if isinstance(nonsense, bytes):
            await bad.send_bytes(nonsense)
        else:
            await bad.send_str(nonsense)
        assert await with_page.ended(bad) == 1008
        assert page.source.stopped == page.source.acted == []
        assert (await page.ask(good, 'estop'))['ok']

    with_page(test)


PUBLISHED = [{'a': math.nan}, {'a': [1.0, [math.inf, {'b': -math.inf}]]}, {'a': '\ud800'},
             {'\udfff': 1}, {'a': 10 ** 400}, {'a': b'x'}, {7: math.nan, 'a': {1, 2}}]


@pytest.mark.parametrize('what', PUBLISHED, ids=range(len(PUBLISHED)))
def test_what_comes_from_topics_ends_no_viewer(with_page, what):
    async def test(page):
        ws = await page.viewer()
        await with_page.texts(ws, 'status')
        page.source.now = lambda: [{'kind': 'status', **what}]
        page.server.broadcast({'kind': 'event', **what})
        found = await with_page.texts(ws, 'event')
        assert 'NaN' not in json.dumps(found)
        later = await page.viewer()         # it is introduced with the same
        await with_page.texts(later, 'status')
        for viewer in (ws, later):
            assert (await page.ask(viewer, 'estop'))['ok']

    with_page(test)


def test_what_a_viewer_sends_can_be_reported_to_all(with_page):
    async def test(page):
        async def act(_viewer, request, _stops):
            page.server.broadcast({'kind': 'event', **request})
            return {'message': json.dumps(request)}

        page.source.act = act
        ws, other = await page.viewer(), await page.viewer()
        await with_page.texts(other, 'hello')
        for value in ('é\u2028\x00', '\U0001f600', 10 ** 400, 1e308, [[]], None):
            assert (await page.ask(ws, 'set', values={'x': value}))['ok']
            assert (await with_page.texts(other, 'event'))['values'] == {'x': value}

    with_page(test)


@pytest.mark.parametrize('first', ['x', '{}', '{"hello": 1, "seconds": "x"}', '[1]',
                                   '{"hello": 1, "seconds": 1e400}',
                                   '{"hello": 1, "seconds": -1}'])
def test_a_viewer_without_a_hello_is_disconnected(with_page, first):
    async def test(page):
        ws = await page.viewer(hello=False)
        await ws.send_str(first)
        assert await with_page.ended(ws) == 1008
        assert not page.server.viewers

    with_page(test)


def test_pings_do_not_put_off_the_first_word(with_page, monkeypatch):
    monkeypatch.setattr(server_module, 'HELLO_LIMIT', 0.5)

    async def test(page):
        ws = await page.viewer(hello=False)
        ending = asyncio.create_task(with_page.ended(ws))
        for _ in range(400):
            if ending.done():
                break
            with contextlib.suppress(ConnectionError):
                await ws.ping()
            await asyncio.sleep(0.05)
        assert ending.done()
        assert await ending == 1008

    with_page(test)


def test_one_answer_in_numbers_at_a_time_waits_to_be_sent(with_page):
    async def test(page):
        page.source.answer = bytes(8 << 20)
        raw = await _deaf(page)
        for number in range(30):
            await _send(raw, {'do': 'rows', 'id': number})
        (viewer,) = page.server.viewers
        for _ in range(50):
            await asyncio.sleep(0.01)
        assert viewer.held < 1.5 * len(page.source.answer)
        raw.close()

    with_page(test)


def test_a_text_that_is_too_long_ends_its_connection(with_page):
    async def test(page):
        ws = await page.viewer()
        await with_page.texts(ws, 'hello')
        await ws.send_str(json.dumps({'do': 'set', 'id': 1, 'values': {
            'x': 'y' * server_module.MESSAGE}}))
        assert await with_page.ended(ws) == 1009
        assert page.source.acted == []

    with_page(test)


def test_too_many_requests_end_their_connection(with_page):
    async def test(page):
        ws = await page.viewer()
        await with_page.texts(ws, 'hello')
        for number in range(int(2 * viewer_module.BURST)):
            await ws.send_json({'do': 'rows', 'id': number})
        assert await with_page.ended(ws) == 1008

    with_page(test)


def test_there_is_an_end_to_viewers(with_page, monkeypatch):
    monkeypatch.setattr(server_module, 'MOST_VIEWERS', 2)

    async def test(page):
        kept = [await page.viewer() for _ in range(2)]
        for ws in kept:
            await with_page.texts(ws, 'hello')
        with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
            await page.viewer()
        assert caught.value.status == 503
        await kept[0].close()
        while len(page.server.viewers) > 1:
            await asyncio.sleep(0.01)
        await with_page.texts(await page.viewer(), 'hello')

    with_page(test)


def test_those_without_the_token_do_not_take_every_place(with_page, monkeypatch):
    monkeypatch.setattr(server_module, 'MOST_VIEWERS', 3)
    monkeypatch.setattr(server_module, 'TOKEN_PLACES', 1)

    async def test(page):
        kept = [await page.viewer(token='wrong') for _ in range(2)]
        for ws in kept:
            await with_page.texts(ws, 'hello')
        assert await with_page.ended(await page.viewer(token='wrong')) == 1013
        assert (await with_page.texts(await page.viewer(), 'hello'))['may_act']

    with_page(test)


def test_there_is_an_end_to_connections_and_to_silence(with_page, monkeypatch):
    monkeypatch.setattr(connections_module, 'MAX_CONNECTIONS', 3)
    monkeypatch.setattr(connections_module, 'SILENT', 0.3)

    async def test(page):
        silent = [await asyncio.open_connection('127.0.0.1', page.port) for _ in range(3)]
        silent[0][1].write(b'GET / HTTP/1.1\r\nHost: 127.0.0.1')       # and never the rest
        while page.server._connections is None or len(page.server._runner.server.connections) < 3:
            await asyncio.sleep(0.01)
        reader, writer = await asyncio.open_connection('127.0.0.1', page.port)
        with contextlib.suppress(ConnectionError):      # the fourth is cut off at once
            writer.write(b'GET / HTTP/1.1\r\n\r\n')
            await writer.drain()
            assert await reader.read() == b''
        for reader, _ in silent:        # the silent ones are cut off a little later
            with contextlib.suppress(ConnectionError):
                assert await asyncio.wait_for(reader.read(), 20.0) == b''
        async with page.session.get(page.base + '/') as answer:
            assert answer.status == 200

    with_page(test)


async def _deaf(page):
    """Return the socket of a viewer that never reads after its hello."""
    raw = socket.socket()
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    raw.connect(('127.0.0.1', page.port))
    raw.setblocking(False)
    loop = asyncio.get_running_loop()
    host = f'127.0.0.1:{page.port}'
    await loop.sock_sendall(raw, (
        f'GET /ws HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\n'
        'Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n'
        'Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n').encode())
    assert b'101' in await loop.sock_recv(raw, 300)
    there = len(page.server.viewers)
    await _send(raw, {'hello': 1, 'seconds': 0})
    while len(page.server.viewers) == there:
        await asyncio.sleep(0.01)
    return raw


async def _send(raw, request):
    """Send a text, masked with nothing."""
    text = json.dumps(request).encode()
    assert len(text) < 126
    await asyncio.get_running_loop().sock_sendall(
        raw, bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text)


def test_a_viewer_that_stops_reading_is_dropped_and_nothing_waits_for_it(with_page, monkeypatch):
    monkeypatch.setattr(viewer_module, 'STALLED', 0.5)

    async def test(page):
        page.source.history = type(page.source.history)(400, 20000)
        good = await page.viewer()
        await with_page.texts(good, 'hello')
        raw = await _deaf(page)

        async def read():
            async for _ in good:
                pass

        reading = asyncio.create_task(read())
        while len(page.server.viewers) > 1:
            page.source.history.append(np.zeros((2000, 400)))       # 6 MB a time
            page.server.publish()
            await asyncio.sleep(0.05)
        assert not reading.done()
        (left,) = page.server.viewers
        assert left.cursor is not None
        reading.cancel()
        raw.close()

    with_page(test)


@pytest.mark.slow
def test_a_table_never_takes_more_memory_than_it_may():
    wide = History(5000, 10 ** 9)
    assert wide.nbytes <= MOST_BYTES
    rows = np.ones((3, 5000))
    wide.append(rows)
    frame, head = wide.frame(0, 0.0)
    assert head == 3
    assert len(frame) == HEAD.size + rows.nbytes
    few = History(5, 100)
    few.append(np.ones((7, 5)))
    assert len(few) == 7


@pytest.mark.parametrize(('labels', 'usable_there'), [
    (('seq', 'stamp', 'x0'), True), (('x0', 'seq', 'stamp'), False), ((), False),
    (('seq', 'stamp', *(f'n{i}' for i in range(20_000))), False),
    (('seq', 'stamp', 'x' * 1000), False), (('seq', 'stamp', 'a\nb'), False),
    (('seq', 'stamp', 'a', 'a'), False),
])
def test_names_that_become_columns(labels, usable_there):
    assert (usable(labels) == '') == usable_there


def test_every_law_can_be_shown():
    for law in LAWS.builtin:        # with their default settings
        c = Configuration.from_flat({'controller.law': law})
        assert not any(usable(found) for found in labels_of(c).values())


def test_rows_that_wait_are_bounded_however_many_columns_there_are():
    labels = {'state': ('seq', 'stamp', 'x0', 'echo_seq', 'echo_stamp', 'round_trip'),
              'terms': ('seq', 'stamp', *(f'n{i}' for i in range(510)), 'echo_seq')}
    layout = Layout(labels)
    joiner = Joiner(layout)
    numbers = [0.0] * len(labels['terms'])
    for seq in range(20_000):
        numbers[-1] = float(seq % 5000)
        joiner.put('terms', numbers, 0.0, 0.0)
        numbers[-1] = float(seq)
    assert len(joiner) * layout.base <= 2 * MOST_NUMBERS
