// SPDX-License-Identifier: Apache-2.0
// Light and dark: the system's choice until the user chooses; colours from the style sheet.

export function start(changed) {
  const root = document.documentElement;
  const kept = localStorage.getItem('dz_ros-theme');
  if (kept) root.dataset.theme = kept;
  document.getElementById('theme').addEventListener('click', () => {
    const dark = colour('--scheme') === 'dark';
    root.dataset.theme = dark ? 'light' : 'dark';
    localStorage.setItem('dz_ros-theme', root.dataset.theme);
    changed();
  });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', changed);
}

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

export function faded(hex, share) {
  const value = parseInt(hex.slice(1), 16);
  return `rgba(${value >> 16}, ${(value >> 8) & 255}, ${value & 255}, ${share})`;
}
