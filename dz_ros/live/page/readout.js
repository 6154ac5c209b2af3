// The numbers that are read from two metres, and the word on how the loop is.

import {make, number, seconds, withUnit} from './words.js';

const OLD = 1;          // s by which what is seen may be behind the server
const WORDS = 0.2;      // s between two words of the server on the loop
const FRESH = 0.5;      // s without a state that still count as live, at fast rates
const BAD = ['fault', 'estop', 'lost'];

export class Tiles {
  constructor(place, hello) {
    const {units} = hello;
    place.replaceChildren();
    this.tiles = {};
    for (const [name, label] of [['time', 't'], ['error', 'x̃'], ['peak', 'max |x̃| in view'],
                                 ['layer', 's/ε'], ['command', 'v'], ['period', 'period p99'],
                                 ['recording', 'recording']]) {
      const value = make('dd', {}, '–');
      place.append(make('div', {class: 'tile', id: `tile-${name}`}, make('dt', {}, label), value));
      this.tiles[name] = value;
    }
    this.unit = hello.unit === '1' ? '' : hello.unit || '';
    this.commandUnit = units?.v || '';
  }

  say(store, time, from, to, fresh) {
    const place = time === null ? store.count - 1 : store.nearest(time);
    const value = (name) => (fresh ? store.value(name, place) : NaN);
    let peak = NaN;
    const error = store.data.error;
    for (let row = store.at(from), end = store.at(to); error && fresh && row < end; row += 1) {
      const size = Math.abs(error[row]);
      if (!(size <= peak)) peak = Number.isNaN(size) ? peak : size;
    }
    this.tiles.time.textContent = fresh ? seconds(store.value('stamp', place)) : '–';
    this.tiles.error.textContent = withUnit(value('error'), this.unit);
    this.tiles.peak.textContent = withUnit(peak, this.unit);
    this.tiles.layer.textContent = number(value('s_over_epsilon'), 3);
    this.tiles.command.textContent = withUnit(value('v'), this.commandUnit, 3);
    const omega = value('omega');
    this.mark('peak', !Number.isNaN(omega) && peak > omega ? 'warn' : 'good');
    this.mark('layer', Math.abs(value('s_over_epsilon')) > 1 ? 'warn' : 'good');
  }

  say2(name, text, mood = '') {
    this.tiles[name].textContent = text;
    this.mark(name, mood);
  }

  mark(name, mood) { this.tiles[name].parentElement.dataset.mood = mood; }
}

// How the loop is, in a word and a reason, and whether anybody could do what is asked of it. What is
// not heard, or heard late, is never called live.
export function condition({link, hello, status, rowsAt, stores, view, finished}) {
  const now = performance.now();
  if (!hello || !link.open) {
    return ['off', 'NOT CONNECTED', link.reason || 'trying again every second', false];
  }
  if (hello.mode === 'run') {
    return ['recorded', 'RECORDED', hello.runs.length > 1 ? 'two runs' : '', false];
  }
  if (link.silent) {
    return ['gone', 'NO WORD FROM THE SERVER', `for ${((now - link.heard) / 1e3).toFixed(1)} s`,
            false];
  }
  if (!status || status.age === null) {
    return ['waiting', 'WAITING FOR A LOOP', hello.namespace, true];
  }
  const told = link.time - status.time;     // how long ago what is said of the loop was sent
  const there = status.nodes.some((node) => !node.gone);
  if (told > OLD) return ['gone', 'OLD DATA', `what is heard is ${told.toFixed(1)} s old`, false];
  // Until the next word is due the loop ages; a page or a network that stalls is not its silence.
  const age = status.age + Math.min(told, WORDS);
  if (age > Math.max(FRESH, 5 / (hello.rate || 200))) {
    return ['gone', finished ? 'LOOP ENDED' : 'LOOP GONE', `last data ${(status.age + told).toFixed(1)} s ago`,
            there];
  }
  const shown = link.time - rowsAt;
  const behind = hello.timing === 'lockstep' || !stores[0]?.count ? 0
    : age + status.stamp - stores[0].last;
  const old = Math.max(shown, behind);
  if (!(old <= Math.max(OLD, 5 / (hello.rate || 200)))) {
    return ['gone', 'OLD DATA', Number.isFinite(old) ? `the plots are ${old.toFixed(1)} s behind`
      : 'no rows have come', false];
  }
  const bad = status.nodes.find((node) => BAD.includes(node.mode) && !node.gone);
  if (bad) return ['fault', bad.mode === 'estop' ? 'E-STOP' : bad.mode.toUpperCase(),
                   `${bad.name}: ${bad.reason}`, true];
  if (status.estop) return ['fault', 'E-STOP', 'pressed', true];
  const rest = status.nodes.find((node) => !node.gone && node.mode === 'waiting');
  if (rest) return ['waiting', 'WAITING', `${rest.name}: ${rest.message}`, true];
  if (!view.follow) return ['paused', 'PAUSED', 'the loop runs on', true];
  const step = hello.timing === 'lockstep' ? ', lockstep' : '';
  return ['live', 'LIVE', `${status.rate.toFixed(0)} Hz${step}`, true];
}
