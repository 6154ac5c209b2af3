// SPDX-License-Identifier: Apache-2.0
// The numbers that are read from two metres, and the loop's condition.

import {make, number, seconds, withUnit} from './words.js';

const OLD = 1;          // s by which what is seen may be behind the server
const STATUS_PERIOD = 0.2;      // s between two status messages of the server
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

  show(store, time, from, to, fresh) {
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
    const layer = Math.abs(value('s_over_epsilon'));     // none while the law is not active
    this.mark('layer', Number.isNaN(layer) ? '' : layer > 1 ? 'warn' : 'good');
  }

  set(name, text, mood = '') {
    this.tiles[name].textContent = text;
    this.mark(name, mood);
  }

  mark(name, mood) { this.tiles[name].parentElement.dataset.mood = mood; }
}

// The loop's condition as [state, word, reason, whether an action can reach it]. Data that is old or
// missing is never called live; a planned end is an end, not an error.
export function condition({link, hello, status, rowsAt, stores, view, finished, commissioning}) {
  const now = performance.now();
  const ended = finished && hello?.mode === 'live'
    ? (why, usable = false) => ['ended', 'LOOP ENDED', why, usable] : null;
  if (!hello || !link.open) {
    return ended?.('the server has ended') || ['off', 'NOT CONNECTED',
                                               link.reason || 'trying again every second', false];
  }
  if (hello.mode === 'run' || hello.mode === 'axes') {
    return ['recorded', 'RECORDED', hello.runs.length > 1 ? 'two runs' : '', false];
  }
  if (link.silent) {
    return ended?.('the server is silent') || [
      'gone', 'NO MESSAGE FROM THE SERVER', `for ${((now - link.received) / 1e3).toFixed(1)} s`,
      false];
  }
  const runs = status && status.age !== null
    && status.age < Math.max(FRESH, 5 / (hello.rate || 200));
  const steps = commissioning.condition(status, runs);
  if (steps) return steps;
  if (!status || status.age === null) {
    return ['waiting', 'WAITING FOR A LOOP', hello.namespace, true];
  }
  const statusAge = link.time - status.time;     // age of the newest status
  const there = status.nodes.some((node) => !node.gone);
  if (statusAge > OLD) {
    const why = `the status is ${statusAge.toFixed(1)} s old`;
    return ended?.(why) || ['gone', 'OLD DATA', why, false];
  }
  // Until the next status is due the loop ages; a page or a network that stalls is not its silence.
  const age = status.age + Math.min(statusAge, STATUS_PERIOD);
  if (age > Math.max(FRESH, 5 / (hello.rate || 200))) {
    const ago = `last data ${(status.age + statusAge).toFixed(1)} s ago`;
    return ended?.(ago, there) || ['gone', 'LOOP GONE', ago, there];
  }
  const shown = link.time - rowsAt;
  const behind = hello.timing === 'lockstep' || !stores[0]?.count ? 0
    : age + status.stamp - stores[0].last;
  const old = Math.max(shown, behind);
  if (!(old <= Math.max(OLD, 5 / (hello.rate || 200)))) {
    return ended?.('') || ['gone', 'OLD DATA', Number.isFinite(old) ? `the plots are ${old.toFixed(1)} s behind`
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
