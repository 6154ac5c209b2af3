// SPDX-License-Identifier: Apache-2.0
// The span of time that is looked at, and the cursor in it.

const LEAST = 0.02;     // s

export class View {
  constructor(changed) {
    this.changed = changed;
    this.follow = true;         // the end of the window is the newest row
    this.span = 20;             // s; 0 = everything there is
    this.end = 0;
    this.cursor = null;         // s; null = the newest row
    this.limits = [0, 0];
  }

  // Set the limits of the data.
  reach(first, last) {
    this.limits = [first, last];
    if (this.follow && Number.isFinite(last)) this.end = last;
  }

  get window() {
    const [first, last] = this.limits;
    const span = this.span || Math.max(last - first, LEAST);
    // A run that has just begun fills its window from the left.
    if (this.follow && this.end - span < first) return [first, first + span];
    return [this.end - span, this.end];
  }

  get length() { const [from, to] = this.window; return to - from; }

  pause() { this.set({follow: false}); }

  live() { this.set({follow: true, cursor: null}); }

  look(from, to) { this.set({follow: false, span: Math.max(to - from, LEAST), end: to}); }

  zoom(factor, centre) {
    const [from, to] = this.window;
    const [first, last] = this.limits;
    const length = Math.min(Math.max((to - from) * factor, LEAST), Math.max(last - first, 5));
    if (this.follow && centre === undefined) {
      this.set({span: length});
      return;
    }
    const at = centre ?? 0.5 * (from + to);
    const share = (to - at) / (to - from);
    this.look(at - (1 - share) * length, at + share * length);
  }

  pan(share) {
    const length = this.length;
    const [first, last] = this.limits;
    const end = Math.min(Math.max(this.end + share * length, first + 0.1 * length), last);
    this.set({follow: false, span: length, end});
  }

  point(time) {
    this.cursor = time;
    this.changed('cursor');
  }

  set(values) {
    Object.assign(this, values);
    this.changed('window');
  }
}

// Keys that move the view, wherever the focus is, unless what has it uses them itself.
const USES = 'input, select, textarea, [contenteditable]';
const PRESSED = 'button, a, summary';       // by Space
const SCROLLED = '.events';                 // by Home, End

export function keys(view, step) {
  const moves = {
    ' ': () => (view.follow ? view.pause() : view.live()),
    ArrowLeft: () => view.pan(-0.2), ArrowRight: () => view.pan(0.2),
    '+': () => view.zoom(0.5), '=': () => view.zoom(0.5), '-': () => view.zoom(2),
    End: () => view.live(), Home: () => view.set({span: 0}),
    ',': () => step(-1), '.': () => step(1),
  };
  return (event) => {
    const {target} = event;
    const free = !target.closest(USES) && !(event.key === ' ' && target.closest(PRESSED))
      && !(['Home', 'End'].includes(event.key) && target.closest(SCROLLED));
    const move = moves[event.key];
    if (!free || !move || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    move();
  };
}
