// SPDX-License-Identifier: Apache-2.0
// The summary of recorded runs of several axes: failures, a link to each axis, tables of texts.

import {make} from './words.js';

export function address(axis) {
  return axis ? `/?axis=${encodeURIComponent(axis)}` : '/';
}

export function showSummary(place, {axes, failures, tables}) {
  const lines = failures.length ? failures : [`No failure in ${axes.length} axes.`];
  place.replaceChildren(
    ...lines.map((line) => make('p', {class: failures.length ? 'failure' : ''}, line)),
    make('h2', {}, 'Axes'),
    make('ul', {class: 'axes'}, ...axes.map((axis) => make('li', {}, make(
      'a', {href: address(axis)}, axis)))),
    ...tables.flatMap(([heading, head, rows]) => [
      make('h2', {}, heading),
      rows.length ? table(heading, head, rows) : make('p', {}, 'The configurations are the same.'),
    ]));
}

function table(heading, head, rows) {
  const cells = (row) => row.map((text, place) => (place
    ? make('td', {}, text) : make('th', {scope: 'row'}, text)));
  return make('div', {class: 'wide', tabIndex: 0, role: 'region', 'aria-label': heading}, make(
    'table', {},
    make('thead', {}, make('tr', {}, ...head.map((text) => make('th', {scope: 'col'}, text)))),
    make('tbody', {}, ...rows.map((row) => make('tr', {}, ...cells(row))))));
}
