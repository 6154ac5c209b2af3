// SPDX-License-Identifier: Apache-2.0
// Rows by columns. A live store forgets its oldest rows; one of a recorded run is given them whole.

export class Store {
  constructor(columns, capacity) {
    this.columns = columns;
    this.names = columns.map((column) => column.name);
    this.units = Object.fromEntries(columns.map((column) => [column.name, column.unit]));
    this.keep = capacity;
    this.room = Math.ceil(1.25 * capacity) + 4096;
    this.data = {};
    for (const name of this.names) {
      this.data[name] = name === 'stamp' || name === 'published' || name === 'seq'
        ? new Float64Array(this.room) : new Float32Array(this.room);
    }
    this.count = 0;
  }

  append(values, rows) {
    const width = this.names.length;
    if (rows > this.room) {     // more than is kept
      values = values.subarray((rows - this.room) * width);
      rows = this.room;
    }
    if (this.count + rows > this.room) {        // forget, rarely and much at once
      const from = Math.max(this.count + rows - this.keep, 0);
      const left = Math.max(this.count - from, 0);
      for (const name of this.names) this.data[name].copyWithin(0, this.count - left, this.count);
      this.count = left;
    }
    for (let column = 0; column < width; column += 1) {
      const target = this.data[this.names[column]];
      for (let row = 0, at = column; row < rows; row += 1, at += width) {
        target[this.count + row] = values[at];
      }
    }
    this.count += rows;
  }

  get first() { return this.count ? this.data.stamp[0] : NaN; }

  get last() { return this.count ? this.data.stamp[this.count - 1] : NaN; }

  // The place of the first row at or after an instant.
  at(time) {
    const stamps = this.data.stamp;
    let low = 0;
    let high = this.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (stamps[middle] < time) low = middle + 1; else high = middle;
    }
    return low;
  }

  // The place of the row nearest to an instant, −1 where there is none.
  nearest(time) {
    if (!this.count) return -1;
    const after = Math.min(this.at(time), this.count - 1);
    const before = Math.max(after - 1, 0);
    const {stamp} = this.data;
    return time - stamp[before] < stamp[after] - time ? before : after;
  }

  value(name, place) {
    const column = this.data[name];
    return column && place >= 0 ? column[place] : NaN;
  }

  // What holds the rows of a span best: itself.
  over() { return this; }
}

// A recorded run: all of it coarsely, the part that is looked at in full.
export class RunStore extends Store {
  constructor(columns, name) {
    super(columns, 1);
    this.name = name;
    this.detail = null;
    this.whole = false;         // whether every row is here
  }

  fill(values, rows) {
    for (const name of this.names) {
      const Kind = this.data[name].constructor;
      this.data[name] = new Kind(rows);
    }
    this.room = this.keep = rows;
    this.count = 0;
    this.append(values, rows);
  }

  over(from, to) {
    const {detail} = this;
    return detail && detail.from <= from && detail.to >= to ? detail : this;
  }
}
