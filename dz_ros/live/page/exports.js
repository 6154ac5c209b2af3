// SPDX-License-Identifier: Apache-2.0
// What is seen, as a file: the rows of the window as CSV, the plots as one picture.

import {colour} from './theme_switch.js';

function save(name, blob) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function fileName(title, from, to, ending) {
  const safe = title.replace(/[^\w-]+/g, '_').slice(0, 60);
  return `${safe}_${from.toFixed(2)}-${to.toFixed(2)}s.${ending}`;
}

// Every row of the window; those of a run that is not here whole are fetched.
export async function csv(stores, title, from, to, link) {
  for (const [run, store] of stores.entries()) {
    const names = store.names;
    const parts = [`${names.map((name) => (store.units[name] ? `${name} [${store.units[name]}]`
      : name)).join(',')}\n`];
    if (store.whole === false) {
      for (let skip = 0, count = 1; count; skip += count) {
        const answer = await link.ask('rows', {run, from, to, skip});
        if (!answer.ok) {
          alert(`CSV: ${answer.message}`);
          return;
        }
        count = answer.count;
        parts.push(lines(count, names.length, (row, at) => answer.values[row * names.length + at]));
      }
    } else {
      const held = store.over(from, to);
      const first = held.at(from);
      const columns = names.map((name) => held.data[name]);
      parts.push(lines(held.at(to) - first, names.length, (row, at) => columns[at][first + row]));
    }
    save(fileName(stores.length > 1 ? `${title}_${run + 1}` : title, from, to, 'csv'),
         new Blob(parts, {type: 'text/csv'}));
  }
}

function lines(rows, columns, value) {
  const found = [];
  for (let row = 0; row < rows; row += 1) {
    const line = [];
    for (let at = 0; at < columns; at += 1) {
      const number = value(row, at);
      line.push(Number.isNaN(number) ? '' : String(number));
    }
    found.push(`${line.join(',')}\n`);
  }
  return found.join('');
}

export function png(title, from, to) {
  const ratio = devicePixelRatio;
  const figures = [...document.querySelectorAll('.plot')];
  const box = document.getElementById('plots').getBoundingClientRect();
  const head = 40;
  const bottom = Math.max(...figures.map((figure) => figure.getBoundingClientRect().bottom));
  const canvas = document.createElement('canvas');
  canvas.width = box.width * ratio;
  canvas.height = (bottom - box.top + head) * ratio;
  const ctx = canvas.getContext('2d');
  ctx.scale(ratio, ratio);
  ctx.fillStyle = colour('--page');
  ctx.fillRect(0, 0, box.width, canvas.height / ratio);
  ctx.fillStyle = colour('--ink');
  ctx.font = 'bold 18px system-ui, sans-serif';
  ctx.fillText(`${title}, ${from.toFixed(2)} to ${to.toFixed(2)} s`, 12, 26);
  for (const figure of figures) {
    for (const drawn of figure.querySelectorAll('canvas')) {
      const at = drawn.getBoundingClientRect();
      ctx.drawImage(drawn, at.left - box.left, at.top - box.top + head, at.width, at.height);
    }
    const heading = figure.querySelector('h2').getBoundingClientRect();
    ctx.fillStyle = colour('--ink');
    ctx.font = 'bold 14px system-ui, sans-serif';
    ctx.fillText(figure.querySelector('h2').textContent, heading.left - box.left,
                 heading.bottom - box.top + head - 4);
    for (const item of figure.querySelectorAll('.legend li, .bars-words')) {
      const at = item.getBoundingClientRect();
      const swatch = item.querySelector('.swatch');
      ctx.fillStyle = swatch ? getComputedStyle(swatch).color : colour('--dim');
      if (swatch) ctx.fillRect(at.left - box.left, at.top - box.top + head + 6, 14, 3);
      ctx.fillStyle = colour('--ink');
      ctx.font = '12px system-ui, sans-serif';
      ctx.fillText(item.textContent, at.left - box.left + (swatch ? 20 : 0),
                   at.bottom - box.top + head - 5);
    }
  }
  canvas.toBlob((blob) => save(fileName(title, from, to, 'png'), blob), 'image/png');
}
