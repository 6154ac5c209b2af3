// SPDX-License-Identifier: Apache-2.0
// The plots over time: content, drawing, values beside the names.

import uPlot from './vendor/uPlot.esm.js';
import {frames} from './frames.js';
import {band, marks, reach, rules, stack} from './painters.js';
import {colour} from './theme_switch.js';
import {make, withUnit, word} from './words.js';

const PART_TINTS = ['--blue', '--green', '--yellow', '--red', '--purple', '--sky'];
const TINTS = ['--blue', '--red', '--green', '--yellow', '--purple', '--sky'];
const DASHED = [6, 4];
const OTHER = {'--blue': '--purple', '--red': '--grey', '--green': '--sky', '--yellow': '--grey'};

// What can be shown, given the columns that there are.
export function catalogue(hello) {
  const there = new Set(hello.columns.map((column) => column.name));
  const line = (name, tint, more = {}) => ({name, tint, ...more});
  const named = (role) => hello.columns.filter((column) => column.role === role)
    .map((column) => column.name);
  const estimates = named('estimate');
  return [
    {id: 'tracking', title: 'Output and reference', unit: 'x0',
     lines: [line('xd0', '--red', {dash: DASHED}), line('x0', '--blue', {wide: true})]},
    {id: 'error', title: 'Tracking error in Ω_ε', unit: 'error',
     lines: [line('error', '--blue', {wide: true})],
     bands: [{low: 'omega', high: 'omega', mirror: true, tint: '--green', label: 'Ω_ε'}]},
    {id: 'command', title: hello.simulated ? 'Command and dead-zone' : 'Command', unit: 'v',
     lines: [line('w', '--red'), line('v', '--blue', {wide: true})],
     bands: [{low: 'band_low', high: 'band_high', tint: '--yellow',
              label: 'dead-zone the estimates allow'},
             {low: 'zone_low', high: 'zone_high', tint: '--purple', dash: [3, 3],
              label: 'true dead-zone'}]},
    {id: 'layer', title: 'Boundary layer', unit: 's_over_epsilon',
     lines: [line('s_over_epsilon', '--blue', {wide: true})], rules: [-1, 1],
     rulesLabel: '±1'},
    {id: 'parts', title: 'Parts of the command, stacked', unit: 'v',
     lines: [line('v', '--ink', {wide: true})],
     stack: named('term of v').map(
       (name, at) => ({name, tint: PART_TINTS[at % PART_TINTS.length]}))},
    {id: 'estimates', title: 'Estimates and their bounds', unit: null,
     lines: estimates.map((name, at) => line(name, TINTS[at % TINTS.length], {wide: true})),
     bounds: estimates},
  ].map((plot) => ({...plot, lines: plot.lines.filter((item) => there.has(item.name)),
                    bands: (plot.bands || []).filter((item) => there.has(item.low))}))
    .filter((plot) => plot.lines.length);
}

export class Plots {
  constructor(place, hello, view, events, changed) {
    this.changed = changed;     // called when a plot has to be drawn again
    this.hello = hello;
    this.view = view;
    this.events = events;       // () → [{stamp, tint}]
    this.period = 1 / (hello.rate || 200);
    this.units = Object.fromEntries(hello.columns.map((column) => [column.name, column.unit]));
    this.labels = Object.fromEntries(hello.columns.map((column) => [column.name, column.label]));
    this.names = new Set();
    this.sync = uPlot.sync('dz_ros');
    this.runs = hello.runs || [''];
    this.shown = catalogue(hello).map((plot) => this.build(place, plot));
  }

  build(place, plot) {
    const unit = plot.unit ? this.units[plot.unit] : '';
    const canvas = make('div', {class: 'canvas'});
    const legend = make('ul', {class: 'legend'});
    const heading = make('h2', {id: `plot-${plot.id}`}, plot.title);
    if (unit) heading.append(make('small', {}, ` [${unit}]`));
    const figure = make('section', {class: 'plot', id: `figure-${plot.id}`},
                        make('div', {class: 'caption'}, heading, legend), canvas);
    figure.setAttribute('aria-labelledby', `plot-${plot.id}`);
    place.append(figure);
    const shown = {plot, unit, figure, canvas, legend, values: [], y: null};
    const series = [{}];
    for (const [run, name] of this.runs.entries()) {
      for (const item of plot.lines) {
        if (run && plot.stack) continue;
        const tint = run ? OTHER[item.tint] || '--grey' : item.tint;
        series.push({stroke: () => colour(tint), width: item.wide ? 1.8 : 1.2,
                     dash: run ? [3, 3] : item.dash, points: {show: false}, spanGaps: false});
        this.legendItem(shown, item.name, tint, run, name, item.dash);
      }
    }
    for (const item of plot.stack || []) this.legendItem(shown, item.name, item.tint, 0, '', 'fill');
    for (const item of plot.bands) this.legendBand(shown, item.label, item.tint);
    if (plot.rulesLabel) this.legendBand(shown, plot.rulesLabel, '--green');
    if (plot.bounds?.some((name) => this.hello.bounds[name])) {
      this.legendBand(shown, 'bounds', '--grey');
    }
    for (const item of [...plot.lines, ...(plot.stack || [])]) this.names.add(item.name);
    for (const item of plot.bands) { this.names.add(item.low); this.names.add(item.high); }
    shown.series = series;
    this.chart(shown);
    new ResizeObserver(() => this.fit(shown)).observe(canvas);
    return shown;
  }

  chart(shown) {
    shown.chart?.destroy();
    shown.font = this.font();
    shown.chart = new uPlot(this.options(shown, shown.series.map((item) => ({...item}))),
                            [[], ...shown.series.slice(1).map(() => [])], shown.canvas);
  }

  legendItem(shown, name, tint, run, runName, dash) {
    const value = make('b', {}, '–');
    const swatch = make('i', {class: `swatch${run ? ' dotted' : ''}${
      dash === 'fill' ? ' fill' : dash ? ' dashed' : ''}`});
    swatch.style.color = `var(${tint})`;
    const title = word(this.labels[name] || name);
    const label = run ? `${title} (${runName})` : title;
    shown.legend.append(make('li', {}, swatch, make('span', {}, label), ' ', value));
    shown.values.push({name, run, value});
  }

  legendBand(shown, label, tint) {
    const swatch = make('i', {class: 'swatch band'});
    swatch.style.color = `var(${tint})`;
    shown.legend.append(make('li', {}, swatch, make('span', {}, label)));
  }

  options(shown, series) {
    const rem = parseFloat(getComputedStyle(document.documentElement).fontSize) || 16;
    const axis = (more) => ({stroke: () => colour('--dim'), font: this.font(),
                             grid: {stroke: () => colour('--grid'), width: 1},
                             ticks: {stroke: () => colour('--grid'), width: 1, size: 4}, ...more});
    return {
      ...this.size(shown), legend: {show: false}, series,
      scales: {x: {time: false, range: () => this.view.window},
               y: {range: () => shown.y || [-1, 1]}},
      axes: [axis({size: 1.75 * rem, values: (u, ticks) => ticks.map((tick) => tick.toString())}),
             axis({size: 3.6 * rem})],
      cursor: {sync: {key: 'dz_ros', scales: ['x', null], setSeries: false}, y: false,
               points: {show: false}, drag: {x: true, y: false, setScale: false, dist: 6},
               bind: {dblclick: () => () => { this.view.live(); return null; }}},
      hooks: {
        drawAxes: [(u) => this.under(u, shown)],
        draw: [(u) => marks(u, this.events())],
        setCursor: [(u) => {
          if (u.cursor.event) {
            this.view.point(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, 'x') : null);
          }
        }],
        setSelect: [(u) => {
          if (u.select.width > 4 && u.cursor.event) {
            this.view.look(u.posToVal(u.select.left, 'x'),
                           u.posToVal(u.select.left + u.select.width, 'x'));
          }
          u.setSelect({left: 0, width: 0, top: 0, height: 0}, false);
        }],
        ready: [(u) => u.over.addEventListener('wheel', (event) => {
          if (!event.ctrlKey && !event.shiftKey) return;
          event.preventDefault();
          this.view.zoom(event.deltaY > 0 ? 1.25 : 0.8, u.posToVal(event.offsetX, 'x'));
        }, {passive: false})],
      },
    };
  }

  font() {
    const size = parseFloat(getComputedStyle(document.documentElement).fontSize) || 16;
    return `${Math.round(0.78 * size)}px system-ui, sans-serif`;
  }

  size(shown) {
    return {width: Math.max(shown.canvas.clientWidth, 120),
            height: Math.max(shown.canvas.clientHeight, 100)};
  }

  fit(shown) {
    if (this.font() !== shown.font) {       // another screen
      this.chart(shown);
      this.changed();
      return;
    }
    const size = this.size(shown);
    if (size.width !== shown.chart.width || size.height !== shown.chart.height) {
      shown.chart.setSize(size);
    }
  }

  under(u, shown) {
    const {plot, lines, x} = shown;
    if (!lines) return;
    if (plot.stack) stack(u, x, plot.stack.map(({name, tint}) => ({y: lines[0][name], tint})));
    for (const item of plot.bands) {
      const high = lines[0][item.high];
      const low = item.mirror ? high?.map((value) => (value ? -value : value))
        : lines[0][item.low];
      band(u, x, low, high, item.tint, item.dash);
    }
    if (plot.rules) rules(u, plot.rules, '--green');
    for (const name of plot.bounds || []) {
      const tint = plot.lines.find((item) => item.name === name)?.tint || '--grey';
      rules(u, this.hello.bounds[name] || [], tint, [2, 5]);
    }
    rules(u, [0], '--grid', []);
  }

  // Draw what the view shows of the stores.
  draw(stores) {
    const [from, to] = this.view.window;
    const pixels = Math.max(...this.shown.map((shown) => shown.chart.width), 200);
    const found = frames(stores, [...this.names], from, to, pixels, this.period);
    for (const shown of this.shown) {
      const data = [found.x];
      stores.forEach((_, run) => {
        for (const item of shown.plot.lines) {
          if (run && shown.plot.stack) continue;
          data.push(found.lines[run][item.name] || new Array(found.x.length));
        }
      });
      shown.lines = found.lines;
      shown.x = found.x;
      shown.y = this.scale(shown, data.slice(1), found);
      shown.chart.setData(data);
    }
  }

  // Return the span of y: it grows at once and shrinks only where much of it is empty.
  scale(shown, data, found) {
    let low = Infinity;
    let high = -Infinity;
    const take = (value) => {
      if (value < low) low = value;
      if (value > high) high = value;
    };
    for (const y of data) for (const value of y) if (value != null) take(value);
    if (shown.plot.stack) reach(shown.plot.stack.map(({name}) => ({y: found.lines[0][name]})),
                                found.x.length).forEach(take);
    for (const item of shown.plot.bands) {
      for (const name of [item.low, item.high]) {
        for (const value of found.lines[0][name] || []) {
          if (value != null) { take(value); if (item.mirror) take(-value); }
        }
      }
    }
    (shown.plot.rules || []).forEach((value) => take(1.15 * value));
    for (const name of shown.plot.bounds || []) (this.hello.bounds[name] || []).forEach(take);
    if (low > high) return [-1, 1];
    const margin = 0.07 * (high - low) || 0.1 * Math.abs(high) || 1;
    const wanted = [low - margin, high + margin];
    const now = shown.y;
    const fits = now && now[0] <= low && now[1] >= high
      && (now[1] - now[0]) < 1.6 * (wanted[1] - wanted[0]);
    return fits ? now : wanted;
  }

  // Write the values at an instant beside the names.
  showValues(stores, time) {
    const places = stores.map((store) => {
      const held = time === null ? store : store.over(time, time);
      return [held, time === null ? held.count - 1 : held.nearest(time)];
    });
    for (const shown of this.shown) {
      for (const {name, run, value} of shown.values) {
        const [store, place] = places[run] || [null, -1];
        value.textContent = store ? withUnit(store.value(name, place), '') : '–';
      }
    }
  }

  // Show the cursor at an instant in every plot.
  point(time) {
    for (const {chart} of this.shown) {
      const left = time === null ? -10 : chart.valToPos(time, 'x');
      chart.setCursor({left, top: 10}, false);
    }
  }

  redraw() { for (const {chart} of this.shown) chart.redraw(false, true); }
}
