// SPDX-License-Identifier: Apache-2.0
// The nodes of the loop, the recording, and what has happened.

import {make} from './words.js';

const LEVELS = ['ok', 'warn', 'error', 'stale'];
const SHOWN = ['rate [Hz]', 'period p99 [ms]', 'round trip p99 [ms]', 'state to command p99 [ms]',
               'late by more than 1 ms', 'periods skipped', 'messages lost'];
const MAX_EVENTS = 200;
const NEAR = 6;         // an event equal to one of this number of newest ones is counted, not listed

export class Nodes {
  constructor(list, recording) {
    this.list = list;
    this.recording = recording;
    this.rows = new Map();
  }

  show(status, silent) {
    for (const node of status?.nodes || []) {
      let row = this.rows.get(node.name);
      if (!row) {
        const parts = {lamp: make('span', {class: 'lamp'}), name: make('strong', {}, node.name),
                       mode: make('span', {class: 'mode'}), message: make('p'),
                       values: make('dl')};
        parts.lamp.setAttribute('aria-hidden', 'true');
        row = {parts, item: make('li', {}, make('div', {class: 'node-head'}, parts.lamp,
                                               parts.name, parts.mode),
                                 parts.message, parts.values)};
        this.rows.set(node.name, row);
        this.list.append(row.item);
      }
      const gone = node.gone || silent;
      const {parts} = row;
      row.item.dataset.level = gone ? 'stale' : LEVELS[Math.min(node.level, 3)];
      set(parts.mode, gone ? 'silent' : node.mode || node.values.state || '');
      set(parts.message, gone ? `last message ${node.age.toFixed(0)} s ago`
        : node.reason && node.mode !== 'running' ? node.reason : node.message);
      const values = gone ? [] : SHOWN.filter((name) => name in node.values)
        .map((name) => [name, node.values[name]]);
      const text = JSON.stringify(values);
      if (parts.text !== text) {
        parts.text = text;
        parts.values.replaceChildren(...values.map(([name, value]) => make('div', {},
          make('dt', {}, name), make('dd', {}, value))));
      }
    }
    const record = silent ? null : status?.recording;
    const size = record?.['size [MB]'];
    set(this.recording, record ? `● recording${size === undefined ? '' : ` ${size} MB`}, `
      + `${record['messages stored'] ?? '?'} messages`
      + (Number(record['messages lost']) ? `, ${record['messages lost']} LOST` : '')
      : '○ not recording');
    this.recording.dataset.on = record ? 'yes' : 'no';
  }
}

function set(node, text) { if (node.textContent !== text) node.textContent = text; }

export class Events {
  constructor(list) {
    this.list = list;
    this.clear();
  }

  clear() {
    this.found = [];
    this.lost = [];
    this.stated = new Set();
    this.list.replaceChildren();
  }

  add(event) {
    const [text, tint] = this.read(event);
    // A flickering mode must not push actions out of the list.
    const kept = event.mode === 'lost' ? this.lost : this.found;
    if (tint !== '--grey') kept.push({...event, text, tint});
    if (kept.length > MAX_EVENTS) kept.shift();
    if (event.event === 'configuration' && tint === '--grey' && this.stated.has(event.node)) return;
    this.stated.add(event.node);
    const stamp = `${event.stamp.toFixed(2)} s`;
    const same = [...this.list.children].slice(0, NEAR).find((item) => item.dz.text === text);
    if (same) {         // one line with a count
      same.dz.times += 1;
      same.dz.stamp.textContent = stamp;
      same.dz.count.textContent = ` ×${same.dz.times}`;
      this.list.prepend(same);
      return;
    }
    const dz = {text, times: 1, stamp: make('b', {}, stamp), count: make('span', {})};
    const item = make('li', {}, dz.stamp, ' ', make('span', {}, text), dz.count);
    item.dz = dz;
    item.style.borderColor = `var(${tint})`;
    this.list.prepend(item);
    if (this.list.children.length > MAX_EVENTS) this.list.lastChild.remove();
  }

  marks() {
    return [...this.found, ...this.lost];
  }

  read(event) {
    const node = event.node.split('/').pop();
    if (event.event === 'configuration') {
      const changed = Object.entries(event.changed || {});
      return changed.length ? [`${changed.map(([key, value]) => `${key} = ${
        JSON.stringify(value)}`).join(', ')}`, '--purple']
        : [`${node}: states its configuration`, '--grey'];
    }
    if (event.event === 'mode') {
      const bad = ['fault', 'estop', 'lost'].includes(event.mode);
      return [`${node}: ${event.mode}${event.reason ? `, ${event.reason}` : ''}`,
              bad ? '--red' : '--grey'];
    }
    if (event.event === 'action') {
      const values = event.values ? ` ${Object.entries(event.values).map(([key, value]) =>
        `${key} = ${JSON.stringify(value)}`).join(', ')}` : '';
      return [`${event.by} asked: ${event.action}${values}${event.done ? ''
        : `: refused, ${event.message}`}`, event.done ? '--sky' : '--yellow'];
    }
    return [`${node}: ${event.event}`, '--grey'];
  }
}
