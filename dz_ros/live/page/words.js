// SPDX-License-Identifier: Apache-2.0
// Names of columns as they are read, and numbers as they are written.

const LOW = '₀₁₂₃₄₅₆₇₈₉';

// A declared label with its subscripts lowered: θ̂_1 → θ̂₁.
export function word(label) {
  return label.replace(/_(\d+)/g, (_, digits) => [...digits].map((digit) => LOW[digit]).join(''));
}

export function number(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return '–';
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) {
    return value.toExponential(2).replace('-', '−').replace('e−', 'e−').replace('e+', 'e');
  }
  const whole = size < 1 ? Math.floor(Math.log10(size || 1)) + 1 : Math.floor(Math.log10(size));
  const places = size < 1 ? digits - 1 - whole : Math.max(0, digits - 1 - whole);
  return value.toFixed(places).replace('-', '−');
}

export function withUnit(value, unit, digits) {
  const text = number(value, digits);
  return unit && text !== '–' ? `${text} ${unit}` : text;
}

export function seconds(value, places = 2) {
  return Number.isFinite(value) ? `${value.toFixed(places).replace('-', '−')} s` : '–';
}

export function megabytes(text) {
  return text === undefined ? '' : `${text} MB`;
}

export function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === 'class') node.className = value;
    else if (name in node && name !== 'list') node[name] = value;
    else node.setAttribute(name, value);
  }
  node.append(...children);
  return node;
}
