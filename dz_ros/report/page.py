# SPDX-License-Identifier: Apache-2.0
"""One HTML page without anything outside itself: pictures are in the text, style too.

Everything that comes from a run is escaped. The page follows the reader's light or dark setting,
its pictures too, whose lightness is inverted, and the width of the screen: on a phone a row of a
table is a block of labelled values and a picture is as wide as the screen. A picture that is
pressed is enlarged, and scrolls.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

from dz_ros.core.text import printable
from dz_ros.report.style import Picture

SCALE = 120.0
"""Pixels an inch up to which a picture is enlarged to the width of the page."""
STYLE = """
:root { color-scheme: light dark; --ink: #1c1e21; --soft: #5c6168; --line: #d9dce0;
  --ground: #ffffff; --raised: #f5f6f8; --accent: #0072b2; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e7e9; --soft: #a4a9b0; --line: #3a3e44;
  --ground: #16181b; --raised: #202327; --accent: #6fb7e4; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 62rem; color: var(--ink);
  background: var(--ground); font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .3rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; border-bottom: 1px solid var(--line);
  padding-bottom: .25rem; }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; }
p { margin: .4rem 0; max-width: 48rem; }
.soft, figcaption, caption { color: var(--soft); }
.note { background: var(--raised); border-left: 3px solid var(--accent); padding: .5rem .8rem; }
.fault { background: var(--raised); border-left: .5rem solid #d55e00; padding: .5rem .8rem;
  font-weight: 700; }
nav ul { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; list-style: none; padding: 0; }
a { color: var(--accent); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
caption { text-align: left; padding: .3rem 0; }
th, td { text-align: left; vertical-align: top; padding: .3rem .8rem .3rem 0;
  border-bottom: 1px solid var(--line); }
td:last-child { min-width: 11rem; }
thead th { color: var(--soft); font-weight: 600; }
tbody th { font-weight: 600; }
.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
code { font: .9em ui-monospace, "DejaVu Sans Mono", Menlo, monospace; overflow-wrap: anywhere; }
summary { cursor: pointer; color: var(--accent); }
figure { margin: 1.2rem 0 1.8rem; }
figure .wide { background: #ffffff; border: 1px solid var(--line); border-radius: .4rem;
  position: relative; }
figure label { display: block; cursor: zoom-in; }
figure input { position: absolute; opacity: 0; }
figure .wide:focus-within { outline: 2px solid var(--accent); }
figure img { display: block; width: 100%; height: auto; padding: .4rem; }
figure input:checked + img { width: 80rem; max-width: none !important; cursor: zoom-out; }
@media (prefers-color-scheme: dark) { figure .wide { background: var(--ground); }
  figure img { filter: invert(.93) hue-rotate(180deg) brightness(1.3); } }
@media screen and (max-width: 40rem) {
  body { padding: 1rem .7rem 3rem; }
  thead { position: absolute; width: 1px; height: 1px; overflow: hidden;
    clip-path: inset(50%); }
  table, caption, tbody, tr, td, tbody th { display: block; }
  tr { padding: .4rem 0; border-bottom: 1px solid var(--line); }
  td, tbody th { padding: .05rem 0; border: 0; overflow-wrap: anywhere; white-space: normal; }
  td[data-head]::before { content: attr(data-head) ": "; color: var(--soft); }
}
figcaption { padding-top: .4rem; font-size: .92rem; }
@media print { nav { display: none; } figure { break-inside: avoid; } }
"""


def text(value: object) -> str:
    """Return a value as HTML text."""
    return escape(printable(value), quote=True)


def paragraph(content: str, style: str = '') -> str:
    """Return a paragraph of plain text."""
    mark = f' class="{style}"' if style else ''
    return f'<p{mark}>{text(content)}</p>'


def bullets(items: Iterable[str]) -> str:
    """Return a list of plain texts."""
    return '<ul>' + ''.join(f'<li>{text(item)}</li>' for item in items) + '</ul>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = '',
          numbers: Sequence[int] = ()) -> str:
    """Return a table whose first column names its rows; `numbers` are columns of numbers."""
    def cell(place: int, value: str) -> str:
        mark = ' class="number"' if place in numbers else ''
        if place == 0:
            return f'<th scope="row" role="rowheader"{mark}>{text(value)}</th>'
        return f'<td role="cell" data-head="{text(head[place])}"{mark}>{text(value)}</td>'

    top = ''.join(f'<th scope="col" role="columnheader">{text(item)}</th>' for item in head)
    lines = (''.join(cell(place, value) for place, value in enumerate(row)) for row in rows)
    body = ''.join(f'<tr role="row">{line}</tr>' for line in lines)
    title = f'<caption>{text(caption)}</caption>' if caption else ''
    return (f'<div class="wide"><table role="table">{title}<thead role="rowgroup"><tr role="row">'
            f'{top}</tr></thead><tbody role="rowgroup">{body}</tbody></table></div>')


def folded(summary: str, content: str) -> str:
    """Return content that opens on demand."""
    return f'<details><summary>{text(summary)}</summary>{content}</details>'


def image(picture: Picture, png: bytes) -> str:
    """Return a figure with its picture in the text."""
    data = base64.b64encode(png).decode('ascii')
    widest = round(SCALE * float(picture.figure.get_size_inches()[0]))
    return (f'<figure id="{text(picture.name)}"><h3>{text(picture.title)}</h3>'
            f'<div class="wide"><label><input type="checkbox" aria-label="enlarge">'
            f'<img style="max-width: {widest}px" alt="{text(picture.alt)}" '
            f'src="data:image/png;base64,{data}"></label></div>'
            f'<figcaption>{text(picture.caption)}</figcaption></figure>')


def page(title: str, lead: str, sections: Sequence[tuple[str, str]]) -> str:
    """Return the page: HTML below the heading, then (heading, HTML) sections, no empty ones."""
    shown = [(f'section{place}', heading, content)
             for place, (heading, content) in enumerate(sections, start=1) if content]
    links = ''.join(f'<li><a href="#{name}">{text(heading)}</a></li>'
                    for name, heading, _ in shown)
    body = ''.join(f'<section aria-labelledby="{name}"><h2 id="{name}">{text(heading)}</h2>'
                   f'{content}</section>' for name, heading, content in shown)
    return ('<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f'<title>{text(title)}</title><link rel="icon" href="data:,">'
            f'<style>{STYLE}</style></head>\n<body><header><h1>{text(title)}</h1>{lead}'
            f'<nav aria-label="Contents"><ul>{links}</ul></nav></header>\n<main>{body}</main>'
            '</body></html>\n')
