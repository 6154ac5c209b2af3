# SPDX-License-Identifier: Apache-2.0
"""Recorded runs of several axes in the page: a summary, and a page for each axis."""

from __future__ import annotations

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_runs
from dz_ros.core.loop.coupled import simulate_axes
from dz_ros.files.configurations import load_configuration
from dz_ros.live.history import HEAD
from dz_ros.live.recorded_source import Recorded, RecordedAxes
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run
from dz_ros.runs.axes import axis_run, each_axis

aiohttp = pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')

AXES = ['surge', 'sway', 'yaw']
TABLE = ('Numbers', ['quantity', *AXES], [['max |x̃|', '1 m', '2 m', '<b>3</b> rad']])


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return the directories of two runs of the vehicle, one of them with other gains."""
    folder = tmp_path_factory.mktemp('recorded')
    for name, keys in (('first', {}), ('second', {'axes.yaw.controller.lambda': 3.0})):
        c = Configuration.from_flat({**load_configuration('rov_planar').to_flat(), **keys,
                                     'loop.duration': 2.0})
        save_run(from_runs(simulate_axes(c), c, 10 ** 18), folder / name)
    return folder / 'first', folder / 'second'


@pytest.fixture(scope='module')
def source(recorded):
    """Return what a server of the first run shows."""
    return RecordedAxes({axis: {'first': run} for axis, run in
                         each_axis(read_run(recorded[0])).items()}, ['axis yaw: lost'], [TABLE])


def test_a_viewer_gets_the_summary_or_the_axis_that_it_asks_for(with_page, source, recorded):
    data = read_run(recorded[0])

    async def test(page):
        ws = await page.viewer(token='')
        hello = await with_page.texts(ws, 'hello')
        assert (hello['mode'], hello['axes']) == ('axes', AXES)
        assert hello['failures'] == ['axis yaw: lost']
        assert hello['tables'] == [[TABLE[0], TABLE[1], TABLE[2]]]
        answer = await page.ask(ws, 'rows', run=0)
        assert not answer['ok']
        assert 'ask for one of axes surge, sway, yaw' in answer['message']
        assert not (await page.ask(ws, 'estop'))['ok']
        for axis in ('yaw', 'sway'):        # each viewer its own, at the same time
            one = await page.viewer(token='', more={'axis': axis})
            hello = await with_page.texts(one, 'hello')
            assert (hello['mode'], hello['axis'], hello['axes']) == ('run', axis, AXES)
            assert hello['title'] == f'first, axis {axis}'
            assert not hello['may_act']
            names = [column['name'] for column in hello['columns']]
            await one.send_json({'do': 'rows', 'id': 7, 'run': 0})
            frame = await one.receive(20.0)
            while frame.type is not aiohttp.WSMsgType.BINARY:
                frame = await one.receive(20.0)
            rows = np.frombuffer(frame.data, '<f8', offset=HEAD.size).reshape(401, -1)
            channel = data.channels['state'].axis(axis)
            assert np.array_equal(rows[:, names.index('x0')], channel['x0'])
            assert not (await page.ask(one, 'reset'))['ok']

    with_page(test, source, actions=False)


@pytest.mark.parametrize('axis', ['roll', 'surge/../yaw', '\ud7ff', 7, None, ['yaw'], 'y' * 9000])
def test_another_axis_is_refused(with_page, source, axis):
    async def test(page):
        ws = await page.viewer(token='', more={'axis': axis})
        assert await with_page.ended(ws) == 1008
        assert page.server.viewers == set()

    with_page(test, source, actions=False)


@pytest.mark.parametrize('axis', ['yaw', 'roll', '\ud7ff', 7, None])
def test_what_can_be_stopped_is_shown_and_stopped_whatever_axis_is_asked_for(with_page, axis):
    """An address kept from a recorded run must not keep the e-stop of a loop out of reach."""
    async def test(page):
        ws = await page.viewer(more={'axis': axis})
        assert (await with_page.texts(ws, 'hello'))['mode'] == 'live'
        assert (await page.ask(ws, 'estop'))['ok']
        assert len(page.source.stopped) == 1

    with_page(test)


def test_a_run_of_one_axis_is_shown_whatever_axis_is_asked_for(with_page, recorded):
    run = Recorded({'first': axis_run(read_run(recorded[0]), 'yaw')})

    async def test(page):
        ws = await page.viewer(token='', more={'axis': 'roll'})
        assert (await with_page.texts(ws, 'hello'))['title'] == 'first'

    with_page(test, run, actions=False)


@pytest.mark.parametrize('axis', ['', 'yaw', 'roll'])
def test_from_elsewhere_summary_and_axes_need_the_token(with_page, source, axis):
    async def test(page):
        ws = await page.viewer(token='wrong', more={'axis': axis})
        assert await with_page.ended(ws) == 4401     # nor does it learn which axes there are
        if axis != 'roll':
            ws = await page.viewer(more={'axis': axis})
            assert (await with_page.texts(ws, 'hello'))['axes'] == AXES
        # What is got without a socket holds nothing of the run.
        for path in ('/', '/?axis=yaw', '/yaw', '/summary.js'):
            async with page.session.get(page.base + path) as answer:
                text = await answer.text()
                assert answer.status == (404 if path == '/yaw' else 200)
                assert 'surge' not in text
                assert "frame-ancestors 'none'" in answer.headers['Content-Security-Policy']

    with_page(test, source, host='0.0.0.0', actions=False)


@pytest.mark.live
def test_the_summary_leads_to_each_axis_and_back(open_page, processes, recorded, axe):
    process = processes('-m', 'dz_ros', 'report', '--serve', recorded[0], '--over', recorded[1])
    page = open_page(process.wait_for_line('http').split()[2])
    page.until("document.querySelectorAll('#summary .axes a').length === 3")
    assert page.inner_text('#title') == 'first and second'
    assert not page.is_visible('#plots')
    assert not page.is_visible('#estop')
    rows = [row.split('\t') for row in page.inner_text('#summary table >> nth=0').splitlines()]
    assert rows[0] == ['quantity', 'run', *AXES]
    assert [row[1] for row in rows if row[0] == 'max |x̃|'] == ['first', 'second']
    assert page.inner_text('#summary table >> nth=1').splitlines()[1].split('\t') == [
        'controller.lambda', 'yaw', '9.09', '3.0']
    assert axe(page) == []
    page.set_viewport_size({'width': 320, 'height': 800})
    assert page.evaluate('document.documentElement.scrollWidth') <= 320
    page.set_viewport_size({'width': 1400, 'height': 900})
    with page.expect_navigation():
        page.click('#summary .axes a >> nth=2')
    page.until('dzRos.app.stores.length === 2 && dzRos.app.stores[1]?.count === 401')
    assert page.inner_text('#title') == 'first and second, axis yaw'
    assert not page.is_visible('#summary')
    with page.expect_navigation():
        page.select_option('#axis', 'sway')
    page.until("document.querySelector('#title').innerText === 'first and second, axis sway'")
    page.until('dzRos.app.stores[0]?.count === 401')
    expected = read_run(recorded[0]).channels['command'].axis('sway')['v'][200]
    assert page.evaluate('dzRos.app.stores[0].data.v[200]') == pytest.approx(expected, rel=1e-6)
    page.go_back()
    page.until("document.querySelector('#title').innerText === 'first and second, axis yaw'")
    with page.expect_navigation():
        page.click('#all-axes')
    page.until("document.querySelectorAll('#summary .axes a').length === 3")
