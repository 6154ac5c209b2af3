// SPDX-License-Identifier: Apache-2.0
// The one connection to the server: it reconnects by itself and knows the age of what it receives.
// Arrival − sending is the clocks' difference plus the delay; its minimum is taken for the
// difference, so a message later than the quickest is old by as much.

const AGAIN = 1000;     // ms until the next try
const LIVE = 1;         // kind of a frame: rows as they come
const DRIFT = 1e-4;     // s a second by which two clocks may run apart
const SILENT = 1000;    // ms without a message
const ANSWER_LIMIT = 30000; // ms for an answer

export class Link {
  constructor(handlers) {
    this.handlers = handlers;       // kind → handler; rows(frame), closed(reason)
    this.received = -Infinity;         // performance.now() of the last message
    this.open = false;
    this.reason = '';
    this.number = 0;
    this.offset = NaN;              // this clock − the server's [s]
    this.offsetAt = 0;
    this.waiting = new Map();
    this.token = this.takeToken();
    this.connect();
  }

  // Whether nothing has been received for longer than the server is ever silent.
  get silent() { return performance.now() - this.received > SILENT; }

  // The time of the server's clock [s], NaN before its first message.
  get time() { return 1e-3 * performance.now() - this.offset; }

  // Correct the clocks' difference by a message's time of sending.
  sent(time) {
    if (!Number.isFinite(time)) return;
    const now = 1e-3 * performance.now();
    const drifted = this.offset + DRIFT * (now - this.offsetAt);
    this.offset = drifted <= now - time ? drifted : now - time;
    this.offsetAt = now;
  }

  takeToken() {
    const token = location.hash.slice(1);
    if (token) {        // out of the address bar, the screen and bookmarks
      sessionStorage.setItem('dz_ros-token', token);
      history.replaceState(null, '', location.pathname + location.search);
    }
    return sessionStorage.getItem('dz_ros-token') || '';
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/ws`);
    socket.binaryType = 'arraybuffer';
    socket.onopen = () => {
      const seconds = window.innerWidth < 700 ? 120 : 3600;
      const axis = new URLSearchParams(location.search).get('axis') || '';
      socket.send(JSON.stringify({hello: 1, token: this.token, seconds, axis}));
    };
    socket.onmessage = ({data}) => {
      this.received = performance.now();
      this.open = true;
      if (typeof data === 'string') this.text(JSON.parse(data));
      else this.numbers(data);
    };
    socket.onclose = ({reason}) => {
      this.open = false;
      this.reason = reason;
      for (const settle of this.waiting.values()) settle({ok: false, lost: true, message: 'the connection was lost'});
      this.waiting.clear();
      this.handlers.closed?.(reason);
      setTimeout(() => this.connect(), AGAIN);
    };
    this.socket = socket;
  }

  text(message) {
    if (message.kind === 'result') {
      this.waiting.get(message.id)?.(message);
      this.waiting.delete(message.id);
    } else {
      if (message.kind === 'hello') this.offset = NaN;      // perhaps of another server
      if (message.kind === 'hello' || message.kind === 'status') this.sent(message.time);
      this.handlers[message.kind]?.(message);
    }
  }

  numbers(buffer) {
    const head = new DataView(buffer);
    const frame = {
      kind: head.getUint32(0, true), number: head.getUint32(4, true),
      count: head.getUint32(8, true), run: head.getUint32(12, true),
      time: head.getFloat64(16, true), values: new Float64Array(buffer, 24),
    };
    if (frame.kind === LIVE) {
      this.sent(frame.time);
      this.handlers.rows?.(frame);
    } else {
      this.waiting.get(frame.number)?.({ok: true, ...frame});
      this.waiting.delete(frame.number);
    }
  }

  // Ask for something; the answer comes as {ok, message} or as a frame.
  ask(what, details = {}, limit = ANSWER_LIMIT) {
    if (!this.open || this.socket.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ok: false, lost: true, message: 'not connected'});
    }
    const id = this.number = (this.number + 1) % 2 ** 31;
    this.socket.send(JSON.stringify({do: what, id, asked: this.time, ...details}));
    return new Promise((settle) => {
      const late = setTimeout(() => {
        this.waiting.delete(id);
        settle({ok: false, late: true, message: `no answer for ${limit / 1e3} s`});
      }, limit);
      this.waiting.set(id, (answer) => { clearTimeout(late); settle(answer); });
    });
  }
}
