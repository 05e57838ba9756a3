// @ts-check
/** The scope: one quantity over time, the least and the most of each column of pixels. */

import { line, prepared, short, ticks, written } from "./drawing.js";
import { firstFrom } from "./samples.js";
import { Trigger } from "./trigger.js";

const SHORTEST_S = 0.005, LONGEST_S = 60, PATIENCE_S = 0.5;
const LEFT = 64, RIGHT = 8, TOP = 10, BOTTOM = 22; // pixels around the picture

export class Scope {
  /** @param {HTMLCanvasElement} canvas @param {import("./samples.js").Samples} samples @param {() => void} changed called when it freezes or zooms by itself */
  constructor(canvas, samples, changed) {
    this.canvas = canvas;
    this.samples = samples;
    this.changed = changed;
    this.trigger = new Trigger();
    this.spanS = 2;
    /** @type {{quantity: number, channel: number} | null} */
    this.what = { quantity: 0, channel: 0 };
    this.unit = "m"; // in which it is shown,
    this.factor = 1; // and how many of it one SI unit is
    /** @type {number | null} */
    this.frozenAt = null; // the place at which the picture ends; null: it runs
    /** @type {number | null} */
    this.pointer = null; // pixels
    /** @type {number | null} */
    this.shownEnd = null; // the place at which the last picture ended
    this.listen();
  }

  get isFrozen() {
    return this.frozenAt !== null;
  }

  /** @param {boolean} isFrozen */
  freeze(isFrozen) {
    this.frozenAt = isFrozen ? (this.shownEnd ?? this.samples.count) : null;
    this.trigger.rearm(this.samples.count);
    this.changed();
  }

  /** @param {number} factor @param {number} [share] of the picture that stays where it is, 0 to 1; frozen only */
  zoom(factor, share = 1) {
    const before = this.spanS;
    this.spanS = Math.min(LONGEST_S, Math.max(SHORTEST_S, before * factor));
    this.pan(((1 - share) * (this.spanS - before)) / this.samples.period);
    this.changed();
  }

  /** Moves a frozen picture. @param {number} samples to later ones */
  pan(samples) {
    if (this.frozenAt === null) return;
    const { count, size, period } = this.samples, span = this.spanS / period;
    this.frozenAt = Math.max(Math.min(this.frozenAt + samples, count), Math.max(0, count - size) + Math.min(span, count));
  }

  listen() {
    const { canvas } = this;
    /** @type {Map<number, number>} */
    const held = new Map(); // pointers that are down, and where
    const share = (/** @type {number} */ x) => (x - LEFT) / Math.max(1, canvas.clientWidth - LEFT - RIGHT);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.002), share(event.offsetX));
    });
    canvas.addEventListener("dblclick", () => {
      this.spanS = 2;
      this.freeze(false);
    });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, event.offsetX);
    });
    canvas.addEventListener("pointermove", (event) => {
      this.pointer = event.offsetX;
      const before = held.get(event.pointerId);
      if (before === undefined) return;
      const [other] = [...held].filter(([id]) => id !== event.pointerId);
      if (other) this.zoom((1 + Math.abs(before - other[1])) / (1 + Math.abs(event.offsetX - other[1])), share(other[1]));
      else if (Math.abs(event.offsetX - before) > 0) {
        if (!this.isFrozen) this.freeze(true);
        this.pan((share(before) - share(event.offsetX)) * (this.spanS / this.samples.period));
      }
      held.set(event.pointerId, event.offsetX);
    });
    for (const kind of ["pointerup", "pointercancel"])
      canvas.addEventListener(kind, (event) => held.delete(/** @type {PointerEvent} */ (event).pointerId));
    canvas.addEventListener("pointerleave", () => (this.pointer = null));
    canvas.addEventListener("keydown", (event) => {
      const step = (0.1 * this.spanS) / this.samples.period;
      if (event.key === "+") this.zoom(0.5);
      else if (event.key === "-") this.zoom(2);
      else if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
        if (!this.isFrozen) this.freeze(true);
        this.pan(event.key === "ArrowLeft" ? -step : step);
      }
    });
  }

  /** The place at which the picture ends. @param {import("./samples.js").Series} series @param {number} span samples */
  end(series, span) {
    if (this.frozenAt !== null) return this.frozenAt;
    const newest = series.end > series.first ? series.place(series.end - 1) + 1 : this.samples.count;
    const found = this.trigger.find(series, newest, span, PATIENCE_S / this.samples.period);
    if (found?.isNew && this.trigger.mode === "single") {
      this.frozenAt = found.end;
      this.changed();
    }
    return found?.end ?? newest;
  }

  draw() {
    const { context, width, height, look } = prepared(this.canvas);
    const series = this.samples.series(this.what), span = this.spanS / this.samples.period;
    if (!series || series.end === series.first) return;
    const end = this.end(series, span), begin = end - span;
    this.shownEnd = end;
    const right = width - RIGHT, bottom = height - BOTTOM, pixels = Math.max(1, Math.floor(right - LEFT));
    const { low, high, least, most } = columns(series, begin, span, pixels);
    if (least > most) return;
    const y = (/** @type {number} */ value) => bottom - ((value - least) / (most - least)) * (bottom - TOP);
    context.fillStyle = look.quiet;
    context.strokeStyle = look.line;
    for (const shown of ticks(least * this.factor, most * this.factor, 5)) {
      const tick = shown / this.factor;
      context.textAlign = "right";
      context.fillText(short(shown), LEFT - 8, y(tick) + 4);
      line(context, LEFT, y(tick), right, y(tick));
    }
    context.textAlign = "left";
    const ago = Math.max(0, (this.samples.count - end) * this.samples.period);
    context.fillText(`${this.unit}, ${short(this.spanS)} s${ago > 0.05 ? `, until ${ago.toFixed(2)} s ago` : ""}`, LEFT, height - 5);
    if (this.trigger.mode !== "off") this.drawLevel(context, look, y, right, bottom);
    context.strokeStyle = look.accent;
    context.lineWidth = 1.5;
    context.beginPath();
    for (let x = 0; x < pixels; x++) {
      if (low[x] > high[x]) continue;
      context.lineTo(LEFT + x, y(high[x]));
      context.lineTo(LEFT + x, y(low[x]));
    }
    context.stroke();
    this.drawPointer(context, look, { low, high, y, begin, span, right, bottom });
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {(value: number) => number} y @param {number} right @param {number} bottom */
  drawLevel(context, look, y, right, bottom) {
    const at = y(this.trigger.level);
    if (at < TOP || at > bottom) return;
    context.setLineDash([4, 4]);
    context.strokeStyle = look.warm;
    line(context, LEFT, at, right, at);
    context.setLineDash([]);
  }

  /** What is under the pointer. @param {CanvasRenderingContext2D} context @param {any} look @param {any} of */
  drawPointer(context, look, { low, high, y, begin, span, right, bottom }) {
    if (this.pointer === null || this.pointer < LEFT || this.pointer >= right) return;
    const x = Math.floor(this.pointer - LEFT), value = (low[x] + high[x]) / 2;
    context.strokeStyle = look.quiet;
    context.lineWidth = 1;
    line(context, this.pointer, TOP, this.pointer, bottom);
    if (!Number.isFinite(value)) return;
    const second = (begin + (x / (right - LEFT)) * span) * this.samples.period;
    const isLeft = this.pointer < (LEFT + right) / 2, ago = this.samples.count * this.samples.period - second;
    context.textAlign = isLeft ? "left" : "right";
    context.fillStyle = look.ink;
    written(context, look, `${short(value * this.factor)} ${this.unit}, ${ago.toFixed(3)} s ago`, this.pointer + (isLeft ? 8 : -8), TOP + 12);
    context.beginPath();
    context.arc(this.pointer, y(value), 3, 0, 7);
    context.fill();
  }
}

/** The least and the most in each column of pixels, and of all. @param {import("./samples.js").Series} series @param {number} begin @param {number} span @param {number} pixels */
function columns(series, begin, span, pixels) {
  const low = new Float32Array(pixels).fill(Infinity), high = new Float32Array(pixels).fill(-Infinity);
  let least = Infinity, most = -Infinity, before = -1;
  for (let i = firstFrom(series, begin), last = firstFrom(series, begin + span); i < last; i++) {
    const value = series.value(i), x = Math.min(pixels - 1, Math.floor(((series.place(i) - begin) / span) * pixels));
    if (value < low[x]) low[x] = value;
    if (value > high[x]) high[x] = value;
    if (value < least) least = value;
    if (value > most) most = value;
    before = x;
  }
  const room = before < 0 ? 0 : Math.max(1e-9, 0.08 * (most - least), 0.02 * Math.max(Math.abs(least), Math.abs(most)));
  return { low, high, least: least - room, most: most + room };
}
