// What is seen, as a file: the rows of the window as CSV, the plots as one picture.

import {colour} from './theme.js';

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

export function csv(stores, title, from, to) {
  stores.forEach((store, run) => {
    const held = store.over(from, to);
    const names = store.names;
    const lines = [names.map((name) => (store.units[name] ? `${name} [${store.units[name]}]` : name))
      .join(',')];
    for (let row = held.at(from), end = held.at(to); row < end; row += 1) {
      lines.push(names.map((name) => {
        const value = held.data[name][row];
        return Number.isNaN(value) ? '' : String(value);
      }).join(','));
    }
    save(fileName(stores.length > 1 ? `${title}_${run + 1}` : title, from, to, 'csv'),
         new Blob([`${lines.join('\n')}\n`], {type: 'text/csv'}));
  });
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
