# SPDX-License-Identifier: Apache-2.0
"""Take the pictures of the live page for README.md and docs/: a loop whose dead-zone changes.

    python tools/live_pictures.py [--out DIR]

Runs a recorded loop with its page, changes the dead-zone and disturbs the plant through the page,
and photographs it in a headless chromium: as a film, as a desk sees it, light, and a phone, dark;
then the recording, laid over another run. Needs the extras `ros` and `test`, and chromium.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import io
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
CHROMIUM = next((found for name in ('chromium', 'chromium-browser', 'google-chrome')
                 if (found := shutil.which(name))), '')
TIME_OUT = 120.0
FILM, FRAME = 7.0, 0.2
"""Length of the film, and between two frames [s]."""


@contextlib.contextmanager
def served(*words: str) -> Iterator[str]:
    """Run `dz` with these words; yield the address of the page it prints."""
    process = subprocess.Popen(
        [sys.executable, '-m', 'dz_ros', *words], cwd=ROOT, stdout=subprocess.PIPE, text=True,
        env={'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **os.environ})
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if 'http://' in line:
                yield next(word for word in line.split() if word.startswith('http://'))
                break
        else:
            sys.exit('no page was served')
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=TIME_OUT)


def until(page: Any, expression: str) -> None:
    """Wait until an expression is true in the page."""
    for _ in range(round(TIME_OUT / 0.05)):
        if page.evaluate(f'() => ({expression})'):
            return
        page.wait_for_timeout(50)
    sys.exit(f'never true in the page: {expression}; it says {page.inner_text("#state")}')


def film(page: Any, start: float, path: Path) -> None:
    """Film the page as it looks back on some seconds, frame by frame, as WebP.

    It is paused and moved on by the time between two frames, so that no frame is missing on a
    machine that draws slowly.
    """
    from PIL import Image

    page.set_viewport_size({'width': 1180, 'height': 700})
    page.add_style_tag(content="""#nodes-panel, #figure-parts, #figure-estimates, #figure-interval,
        #figure-round_trip { display: none; }""")
    page.click('#pause')
    page.select_option('#span', '5')
    frames = []
    for number in range(round(FILM / FRAME)):
        end = start + number * FRAME
        page.evaluate('(end) => dzRos.view.set({follow: false, span: 5, end, cursor: end})', end)
        page.wait_for_timeout(150)
        until(page, '!dzRos.app.dirty')
        frames.append(Image.open(io.BytesIO(page.screenshot())).convert('RGB').resize(
            (885, 525), Image.Resampling.LANCZOS))
    spans = [round(1e3 * FRAME)] * len(frames)
    spans[-1] += 1500
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=spans, loop=0,
                   quality=60, method=4)


def live(browser: Any, address: str, out: Path) -> None:
    """Photograph a running loop, then film what has happened."""
    page = browser.new_page(viewport={'width': 1600, 'height': 1060}, bypass_csp=True)
    page.goto(address)
    until(page, 'dzRos.app.stores[0]?.last > 9')
    page.fill('input[name="plant.dead_zone.b_r"]', '0.2')
    page.fill('input[name="plant.dead_zone.b_l"]', '-0.15')
    page.click('#section-plant button[type=submit]')
    changed = page.evaluate('dzRos.app.stores[0].last')
    until(page, f'dzRos.app.stores[0].last > {changed + 3.0}')
    page.click('#pulse button')
    until(page, f'dzRos.app.stores[0].last > {changed + 6.0}')
    page.evaluate('scrollTo(0, 0)')
    page.wait_for_timeout(300)
    until(page, "document.body.dataset.state === 'live'")
    page.screenshot(path=out / 'live_light.png')
    page.emulate_media(color_scheme='dark')
    page.set_viewport_size({'width': 390, 'height': 844})
    page.wait_for_timeout(600)
    until(page, "document.body.dataset.state === 'live'")
    page.screenshot(path=out / 'live_phone.png')
    page.emulate_media(color_scheme='light')
    film(page, changed - 1.0, out / 'live_dead_zone.webp')
    page.close()


def recorded(browser: Any, address: str, out: Path) -> None:
    """Photograph two runs laid over each other."""
    page = browser.new_page(viewport={'width': 1600, 'height': 900})
    page.goto(address)
    until(page, 'dzRos.app.stores[1]?.count > 100')
    page.evaluate('dzRos.view.look(0, 6)')
    box = page.locator('#figure-tracking .u-over').bounding_box()
    page.mouse.move(box['x'] + 0.4 * box['width'], box['y'] + 20)
    page.wait_for_timeout(600)
    page.screenshot(path=out / 'live_runs.png')
    page.close()


def main() -> int:
    """Take them all."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--out', type=Path, default=ROOT / 'docs' / 'images')
    out = parser.parse_args().out
    if not CHROMIUM:
        sys.exit('no chromium here: apt-get install chromium')
    from playwright.sync_api import sync_playwright

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        arguments = ['--no-sandbox'] if os.geteuid() == 0 else []
        # It draws without a graphics card, and must not take the time from the loop it shows.
        behind = folder / 'chromium'
        behind.write_text(f'#!/bin/sh\nexec nice -n 15 {CHROMIUM} "$@"\n', encoding='utf-8')
        behind.chmod(0o755)
        browser = driver.chromium.launch(executable_path=behind, args=arguments)
        with served('run', 'robust', '--duration', '300', '--quiet', '--live', '--set',
                    'process.priority=20', '--record', str(folder / 'robust')) as address:
            live(browser, address, out)
        subprocess.run([sys.executable, '-m', 'dz_ros', 'simulate', 'wang2004', '--record',
                        str(folder / 'wang2004')], cwd=ROOT, check=True,
                       stdout=subprocess.DEVNULL)
        with served('report', str(folder / 'robust'), '--serve', '--over',
                    str(folder / 'wang2004')) as address:
            recorded(browser, address, out)
        browser.close()
    for path in sorted(out.glob('live_*.*')):
        print(path)
    return 0


if __name__ == '__main__':
    sys.exit(main())
