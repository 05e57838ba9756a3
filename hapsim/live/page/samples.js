// @ts-check
/** The last minute: every sample of each channel, and where watched modules were. */

const KEPT_S = 60;
const MOST_ROWS = 120_000; // of watched modules

export class Samples {
  period = 1;
  channels = 0;
  size = 0; // how many are kept,
  count = 0; // and how many there were
  last = -1; // number of the last one
  /** @type {Float32Array[]} */
  columns = []; // position, velocity, force and what is sensed, of each channel; then inputs and outputs
  rows = 0; // as `count`, of modules
  at = new Float64Array(0); // the sample of each row
  places = new Float32Array(0); // of the module that is watched

  clear() {
    this.size = this.count = 0;
    this.last = -1;
    this.columns = [];
    this.watch();
  }

  /** Forgets what was watched before. */
  watch() {
    this.rows = 0;
    this.at = new Float64Array(0);
    this.places = new Float32Array(0);
  }

  /** @param {import("./connection.js").Block} block */
  add(block) {
    const width = block.columns - 2;
    if (this.size === 0 || this.columns.length !== width || this.period !== block.period || block.first < this.last) {
      this.clear();
      this.period = block.period;
      this.channels = block.channels;
      this.size = Math.ceil(KEPT_S / block.period);
      this.columns = Array.from({ length: width }, () => new Float32Array(this.size));
    }
    const { columns, values } = block, begin = this.count % this.size;
    for (let c = 0; c < width; c++) {
      const column = this.columns[c];
      for (let row = 0, at = begin, from = 2 + c; row < block.rows; row++, from += columns) {
        column[at] = values[from];
        if (++at === this.size) at = 0;
      }
    }
    this.count += block.rows;
    if (block.rows) this.last = block.first + values[(block.rows - 1) * columns];
  }

  /** The newest position of a channel. @param {number} channel */
  position(channel) {
    return this.newest(0, channel);
  }

  /** The newest value of a channel. @param {number} quantity 0: position, 1: velocity, 2: force @param {number} channel */
  newest(quantity, channel) {
    return this.newestOf(quantity * this.channels + channel);
  }

  /** The newest value of a column. @param {number} column */
  newestOf(column) {
    return this.count ? this.columns[column][(this.count - 1) % this.size] : 0;
  }

  /** @param {import("./connection.js").Block} block */
  addModules(block) {
    if (!this.at.length) [this.at, this.places] = [new Float64Array(MOST_ROWS), new Float32Array(MOST_ROWS)];
    for (let row = 0; row < block.rows; row++) {
      const at = this.rows++ % MOST_ROWS;
      this.at[at] = block.first + block.values[row * block.columns];
      this.places[at] = block.values[row * block.columns + 1];
    }
  }

  /**
   * One quantity as the scope reads it, by a place that counts up from the oldest sample to `count`.
   * @param {{quantity: number, channel: number} | null} what null: the watched module
   * @returns {Series | null}
   */
  series(what) {
    if (!this.size) return null;
    if (what) {
      const values = this.columns[what.quantity * this.channels + what.channel];
      const { size, count } = this;
      return values && { first: Math.max(0, count - size), end: count, place: (i) => i, value: (i) => values[i % size] };
    }
    // Between the newest sample and the sample of a row lies what turns sample numbers into places.
    const { at, places, count, last, rows } = this;
    const size = at.length, place = (/** @type {number} */ i) => count - 1 - (last - at[i % size]);
    return size ? { first: Math.max(0, rows - size), end: rows, place, value: (i) => places[i % size] } : null;
  }
}

/** Values `first` to `end` - 1, each at a place in samples. @typedef {{first: number, end: number, place: (i: number) => number, value: (i: number) => number}} Series */

/** The first value at or behind a place. @param {Series} series @param {number} place */
export function firstFrom(series, place) {
  let [low, high] = [series.first, series.end];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (series.place(middle) < place) low = middle + 1;
    else high = middle;
  }
  return low;
}
