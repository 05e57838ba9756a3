// @ts-check
/** The last minute of every channel, and how it is drawn: the least and the most of each column of pixels. */

const KEPT_S = 60;

export class Scope {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.spanS = 2;
    this.quantity = 0; // 0 position, 1 velocity, 2 force
    this.channel = 0;
    this.unit = "m";
    this.isFrozen = false;
    /** @type {Float32Array[]} */
    this.columns = [];
    this.size = 0; // samples that are kept, and how many there were
    this.count = 0;
    this.period = 1;
    this.last = -1; // number of the last one
  }

  clear() {
    this.size = 0;
    this.count = 0;
    this.period = 1;
    this.last = -1;
  }

  /** @param {import("./connection.js").Block} block */
  add(block) {
    if (this.isFrozen) return;
    const width = block.columns - 2;
    if (this.size === 0 || this.columns.length !== width || this.period !== block.period || block.first < this.last) {
      this.clear();
      this.period = block.period;
      this.size = Math.ceil(KEPT_S / block.period);
      this.columns = Array.from({ length: width }, () => new Float32Array(this.size));
    }
    for (let row = 0; row < block.rows; row++) {
      const at = this.count++ % this.size;
      for (let c = 0; c < width; c++) this.columns[c][at] = block.values[row * block.columns + 2 + c];
    }
    if (block.rows) this.last = block.first + block.values[(block.rows - 1) * block.columns];
  }

  /** @param {number} channels */
  draw(channels) {
    const { context, width, height, look } = prepared(this.canvas);
    const values = this.columns[this.quantity * channels + this.channel];
    if (!values || !this.count) return;
    const shown = Math.min(this.count, this.size, Math.round(this.spanS / this.period));
    const left = 64, right = width - 8, top = 10, bottom = height - 22;
    const pixels = Math.max(1, Math.floor(right - left));
    const low = new Float32Array(pixels).fill(Infinity), high = new Float32Array(pixels).fill(-Infinity);
    const whole = Math.max(shown, Math.round(this.spanS / this.period));
    let least = Infinity, most = -Infinity;
    for (let i = 0; i < shown; i++) {
      const value = values[(this.count - shown + i) % this.size];
      const x = Math.min(pixels - 1, Math.floor(((whole - shown + i) / whole) * pixels));
      if (value < low[x]) low[x] = value;
      if (value > high[x]) high[x] = value;
      if (value < least) least = value;
      if (value > most) most = value;
    }
    const room = Math.max(1e-9, 0.08 * (most - least), 0.02 * Math.max(Math.abs(least), Math.abs(most)));
    [least, most] = [least - room, most + room];
    const y = (/** @type {number} */ value) => bottom - ((value - least) / (most - least)) * (bottom - top);
    context.fillStyle = look.quiet;
    context.strokeStyle = look.line;
    for (const tick of ticks(least, most, 5)) {
      context.textAlign = "right";
      context.fillText(short(tick), left - 8, y(tick) + 4);
      line(context, left, y(tick), right, y(tick));
    }
    context.textAlign = "left";
    context.fillText(`${this.unit}, the last ${this.spanS} s`, left, height - 5);
    context.strokeStyle = look.accent;
    context.lineWidth = 1.5;
    context.beginPath();
    for (let x = 0; x < pixels; x++) {
      if (low[x] > high[x]) continue;
      context.lineTo(left + x, y(high[x]));
      context.lineTo(left + x, y(low[x]));
    }
    context.stroke();
  }
}

/** A canvas of the size that it has on the screen, cleared, with the page's colours. @param {HTMLCanvasElement} canvas */
export function prepared(canvas) {
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  context.lineWidth = 1;
  return { context, width, height, look: colours(canvas) };
}

/** @type {WeakMap<Element, {at: number, look: any}>} */
const seen = new WeakMap();

/** @param {Element} element */
function colours(element) {
  const known = seen.get(element);
  if (known && performance.now() - known.at < 1000) return known.look;
  const probe = document.createElement("i");
  document.body.append(probe);
  /** @type {Record<string, string>} */
  const look = {};
  for (const name of ["ink", "quiet", "line", "accent", "warm", "card"]) {
    probe.style.color = `var(--${name})`;
    look[name] = getComputedStyle(probe).color;
  }
  probe.remove();
  seen.set(element, { at: performance.now(), look });
  return look;
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} to @param {number} down */
export function line(context, x, y, to, down) {
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(to, down);
  context.stroke();
}

/** Round numbers between two. @param {number} least @param {number} most @param {number} about */
export function ticks(least, most, about) {
  const raw = (most - least) / about, unit = 10 ** Math.floor(Math.log10(raw));
  const step = unit * ([1, 2, 5, 10].find((one) => one * unit >= raw) ?? 10);
  const found = [];
  for (let i = Math.ceil(least / step); i * step <= most; i++) found.push(i * step);
  return found;
}

/** @param {number} value */
export function short(value) {
  return value === null || !Number.isFinite(value) ? "–" : String(Number(value.toPrecision(4)));
}
