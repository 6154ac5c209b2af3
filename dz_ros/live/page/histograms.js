// SPDX-License-Identifier: Apache-2.0
// How long things took: bars of counts on a logarithmic axis, the late ones in another colour.

import {colour} from './theme_switch.js';
import {make} from './words.js';

const BINS = 48;
const LATE = 0.001;     // s: what counts as late everywhere in dz_ros

// Counts in bins, quantiles, late ones; the server computes the same for a thinned run.
function counted(values, base, period) {
  const count = values.length;
  if (!count) return {count};
  values.sort((one, other) => one - other);
  const at = (share) => values[Math.min(count - 1, Math.floor(share * count))];
  const beyond = (limit) => count - values.findLastIndex((value) => value <= limit) - 1;
  const low = base ? Math.max(0, base - 2 * LATE) : 0;
  const high = base ? base + 2 * LATE : Math.max(1.15 * at(0.99), 1e-6);
  const bins = new Array(BINS).fill(0);
  for (const value of values) {
    const bin = Math.floor((value - low) / (high - low) * BINS);
    bins[Math.min(Math.max(bin, 0), BINS - 1)] += 1;
  }
  return {count, p50: at(0.5), p99: at(0.99), max: values[count - 1], late: beyond(base + LATE),
          too_late: beyond(base + period), low, high, bins};
}

export class Histogram {
  constructor(place, id, title, name, base, period) {
    this.name = name;
    this.base = base;           // what is beyond it is late: the period, whose neighbourhood is drawn, or 0
    this.period = period;
    this.canvas = make('canvas', {class: 'bars'});
    this.words = make('p', {class: 'bars-words'}, '–');
    const figure = make('section', {class: 'plot small', id: `figure-${id}`},
                        make('div', {class: 'caption'}, make('h2', {id: `plot-${id}`}, title,
                             make('small', {}, ' [ms]')), this.words),
                        make('div', {class: 'canvas'}, this.canvas));
    figure.setAttribute('aria-labelledby', `plot-${id}`);
    this.canvas.setAttribute('role', 'img');
    this.canvas.setAttribute('aria-label', title);
    place.append(figure);
  }

  draw(store, from, to) {
    if (store.whole === false) {        // thinned rows have no counts
      this.paint(store.counted?.from === from && store.counted.to === to
        ? store.counted[this.name] : null);
      return;
    }
    const held = store.over(from, to);
    const column = held.data[this.name];
    const values = [];
    for (let row = held.at(from), end = held.at(to); column && row < end; row += 1) {
      const value = column[row];
      if (value > 0) values.push(value);
    }
    this.paint(counted(values, this.base, this.period));
  }

  paint(found) {
    const {canvas, base} = this;
    const ratio = devicePixelRatio;
    const width = canvas.width = Math.max(canvas.clientWidth, 10) * ratio;
    const height = canvas.height = Math.max(canvas.clientHeight, 10) * ratio;
    const ctx = canvas.getContext('2d');
    ctx.clearRect(0, 0, width, height);
    this.found = found;
    if (!found?.count) {
      this.words.textContent = found ? 'no times in this span' : '…';
      return;
    }
    const {low, high} = found;
    this.words.textContent = `p50 ${ms(found.p50)}, p99 ${ms(found.p99)}, max ${ms(found.max)}; `
      + `of ${found.count} ${found.late} late, ${found.too_late} too late`;
    this.canvas.setAttribute('aria-label', `${this.name}: ${this.words.textContent} ms`);
    const rem = ratio * (parseFloat(getComputedStyle(document.documentElement).fontSize) || 16);
    const pad = {left: 8 * ratio, right: 8 * ratio, bottom: 1.4 * rem, top: 4 * ratio};
    const span = width - pad.left - pad.right;
    const tall = height - pad.top - pad.bottom;
    const top = Math.log10(1 + Math.max(...found.bins));
    found.bins.forEach((count, bin) => {
      const value = low + (bin + 0.5) / BINS * (high - low);
      ctx.fillStyle = colour(value > base + LATE ? '--red' : '--blue');
      const bar = tall * Math.log10(1 + count) / top;
      ctx.fillRect(pad.left + bin * span / BINS, pad.top + tall - bar, span / BINS - ratio, bar);
    });
    ctx.fillStyle = colour('--dim');
    ctx.font = `${0.78 * rem}px system-ui, sans-serif`;
    ctx.textBaseline = 'bottom';
    for (let tick = 0; tick <= 4; tick += 1) {
      ctx.textAlign = ['left', 'center', 'center', 'center', 'right'][tick];
      const edge = tick === 4 || (tick === 0 && low > 0);
      const text = `${edge && tick ? '≥ ' : edge ? '≤ ' : ''}${
        ms(low + tick / 4 * (high - low), 2)}`;
      ctx.fillText(text, pad.left + tick / 4 * span, height - 2 * ratio);
    }
  }
}

function ms(value, places = 3) { return (1e3 * value).toFixed(places); }
