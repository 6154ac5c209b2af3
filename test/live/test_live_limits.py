"""What nonsense, floods and silence do to the page's server: nothing but to whoever sends them."""

import asyncio
import contextlib
import json
import socket

import numpy as np
import pytest

from dz_ros.live import connections as connections_module
from dz_ros.live import server as server_module
from dz_ros.live import viewer as viewer_module

aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')


NONSENSE = ['', 'x', '[]', '1', 'null', '"estop"', '{', '{}', '{"do": "estop"}',
            '{"do": "estop", "id": true}', '{"do": "estop", "id": -1}', '{"do": 7, "id": 1}',
            '{"do": "estop", "id": 1e99}', '{"do": "exec", "id": 1}', '{"id": 1, "do": NaN}',
            '{"do": "estop", "id": 99999999999999999999}', '[' * 9000, '{"a":' * 2000,
            '{"hello": 1}', b'\x00\x01', b'']


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


@pytest.mark.parametrize('first', ['x', '{}', '{"hello": 1, "seconds": "x"}', '[1]',
                                   '{"hello": 1, "seconds": 1e400}',
                                   '{"hello": 1, "seconds": -1}'])
def test_who_does_not_say_hello_is_shown_out(with_page, first):
    async def test(page):
        ws = await page.viewer(hello=False)
        await ws.send_str(first)
        assert await with_page.ended(ws) == 1008
        assert not page.server.viewers

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


def test_there_is_an_end_to_connections_and_to_silence(with_page, monkeypatch):
    monkeypatch.setattr(connections_module, 'MOST', 3)
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


def test_a_viewer_that_stops_reading_is_dropped_and_nothing_waits_for_it(with_page, monkeypatch):
    monkeypatch.setattr(viewer_module, 'STALLED', 0.5)

    async def test(page):
        page.source.history = type(page.source.history)(400, 20000)
        good = await page.viewer()
        await with_page.texts(good, 'hello')
        # A socket of our own with a small buffer that nobody empties.
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
        text = b'{"hello":1,"seconds":0}'
        await loop.sock_sendall(raw, bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text)
        while len(page.server.viewers) < 2:
            await asyncio.sleep(0.01)

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
