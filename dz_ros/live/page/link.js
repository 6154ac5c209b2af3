// The one connection to the server: it comes back by itself, and knows when it last heard.

const AGAIN = 1000;     // ms until the next try
const LIVE = 1;         // kind of a frame: rows as they come

export class Link {
  constructor(handlers) {
    this.handlers = handlers;       // kind → what hears it; rows(frame), closed(reason)
    this.heard = -Infinity;         // performance.now() of the last message
    this.open = false;
    this.reason = '';
    this.number = 0;
    this.waiting = new Map();
    this.token = this.takeToken();
    this.connect();
  }

  takeToken() {
    const token = location.hash.slice(1);
    if (token) {        // out of sight, so that nobody reads it off the screen or a bookmark
      sessionStorage.setItem('dz_ros-token', token);
      history.replaceState(null, '', location.pathname);
    }
    return sessionStorage.getItem('dz_ros-token') || '';
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/ws`);
    socket.binaryType = 'arraybuffer';
    socket.onopen = () => {
      const seconds = window.innerWidth < 700 ? 120 : 3600;
      socket.send(JSON.stringify({hello: 1, token: this.token, seconds}));
    };
    socket.onmessage = ({data}) => {
      this.heard = performance.now();
      this.open = true;
      if (typeof data === 'string') this.text(JSON.parse(data));
      else this.numbers(data);
    };
    socket.onclose = ({reason}) => {
      this.open = false;
      this.reason = reason;
      for (const settle of this.waiting.values()) settle({ok: false, message: 'not connected'});
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
      this.handlers.rows?.(frame);
    } else {
      this.waiting.get(frame.number)?.({ok: true, ...frame});
      this.waiting.delete(frame.number);
    }
  }

  // Ask for something; the answer comes as {ok, message} or as a frame.
  ask(what, details = {}) {
    if (!this.open || this.socket.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ok: false, message: 'not connected'});
    }
    const id = this.number = (this.number + 1) % 2 ** 31;
    this.socket.send(JSON.stringify({do: what, id, ...details}));
    return new Promise((settle) => this.waiting.set(id, settle));
  }
}
