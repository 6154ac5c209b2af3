# SPDX-License-Identifier: Apache-2.0
"""The page's server: what a viewer gets, which may look, which may act."""

import asyncio

import numpy as np
import pytest

from dz_ros.errors import ConfigurationError, LoopError
from dz_ros.live.access import Access
from dz_ros.live.assets import ASSETS
from dz_ros.live.clock import clock
from dz_ros.live.history import HEAD, LIVE

aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')

OTHER = 'http://evil.example'


def test_a_viewer_is_introduced_and_gets_every_row(with_page):
    async def test(page):
        page.source.add(300)
        ws = await page.viewer(seconds=1.0)
        hello = await with_page.texts(ws, 'hello')
        assert hello['may_act']
        assert (await with_page.texts(ws, 'status'))['age'] == 0.0
        page.source.add(50)
        page.server.publish()
        got = []
        while len(got) < 150:       # a second at 100 Hz of the past, and what is new
            message = await ws.receive(10.0)
            kind, _, count, _, _ = HEAD.unpack_from(message.data)
            rows = np.frombuffer(message.data, '<f8', offset=HEAD.size).reshape(count, 2)
            assert kind == LIVE
            got += rows[:, 0].tolist()
        assert got == list(range(200, 350))
        page.server.broadcast({'kind': 'event', 'n': 1})
        assert (await with_page.texts(ws, 'event'))['n'] == 1
        await ws.close()

    with_page(test)


def test_actions_are_passed_on_and_answered(with_page):
    async def test(page):
        ws = await page.viewer()
        assert (await page.ask(ws, 'estop', 3)) == {
            'kind': 'result', 'id': 3, 'ok': True, 'message': 'stopped'}
        assert page.source.stopped == ['127.0.0.1']
        answer = await page.ask(ws, 'set', 4, values={'controller.k_d': 1.0})
        assert answer['ok']
        assert page.source.acted[0]['values'] == {'controller.k_d': 1.0}
        refused = await page.ask(ws, 'disturbance_pulse', 5)
        assert not refused['ok']
        assert 'must be gentle' in refused['message']

    with_page(test)


def test_an_estop_does_not_wait_for_what_is_being_worked_on_and_cancels_it(with_page):
    async def test(page):
        ws = await page.viewer()
        for number, what in enumerate(('reset', 'estop', 'reset'), 1):
            await ws.send_json({'do': what, 'id': number, 'asked': clock()})
        found = [await with_page.texts(ws, 'result') for _ in range(3)]
        assert [item['id'] for item in found] == [2, 3, 1]
        assert [item['ok'] for item in found] == [True, False, False]
        assert 'cancelled: an e-stop was pressed' in found[2]['message']
        assert page.source.acted == []
        assert (await page.ask(ws, 'reset'))['ok']

    with_page(test)


def test_an_estop_cancels_what_another_viewer_has_asked_for(with_page):
    async def test(page):
        one, other = await page.viewer(), await page.viewer()
        await one.send_json({'do': 'reset', 'id': 1, 'asked': clock()})
        while not page.source.acted:        # its first step has been done
            await asyncio.sleep(0)
        assert (await page.ask(other, 'estop'))['ok']
        answer = await with_page.texts(one, 'result')
        assert not answer['ok']
        assert 'cancelled' in answer['message']

    with_page(test)


@pytest.mark.parametrize('asked', [None, -60.0, -3.5, 60.0, 'now', True, []])
def test_what_was_asked_for_long_ago_is_not_done(with_page, asked):
    async def test(page):
        ws = await page.viewer()
        given = {} if asked is None else {
            'asked': clock() + asked if isinstance(asked, float) else asked}
        await ws.send_json({'do': 'reset', 'id': 1, **given})
        answer = await with_page.texts(ws, 'result')
        assert not answer['ok']
        assert 'not done: ' in answer['message']
        assert page.source.acted == []
        await ws.send_json({'do': 'estop', 'id': 2, **given})       # never too old
        assert (await with_page.texts(ws, 'result'))['ok']

    with_page(test)


@pytest.mark.parametrize('token', ['', 'x', 'é' * 30, 'a' * 5000])
def test_without_the_token_one_may_look_and_not_act(with_page, token):
    async def test(page):
        ws = await page.viewer(token=token)
        hello = await with_page.texts(ws, 'hello')
        assert not hello['may_act']
        for what in ('estop', 'reset', 'activate', 'deactivate', 'set', 'disturbance_pulse'):
            answer = await page.ask(ws, what)
            assert not answer['ok']
            assert 'token' in answer['message']
        assert page.source.stopped == page.source.acted == []

    with_page(test)


def test_read_only_means_no_viewer(with_page):
    async def test(page):
        assert page.access.token not in page.access.address(page.port)
        ws = await page.viewer()
        answer = await page.ask(ws, 'estop')
        assert not answer['ok']
        assert 'read_only' in answer['message']
        assert page.source.stopped == []

    with_page(test, read_only=True)


def test_from_elsewhere_even_looking_needs_the_token(with_page):
    async def test(page):
        assert page.access.token in page.access.address(page.port)
        ws = await page.viewer(token='wrong')
        assert await with_page.ended(ws) == 4401
        ws = await page.viewer()
        assert (await with_page.texts(ws, 'hello'))['may_act']

    with_page(test, host='0.0.0.0')


@pytest.mark.parametrize('headers', [
    {'Origin': OTHER}, {'Origin': 'null'}, {'Origin': ''}, {'Origin': 'https://127.0.0.1:{port}'},
    {'Origin': 'http://127.0.0.1'}, {'Origin': 'http://127.0.0.1:{port}.evil.example'},
    {'Origin': 'http://localhost:{port}'},      # right machine, but not the page's own origin
    {'Origin': 'http://evil.example', 'Host': 'evil.example'},
])
def test_a_page_of_another_origin_gets_no_socket(with_page, headers):
    async def test(page):
        filled = {name: value.format(port=page.port) for name, value in headers.items()}
        with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
            await page.session.ws_connect(page.base + '/ws', headers=filled)
        assert caught.value.status in (403, 421)
        assert not page.server.viewers

    with_page(test)


def test_no_origin_no_socket(with_page):
    async def test(page):
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await page.session.ws_connect(page.base + '/ws')

    with_page(test)


@pytest.mark.parametrize('host', ['evil.example', 'evil.example:{port}', '127.0.0.1', '',
                                  '127.0.0.1:99999', '127.0.0.1:{port}x', '[::1', '127.0.0.1:²'])
def test_a_name_that_was_made_to_mean_this_machine_gets_nothing(with_page, host):
    async def test(page):
        name = host.format(port=page.port)
        async with page.session.get(page.base + '/', headers={'Host': name}) as answer:
            assert answer.status in (400, 421)
            assert b'<html' not in await answer.read()

    with_page(test)


def test_the_page_s_files_are_served_and_nothing_else(with_page):
    async def test(page):
        for path in ASSETS:
            async with page.session.get(page.base + path) as answer:
                assert answer.status == 200, path
                assert answer.headers['X-Content-Type-Options'] == 'nosniff'
                assert answer.headers['Cache-Control'] == 'no-store'
                policy = answer.headers['Content-Security-Policy']
                assert "default-src 'none'" in policy
                assert "script-src 'self';" in policy
                assert 'unsafe' not in policy
                assert len(await answer.read()) > 100 or path.endswith('.css')
        for path in ('/server.py', '/../server.py', '/%2e%2e/server.py', '/vendor/', '/x',
                     '//etc/passwd', '/style.css/..'):
            async with page.session.get(aiohttp.client.URL(page.base + path, encoded=True)) as got:
                assert got.status == 404, path
        for method in ('POST', 'PUT', 'DELETE', 'OPTIONS', 'PATCH'):
            async with page.session.request(method, page.base + '/') as answer:
                assert answer.status == 405

    with_page(test)


def test_a_second_page_takes_the_next_port_and_a_taken_one_is_one_line(with_page):
    async def test(page):
        from dz_ros.live.server import Server
        other = Server(page.source, Access())
        await other.start()
        assert other.port != page.port
        with pytest.raises(LoopError, match=f'port {page.port}.*choose another'):
            await Server(page.source, Access()).start(page.port)
        await other.close()

    with_page(test)


@pytest.mark.parametrize('host', ['', 'no.such.host.invalid', '300.1.1.1', 'a b', '\0'])
def test_an_address_that_is_none(host):
    with pytest.raises(ConfigurationError, match='must be an address'):
        Access(host)


def test_tokens_differ_and_are_compared_whole():
    one, other = Access(), Access()
    assert one.token != other.token
    assert len(one.token) >= 32
    assert one.knows(one.token)
    for wrong in (other.token, one.token[:-1], one.token + 'x', None, 7, ''):
        assert not one.knows(wrong)
    assert Access('::1').address(80).startswith('http://[::1]:80/#')
    assert Access('localhost').local
    assert not Access('0.0.0.0').local
    assert Access(actions=False).address(80) == 'http://127.0.0.1:80/'
