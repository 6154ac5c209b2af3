"""What the page says when its server hangs, is slow or has nothing: in a real browser, no loop."""

import pytest

from dz_ros.live import viewer as viewer_module
from dz_ros.live.clock import clock

pytest.importorskip('aiohttp', reason='aiohttp is not installed: no page to serve')
pytest.importorskip('playwright', reason='playwright is not installed')
pytestmark = pytest.mark.live

WORD = "document.querySelector('#state-word').innerText"
BUTTONS = "[...document.querySelectorAll('.panels button')]"


def live(page):
    page.until("document.body.dataset.state === 'live'")
    page.until(f'{BUTTONS}.every((button) => !button.disabled)')


def test_an_estop_that_is_not_answered_says_so_and_is_asked_again(open_page, loopless):
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
    page.until(f"{WORD} === 'NO WORD FROM THE SERVER'")
    page.until(f'{BUTTONS}.every((button) => button.disabled)')
    assert page.is_enabled('#estop')
    loopless.thaw()
    page.until("document.querySelector('#alarm').hidden")
    assert loopless.source.stopped
    assert page.inner_text('#answer') == 'stopped'
    live(page)


def test_what_was_asked_before_the_server_hung_is_not_done_after_it(open_page, loopless):
    page = open_page(loopless.address)
    live(page)
    loopless.freeze()
    page.click('#reset')        # the page cannot know yet
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
    page.focus('#kick-size')            # a field keeps its keys
    page.evaluate('dzRos.view.live()')
    page.keyboard.press('ArrowLeft')
    page.keyboard.press('-')
    assert page.evaluate('dzRos.view.follow')
    assert '-' in page.input_value('#kick-size')
    page.focus('#reset')                # and a button its Space
    page.keyboard.press(' ')
    assert page.evaluate('dzRos.view.follow')
    page.focus('#events')
    page.keyboard.press(' ')
    assert not page.evaluate('dzRos.view.follow')
    page.until("document.querySelector('#answer').innerText === 'done'")
