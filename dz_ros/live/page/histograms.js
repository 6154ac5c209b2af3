// How long things took: bars of counts on a logarithmic axis, the late ones in another colour.

import {colour} from './theme.js';
import {make} from './words.js';

const BINS = 48;
const LATE = 0.001;     // s beyond the period: what counts as late everywhere in dz_ros

export class Histogram {
  constructor(place, id, title, name, middle) {
    this.name = name;
    this.middle = middle;       // period: bars are of its neighbourhood; null: from 0
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
    const held = store.over(from, to);
    const column = held.data[this.name];
    const values = [];
    for (let row = held.at(from), end = held.at(to); column && row < end; row += 1) {
      const value = column[row];
      if (value > 0) values.push(value);
    }
    this.paint(values);
  }

  paint(values) {
    const {canvas, middle} = this;
    const ratio = devicePixelRatio;
    const width = canvas.width = Math.max(canvas.clientWidth, 10) * ratio;
    const height = canvas.height = Math.max(canvas.clientHeight, 10) * ratio;
    const ctx = canvas.getContext('2d');
    ctx.clearRect(0, 0, width, height);
    if (!values.length) {
      this.words.textContent = 'no times in this span';
      return;
    }
    values.sort((one, other) => one - other);
    const at = (share) => values[Math.min(values.length - 1, Math.floor(share * values.length))];
    const late = middle === null ? 0
      : values.length - values.findLastIndex((value) => value <= middle + LATE) - 1;
    const most = values[values.length - 1];
    this.words.textContent = `p50 ${ms(at(0.5))}, p99 ${ms(at(0.99))}, max ${ms(most)}`
      + (middle === null ? '' : `; ${late} of ${values.length} late`);
    this.canvas.setAttribute('aria-label', `${this.name}: ${this.words.textContent} ms`);
    const low = middle === null ? 0 : Math.max(0, middle - 2 * LATE);
    const high = middle === null ? Math.max(1.15 * at(0.99), 1e-6)
      : Math.max(middle + 2 * LATE, 0);
    const counts = new Array(BINS).fill(0);
    for (const value of values) {
      const bin = Math.floor((value - low) / (high - low) * BINS);
      counts[Math.min(Math.max(bin, 0), BINS - 1)] += 1;
    }
    const rem = ratio * (parseFloat(getComputedStyle(document.documentElement).fontSize) || 16);
    const pad = {left: 8 * ratio, right: 8 * ratio, bottom: 1.4 * rem, top: 4 * ratio};
    const span = width - pad.left - pad.right;
    const tall = height - pad.top - pad.bottom;
    const top = Math.log10(1 + Math.max(...counts));
    counts.forEach((count, bin) => {
      const value = low + (bin + 0.5) / BINS * (high - low);
      ctx.fillStyle = colour(middle !== null && value > middle + LATE ? '--red' : '--blue');
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
