// SPDX-License-Identifier: Apache-2.0
// Rows of one or two stores, as lines that are drawn: at most two points a pixel, no peak lost.
//
// null is a gap in the data, undefined is where this line has no point and another one has.

const GAP = 3.5;        // sample intervals without a row that are drawn as a gap

export function frames(stores, names, from, to, pixels, period) {
  const spans = stores.map((store) => {
    const held = store.over(from, to);
    return {held, first: Math.max(held.at(from) - 1, 0),
            last: Math.min(held.at(to) + 1, held.count)};
  });
  const most = Math.max(...spans.map(({first, last}) => last - first));
  return most <= 2 * pixels ? exact(spans, names, period)
    : thinned(spans, names, from, to, pixels, period);
}

function exact(spans, names, period) {
  const times = new Set();
  for (const {held, first, last} of spans) {
    const {stamp} = held.data;
    for (let row = first; row < last; row += 1) {
      times.add(stamp[row]);
      if (row + 1 < last && stamp[row + 1] - stamp[row] > GAP * period) {
        times.add(0.5 * (stamp[row] + stamp[row + 1]));
      }
    }
  }
  const x = Float64Array.from(times).sort();
  const lines = spans.map(({held, first, last}) => {
    const {stamp} = held.data;
    const found = {};
    for (const name of names) {
      const column = held.data[name];
      if (!column) continue;
      const y = new Array(x.length);
      let row = first;
      for (let at = 0; at < x.length; at += 1) {
        while (row < last && stamp[row] < x[at]) row += 1;
        if (row < last && stamp[row] === x[at]) {
          y[at] = Number.isNaN(column[row]) ? null : column[row];
        } else if (row > first && row < last && stamp[row] - stamp[row - 1] > GAP * period) {
          y[at] = null;
        }
      }
      found[name] = y;
    }
    return found;
  });
  return {x, lines};
}

function thinned(spans, names, from, to, pixels, period) {
  // Buckets stand still while the window moves over them, or the lines would shimmer.
  const width = 2 ** Math.ceil(Math.log2((to - from) / pixels));
  const begin = Math.floor(from / width);
  const count = Math.ceil(to / width) - begin + 1;
  const x = new Float64Array(2 * count);
  for (let bucket = 0; bucket < count; bucket += 1) {
    x[2 * bucket] = (begin + bucket + 0.25) * width;
    x[2 * bucket + 1] = (begin + bucket + 0.75) * width;
  }
  const lines = spans.map(({held, first, last}) => {
    const {stamp} = held.data;
    const places = new Int32Array(count + 1).fill(last);
    let row = first;
    for (let bucket = 0; bucket <= count; bucket += 1) {
      const edge = (begin + bucket) * width;
      while (row < last && stamp[row] < edge) row += 1;
      places[bucket] = row;
    }
    const coarse = last - first > 1 ? (stamp[last - 1] - stamp[first]) / (last - 1 - first) : 0;
    const hole = GAP * Math.max(period, coarse) / width;
    const found = {};
    for (const name of names) {
      const column = held.data[name];
      if (column) found[name] = extremes(column, places, count, hole);
    }
    return found;
  });
  return {x, lines};
}

function extremes(column, places, count, hole) {
  const y = new Array(2 * count);
  let empty = 0;
  for (let bucket = 0; bucket < count; bucket += 1) {
    const first = places[bucket];
    const last = places[bucket + 1];
    if (first === last) {
      empty += 1;
      if (empty > hole) y[2 * bucket] = null;
      continue;
    }
    empty = 0;
    let low = Infinity;
    let high = -Infinity;
    let lowAt = -1;
    let highAt = -1;
    for (let row = first; row < last; row += 1) {
      const value = column[row];
      if (value < low) { low = value; lowAt = row; }
      if (value > high) { high = value; highAt = row; }
    }
    if (lowAt < 0) {
      y[2 * bucket] = null;
    } else if (lowAt <= highAt) {
      y[2 * bucket] = low;
      y[2 * bucket + 1] = high;
    } else {
      y[2 * bucket] = high;
      y[2 * bucket + 1] = low;
    }
  }
  return y;
}
