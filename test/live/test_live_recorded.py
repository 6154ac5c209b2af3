# SPDX-License-Identifier: Apache-2.0
"""The page of recorded runs in a real browser: scrubbing, exporting, widths, accessibility."""

import sys

import numpy as np
import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run
from dz_ros.core.loop.offline import simulate
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run
from dz_ros.report.report import write_report

DZ = ('-m', 'dz_ros')
pytestmark = pytest.mark.live


BEYOND = """() => [...document.querySelectorAll('body *')].filter((item) => {
    if (item.closest('thead')) return false;        // on a phone its words stand before the values
    const {left, right, width} = item.getBoundingClientRect();
    return width > 1 && (left < -1 || right > document.documentElement.clientWidth + 1);
    }).map((item) => item.outerHTML.slice(0, 80))"""
"""What reaches beyond the screen."""
TEXT_WIDER_THAN_ITS_BOX = """() => [...document.querySelectorAll('p, li, td, th, caption, .wide')]
    .filter((item) => item.clientWidth > 1 && item.scrollWidth > item.clientWidth + 1)
    .map((item) => item.outerHTML.slice(0, 80))"""


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


def test_a_recorded_run_scrubs(open_page, served, recorded):
    page = open_page(served)
    page.until('dzRos.app.stores[0]?.count === 4001')
    data = recorded[2]
    assert page.inner_text('#state-word') == 'RECORDED'
    assert not page.is_visible('#estop')
    page.select_option('#span', '5')
    slider = page.locator('#scrub-at')
    slider.fill('0.5')
    page.until('Math.abs(dzRos.view.end - 10) < 0.01')
    page.click('#forth')
    page.until('Math.abs(dzRos.view.end - 12.5) < 0.01')
    box = page.locator('#figure-error .u-over').bounding_box()
    page.mouse.move(box['x'] + 0.5 * box['width'], box['y'] + 0.5 * box['height'])
    page.until('dzRos.view.cursor !== null')
    at = page.evaluate('dzRos.view.cursor')
    row = int(np.argmin(np.abs(data.channels['state']['stamp'] - at)))
    error = data.channels['state']['x0'][row] - data.channels['reference']['xd0'][row]
    page.until(f"document.querySelector('#cursor-time').innerText === '{at:.3f} s'")
    shown = page.inner_text('#tile-error dd').replace('−', '-')
    assert float(shown) == pytest.approx(error, rel=1e-2, abs=1e-4)
    page.click('#play')
    end = page.evaluate('dzRos.view.end')
    page.until(f'dzRos.view.end > {end} + 0.3')


def test_what_is_seen_is_exported(open_page, served, recorded, tmp_path):
    page = open_page(served)
    page.until('dzRos.app.stores[0]?.count === 4001')
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


def test_of_a_thinned_run_times_are_counted_and_exported_over_every_row(
        open_page, processes, recorded, tmp_path):
    # The same server, that keeps fewer rows in the page.
    fewer = ('import sys; from dz_ros.live import recorded_source as source; '
             'source.MOST_ROWS = 400; source.PIECE = 300; '
             'from dz_ros.cli.main import main; sys.exit(main())')
    addresses = [processes(*words, 'report', '--serve', recorded[0]).wait_for_line('http')
                 for words in ((sys.executable, '-c', fewer), DZ)]
    found = []
    for address in addresses:
        page = open_page(address.split()[2])
        page.until('dzRos.app.stores[0]?.count > 100')
        page.evaluate('dzRos.view.look(2, 8)')
        page.until('dzRos.app.bars[0].found?.count > 1000 && dzRos.app.bars[0].found.count < 1300')
        found.append(page.evaluate('dzRos.app.bars.map((bars) => [bars.found, '
                                   'bars.words.textContent])'))
        with page.expect_download() as caught:
            page.click('#csv')
        caught.value.save_as(tmp_path / 'seen.csv')
        found[-1].append(np.genfromtxt(tmp_path / 'seen.csv', delimiter=',', names=True))
    thinned, whole = found
    assert len(thinned[2]) == len(whole[2]) == 1200
    assert page.evaluate('dzRos.app.stores[0].whole')
    for name in ('x0', 'v', 'seq'):
        np.testing.assert_allclose(thinned[2][name], whole[2][name], rtol=1e-6)
    for one, other in zip(thinned[:2], whole[:2], strict=True):
        for name in ('count', 'late', 'too_late'):
            assert one[0].get(name) == other[0].get(name)
    assert 'too late' in thinned[0][1]


def test_two_runs_lie_over_each_other(open_page, processes, recorded):
    process = processes(*DZ, 'report', '--serve', recorded[0], '--over', recorded[1])
    page = open_page(process.wait_for_line('http').split()[2])
    page.until('dzRos.app.stores.length === 2 && dzRos.app.stores[1]?.count === 4001')
    legend = page.inner_text('#figure-error .legend')
    assert 'x̃' in legend
    assert 'x̃ (second)' in legend
    page.until("""() => dzRos.app.plots.shown[1].chart.data.length === 3
        && dzRos.app.plots.shown[1].chart.data[2].some((value) => value != null)""")
    lines = page.evaluate('dzRos.app.plots.shown[1].chart.data.slice(1).map((line) => '
                          'Math.max(...line.filter((value) => value != null).map(Math.abs)))')
    assert lines == pytest.approx([2.5, 2.5], rel=1e-3)


@pytest.mark.parametrize('width', [320, 390, 768, 3840])
def test_no_width_scrolls_sideways(open_page, served, width):
    page = open_page(served, viewport={'width': width, 'height': 800})
    page.until('dzRos.app.stores[0]?.count === 4001')
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    assert page.evaluate('document.querySelector("#figure-error canvas").clientWidth') > 0.3 * min(
        width, 600)


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_no_serious_finding_on_accessibility_of_a_recorded_run(open_page, served, axe, scheme):
    page = open_page(served, color_scheme=scheme)
    page.until('dzRos.app.stores[0]?.count === 4001')
    assert axe(page) == []


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_a_report_on_a_phone_cuts_nothing_off_and_follows_the_theme(
        open_page, recorded, axe, tmp_path, scheme):
    path = write_report(recorded[2], tmp_path / 'report')
    page = open_page(path.as_uri(), color_scheme=scheme, viewport={'width': 400, 'height': 800})
    for summary in page.locator('summary').all():
        summary.click()
    assert page.evaluate('document.documentElement.scrollWidth') <= 400
    assert page.evaluate(BEYOND) == []
    assert page.evaluate(TEXT_WIDER_THAN_ITS_BOX) == []
    image = page.locator('#tracking img')
    inverted = image.evaluate('(item) => getComputedStyle(item).filter')
    assert ('invert' in inverted) == (scheme == 'dark')
    image.click()       # enlarged, and it scrolls inside its frame
    assert image.evaluate('(item) => item.clientWidth') > 1000
    assert page.evaluate('document.documentElement.scrollWidth') <= 400
    image.click()
    assert page.evaluate(BEYOND) == []
    assert axe(page) == []
