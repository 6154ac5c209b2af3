// SPDX-License-Identifier: Apache-2.0
// A recorded run: where one is in it, and playing it at its own pace.

import {seconds} from './words.js';

const WAIT = 120;       // ms without a move until the rows of what is seen are asked for

export class Scrub {
  constructor(page, view, link, loaded) {
    this.page = page;
    this.view = view;
    this.link = link;
    this.loaded = loaded;
    this.playing = false;
    this.timer = 0;
    page['scrub-at'].addEventListener('input', () => {
      const [first, last] = view.limits;
      const end = first + Number(page['scrub-at'].value) * (last - first);
      view.set({follow: false, end, span: view.length});
    });
    page.play.addEventListener('click', () => this.play(!this.playing));
  }

  show(stores) {
    this.stores = stores;
    this.page.scrub.hidden = !stores.length;
  }

  play(on) {
    this.playing = on;
    this.page.play.textContent = on ? 'Stop' : 'Play';
    this.page.play.setAttribute('aria-pressed', String(on));
    const [first, last] = this.view.limits;
    if (on && this.view.end >= last) this.view.set({end: first, follow: false,
                                                    span: this.view.length});
    this.at = performance.now();
  }

  // Move on where it plays.
  step() {
    if (!this.playing) return;
    const now = performance.now();
    const last = this.view.limits[1];
    const end = Math.min(this.view.end + (now - this.at) / 1e3, last);
    this.at = now;
    this.view.set({follow: false, end, span: this.view.length});
    if (end >= last) this.play(false);
  }

  // Follow another window of the view.
  moved() {
    const [first, last] = this.view.limits;
    const share = (this.view.end - first) / (last - first || 1);
    const slider = this.page['scrub-at'];
    slider.value = String(Math.min(Math.max(share, 0), 1));
    const text = `${seconds(this.view.end)} of ${seconds(last)}`;
    slider.setAttribute('aria-valuetext', text);
    this.page['scrub-time'].textContent = text;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.fetch(), WAIT);
  }

  async fetch() {
    const [from, to] = this.view.window;
    const margin = 0.5 * (to - from);
    for (const [run, store] of (this.stores || []).entries()) {
      if (store.whole) continue;
      if (run === 0 && (store.counted?.from !== from || store.counted.to !== to)) {
        const times = await this.link.ask('histogram', {run, from, to});
        if (times.ok) store.counted = {from, to, ...times.histogram};
      }
      if (store.detail && store.detail.from <= from && store.detail.to >= to) continue;
      const answer = await this.link.ask('rows', {run, from: from - margin, to: to + margin});
      if (answer.ok) this.loaded(store, answer, from - margin, to + margin);
    }
  }
}
