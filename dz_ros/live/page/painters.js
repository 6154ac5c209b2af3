// SPDX-License-Identifier: Apache-2.0
// What is painted on a plot besides lines: bands, bounds, stacked parts, marks of events.

import {colour, faded} from './theme_switch.js';

function path(u, points) {
  const {ctx} = u;
  ctx.beginPath();
  points.forEach(([x, y], at) => (at ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
}

function clipped(u, draw) {
  const {ctx, bbox} = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  draw(ctx, bbox);
  ctx.restore();
}

// A filled band between two lines, with its edges; either may have gaps.
export function band(u, x, low, high, tint, dash = []) {
  if (!low || !high) return;
  clipped(u, (ctx) => {
    const tone = colour(tint);
    ctx.lineWidth = devicePixelRatio;
    ctx.setLineDash(dash.map((length) => length * devicePixelRatio));
    let run = [];
    const flush = () => {
      if (run.length > 1) {
        const upper = run.map(([at, , top]) => [at, top]);
        const lower = run.map(([at, bottom]) => [at, bottom]);
        path(u, [...upper, ...lower.slice().reverse()]);
        ctx.fillStyle = faded(tone, 0.13);
        ctx.fill();
        ctx.strokeStyle = faded(tone, 0.85);
        path(u, upper);
        ctx.stroke();
        path(u, lower);
        ctx.stroke();
      }
      run = [];
    };
    for (let at = 0; at < x.length; at += 1) {
      if (low[at] === null || high[at] === null) flush();
      else if (low[at] !== undefined && high[at] !== undefined) {
        run.push([u.valToPos(x[at], 'x', true), u.valToPos(low[at], 'y', true),
                  u.valToPos(high[at], 'y', true)]);
      }
    }
    flush();
  });
}

// Horizontal lines at fixed values.
export function rules(u, values, tint, dash = [6, 4]) {
  clipped(u, (ctx, bbox) => {
    ctx.strokeStyle = faded(colour(tint), 0.85);
    ctx.lineWidth = devicePixelRatio;
    ctx.setLineDash(dash.map((length) => length * devicePixelRatio));
    for (const value of values) {
      const y = u.valToPos(value, 'y', true);
      path(u, [[bbox.left, y], [bbox.left + bbox.width, y]]);
      ctx.stroke();
    }
  });
}

// Parts on top of each other: what pushes up stacks up, what pushes down stacks down.
export function stack(u, x, parts) {
  clipped(u, (ctx) => {
    const up = new Float64Array(x.length);
    const down = new Float64Array(x.length);
    const last = new Float64Array(parts.length);
    const filled = parts.map((part) => {
      const y = part.y;
      return Float64Array.from(x, (_, at) => (y && y[at] !== undefined ? y[at] ?? NaN : NaN));
    });
    filled.forEach((y, number) => {     // a point of another line: as the one before
      for (let at = 0; at < y.length; at += 1) {
        if (Number.isNaN(y[at]) && parts[number].y?.[at] === undefined) y[at] = last[number];
        else last[number] = y[at];
      }
    });
    filled.forEach((y, number) => {
      const lower = [];
      const upper = [];
      for (let at = 0; at < x.length; at += 1) {
        const value = Number.isNaN(y[at]) ? 0 : y[at];
        const base = value >= 0 ? up : down;
        const from = base[at];
        base[at] += value;
        const left = u.valToPos(x[at], 'x', true);
        lower.push([left, u.valToPos(from, 'y', true)]);
        upper.push([left, u.valToPos(base[at], 'y', true)]);
      }
      path(u, [...upper, ...lower.reverse()]);
      ctx.fillStyle = faded(colour(parts[number].tint), 0.75);
      ctx.fill();
    });
  });
}

// The reach of stacked parts, for the axis.
export function reach(parts, length) {
  let low = 0;
  let high = 0;
  for (let at = 0; at < length; at += 1) {
    let up = 0;
    let down = 0;
    for (const {y} of parts) {
      const value = y?.[at] || 0;
      if (value > 0) up += value; else down += value;
    }
    if (up > high) high = up;
    if (down < low) low = down;
  }
  return [low, high];
}

// Instants at which something happened; those that may come often are ticks at the foot.
export function marks(u, found) {
  clipped(u, (ctx, bbox) => {
    ctx.lineWidth = devicePixelRatio;
    const bottom = bbox.top + bbox.height;
    for (const {stamp, tint, mode} of found) {
      const x = u.valToPos(stamp, 'x', true);
      const small = mode === 'lost';
      ctx.strokeStyle = faded(colour(tint), 0.85);
      ctx.setLineDash(small ? [] : [2 * devicePixelRatio, 3 * devicePixelRatio]);
      path(u, [[x, small ? bottom - 7 * devicePixelRatio : bbox.top], [x, bottom]]);
      ctx.stroke();
    }
  });
}
