// SPDX-License-Identifier: Apache-2.0
// The page: what comes in is kept in stores, what is looked at is drawn, as often as it can be.

import {Actions} from './actions.js';
import {Commissioning} from './commissioning.js';
import {csv, png} from './exports.js';
import {Histogram} from './histograms.js';
import {Link} from './link.js';
import {Events, Nodes} from './nodes.js';
import {Parameters} from './parameters.js';
import {Plots} from './plots.js';
import {condition, Tiles} from './readout.js';
import {Scrub} from './scrub.js';
import {RunStore, Store} from './store.js';
import {address, showSummary} from './summary.js';
import * as theme from './theme_switch.js';
import {keys, View} from './view.js';
import {seconds} from './words.js';

const FRAME = 50, SLOWEST = 250;     // ms between two drawings, however dear one is
const WORDS = 100;      // ms between two writings of numbers
const page = Object.fromEntries([...document.querySelectorAll('[id]')].map((node) => [node.id, node]));

const app = {
  link: null, hello: null, status: null, rowsAt: NaN, stores: [], plots: null, bars: [],
  tiles: null, finished: false, dirty: true, cost: 0, writtenAt: 0,
};
const view = new View((what) => {
  app.dirty = true;
  if (what === 'window') app.scrub?.moved();
  if (what === 'cursor') app.writtenAt = 0;
});
const nodes = new Nodes(page.nodes, page.recording);
const events = new Events(page.events);

function hello(message) {
  app.hello = message;
  app.finished = false;
  app.status = null;
  app.rowsAt = NaN;
  document.title = `${message.title} – dz_ros`;
  document.body.dataset.mode = message.mode;
  page.title.textContent = message.title;
  page.summary.hidden = message.mode !== 'axes';
  if (message.mode === 'axes') {
    showAll(message);
    return;
  }
  page.place.textContent = message.mode === 'run' ? message.runs.join('  ·  ')
    : `namespace ${message.namespace}, kept for ${message.minutes} min`;
  showAxes(message);
  events.clear();
  app.actions.allow(message);
  app.parameters.show(message, message.mode === 'live');
  const rate = message.rate || 200;
  app.stores = message.mode === 'run'
    ? message.runs.map((name) => new RunStore(message.columns, name))
    : [new Store(message.columns, Math.ceil(message.minutes * 60 * rate))];
  page.plots.replaceChildren();
  app.plots = new Plots(page.plots, message, view, () => events.marks(),
                        () => { app.dirty = true; });
  app.bars = [new Histogram(page.plots, 'interval', 'Period', 'interval', 1 / rate, 1 / rate),
              new Histogram(page.plots, 'round_trip', 'Round trip', 'round_trip', 0, 1 / rate)];
  app.tiles = new Tiles(page.tiles, {...message, units: app.stores[0].units});
  app.scrub.show(message.mode === 'run' ? app.stores : []);
  if (message.mode === 'run') load();
  else view.live();
}

// The summary of recorded runs of several axes, in place of everything that is about one.
function showAll(message) {
  page.place.textContent = `axes ${message.axes.join(', ')}`;
  page.skip.href = '#summary';
  page.skip.textContent = 'Skip to the summary';
  app.actions.allow(message);
  app.stores = [];
  app.plots = null;
  app.tiles = null;
  showSummary(page.summary, message);
}

// The axes of a loop of several. The one of a running loop is the same for all viewers of this
// server; of recorded runs each has an address of its own.
function showAxes(message) {
  const names = message.axes || [];
  page['axis-choice'].hidden = names.length < 2;
  page['all-axes'].hidden = names.length < 2 || message.mode !== 'run';
  page.axis.replaceChildren(...names.map((name) => new Option(name, name)));
  page.axis.value = message.axis || '';
}

async function chooseAxis() {
  if (app.hello.mode === 'run') {
    location.assign(address(page.axis.value));
    return;
  }
  const answer = await app.link.ask('axis', {axis: page.axis.value});
  if (!answer.ok) page.axis.value = app.hello.axis;
}

async function load() {
  for (const [run, store] of app.stores.entries()) {
    const answer = await app.link.ask('rows', {run});
    if (answer.ok && answer.values) {
      store.fill(answer.values, answer.count);
      store.whole = app.hello.lengths[run] === answer.count;
    }
  }
  const first = Math.min(...app.stores.map((store) => store.first));
  const last = Math.max(...app.stores.map((store) => store.last));
  view.reach(first, last);
  page.span.value = '0';
  view.set({follow: false, span: last - first, end: last});
}

function detail(store, answer, from, to) {
  const held = new Store(store.columns, answer.count);
  held.append(answer.values, answer.count);
  store.detail = Object.assign(held, {from, to});
  app.dirty = true;
  barsAt = 0;
}

function rows(frame) {
  if (!app.stores.length || frame.number !== app.hello.generation) return;
  app.stores[0].append(frame.values, frame.count);
  app.rowsAt = frame.time;
  view.reach(app.stores[0].first, app.stores[0].last);
  app.dirty = true;
}

function facts(message) {
  Object.assign(app.hello, message);
  page.title.textContent = message.title;
  app.parameters.show(app.hello, app.hello.mode === 'live');
  app.actions.allow(app.hello);
  if (app.plots) app.plots.hello = app.hello;
}

function happened(event) {
  events.add(event);
  if (event.event === 'finished') app.finished = true;
  if (event.event === 'started') app.finished = false;
  app.dirty = true;
}

// A frame is asked for only when one is due: each costs the browser more than what is drawn.
function frame(now) {
  const begun = performance.now();
  app.scrub.step();
  const draws = app.dirty && app.plots;
  if (draws) {
    app.dirty = false;
    app.plots.draw(app.stores);
  }
  if (now - app.writtenAt > WORDS) {
    app.writtenAt = now;
    words();
  }
  setTimeout(() => {      // after what the plots and the browser put off until now
    if (draws) app.cost = performance.now() - begun;
    setTimeout(() => requestAnimationFrame(frame), Math.min(Math.max(FRAME, 3 * app.cost), SLOWEST));
  });
}

let barsAt = 0;

function words() {
  const [state, word, why, usable] = condition({...app, view});
  const fresh = ['live', 'paused', 'recorded', 'fault', 'waiting', 'ended'].includes(state);
  if (document.body.dataset.state !== state) document.body.dataset.state = state;
  if (page['state-word'].textContent !== word) page['state-word'].textContent = word;
  if (page['state-why'].textContent !== why) page['state-why'].textContent = why;
  app.actions.use(usable, usable ? '' : word);
  app.commissioning.enable();
  page.pause.textContent = view.follow ? 'Pause' : 'Resume';
  page.pause.setAttribute('aria-pressed', String(!view.follow));
  if (!app.tiles) return;
  const silent = state === 'off' || app.link.silent;
  nodes.show(app.status, silent);
  const [from, to] = view.window;
  app.tiles.show(app.stores[0], view.cursor, from, to, fresh);
  app.plots.showValues(fresh || view.cursor !== null ? app.stores : [], view.cursor);
  page['cursor-time'].textContent = view.cursor === null ? '–' : seconds(view.cursor, 3);
  const record = fresh && app.status?.recording;
  app.tiles.set('recording', !fresh ? '–' : record ? `${record['size [MB]'] ?? '?'} MB` : 'off',
                 record ? 'good' : '');
  if (performance.now() - barsAt > 500) {
    barsAt = performance.now();
    for (const bars of app.bars) bars.draw(app.stores[0], from, to);
    app.tiles.set('period', fresh ? app.bars[0].words.textContent.match(/p99 ([\d.]+)/)?.[1]
      ?.concat(' ms') ?? '–' : '–');
  }
}

function step(by) {
  const store = app.stores[0];
  if (!store?.count) return;
  const [from, to] = view.window;
  const held = store.over(from, to);
  const place = held.nearest(view.cursor ?? to) + by;
  const time = held.data.stamp[Math.min(Math.max(place, 0), held.count - 1)];
  view.point(time);
  app.plots.point(time);
}

function wire() {
  page.pause.addEventListener('click', () => (view.follow ? view.pause() : view.live()));
  page['to-live'].addEventListener('click', () => {
    if (app.hello?.mode === 'run') view.set({end: view.limits[1]});
    else view.live();
  });
  page.span.addEventListener('change', () => view.set({span: Number(page.span.value)}));
  page.axis.addEventListener('change', chooseAxis);
  page['zoom-in'].addEventListener('click', () => view.zoom(0.5));
  page['zoom-out'].addEventListener('click', () => view.zoom(2));
  page.back.addEventListener('click', () => view.pan(-0.5));
  page.forth.addEventListener('click', () => view.pan(0.5));
  page.png.addEventListener('click', () => png(app.hello.title, ...view.window));
  page.csv.addEventListener('click', () => csv(app.stores, app.hello.title, ...view.window,
                                               app.link));
  const move = keys(view, step);
  window.addEventListener('keydown', (event) => { if (app.hello?.mode !== 'axes') move(event); });
  theme.start(() => { app.plots?.redraw(); app.dirty = true; barsAt = 0; });
}

app.link = new Link({
  hello, facts, rows, event: happened, events: (message) => message.events.forEach(happened),
  status: (message) => { app.status = message; app.commissioning.status(message); },
  commissioning: (message) => app.commissioning.show(message),
  moves: (message) => app.commissioning.moved(message.text),
});
app.actions = new Actions(app.link, page);
app.commissioning = new Commissioning(page, app.actions);
app.parameters = new Parameters(page.parameters, app.actions);
app.scrub = new Scrub(page, view, app.link, detail);
wire();
requestAnimationFrame(frame);
window.dzRos = {app, view};     // for the browser's developer tools
