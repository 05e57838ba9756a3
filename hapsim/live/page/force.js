// @ts-check
/** The force of a hand over its position: what is played, with a dot where the hand is. What is dragged in it pulls the
 * mock. */

import { line, prepared, short, shownIn, ticks, written } from "./drawing.js";

const ERRORS = ["#f0f921", "#fb9f3a", "#d8576b", "#9c179e", "#0d0887"]; // of felt k or b: from 0.1 % to 100 %, as in `chart force`
const DARK = matchMedia("(prefers-color-scheme: dark)"); // where they are lighter
const STEEP = 2; // times the largest force at an edge: a stop is drawn no further, as in `chart force`
const EASE = 0.25; // of the way to a new view, in a picture

export class Force {
  /** @param {HTMLCanvasElement} canvas @param {HTMLElement} note @param {import("./samples.js").Samples} samples @param {import("./hold.js").Hold} hold */
  constructor(canvas, note, samples, hold) {
    this.canvas = canvas;
    this.note = note;
    this.samples = samples;
    this.hold = hold;
    /** @type {any} */
    this.channel = null; // the hand's
    /** @type {any} */
    this.applied = null; // the curve,
    /** @type {any} */
    this.planned = null; // and that of a slider that moves
    /** @type {Record<string, number>} */
    this.places = {}; // of detents that hold
    /** @type {[string, number]} */
    this.position = ["mm", 1e3];
    /** @type {[string, number]} */
    this.force = ["N", 1];
    /** @type {[number, number] | null} */
    this.view = null; // ends of the axis, m
    this.isDragged = false;
    /** @type {any} */
    this.model = null;
    hold.attach(canvas, (event) => this.drag(event.clientX), (way) => this.push(way));
  }

  /** @param {any} model */
  describe(model) {
    [this.model, this.places, this.view] = [model, { ...model.places }, null];
    this.canvas.style.cursor = model.has_mock ? "grab" : "";
  }

  /** @param {any} predicted @param {boolean} isApplied @param {number} channel the chosen hand's */
  show(predicted, isApplied, channel) {
    if (this.channel !== this.model.channels[channel]) this.view = null;
    this.channel = this.model.channels[channel];
    const { unit_position: unit, unit_force } = this.channel, ofFile = this.model.written;
    [this.position, this.force] = [shownIn(unit, ofFile), shownIn(unit_force, ofFile)];
    if (isApplied) [this.applied, this.planned] = [predicted.curve ?? null, null];
    else this.planned = predicted.curve ?? null;
    this.canvas.hidden = !this.applied;
    this.note.textContent = this.applied ? "" : `${this.channel.name} feels the same spring everywhere.`;
    if (!this.applied) return;
    const hasWays = this.applied.regions.some((/** @type {any} */ one) => one.up);
    const ways = hasWays ? " slowly: the upper line on its way up, the lower one on its way down" : " at rest";
    this.note.textContent = `The force with which ${this.channel.name} pushes${ways}. The dot has the force of now, with damping.${this.model.has_mock ? " Drag it." : ""}`;
  }

  /** The place of a detent changed. @param {Record<string, number>} values by "detent.place" */
  placed(values) {
    for (const [name, place] of Object.entries(values)) this.places[name.replace(/\.place$/, "")] = place;
  }

  /** Positions of the places that detents hold, m. @returns {number[]} */
  get held() {
    return Object.entries(this.applied?.held ?? {}).flatMap(([name, { at, pitch }]) => {
      const number = this.places[name];
      return number === undefined ? [] : pitch ? [at[0] + number * pitch] : at.slice(number, number + 1);
    });
  }

  /** Where the hand is, m or rad. */
  get at() {
    return this.channel ? this.samples.position(this.channel.channel) : 0;
  }

  /** Moves the ends of the axis: with the hand where there is more than fits, else so that the hand is within. */
  look() {
    const { view, at: asked, follows } = this.applied, at = this.at;
    let [low, high] = follows ? view.map((/** @type {number} */ end) => end + at - asked) : view;
    if (!follows) {
      const { regions } = this.applied, room = 0.05 * (high - low); // its curve ends somewhere
      [low, high] = [Math.min(low, Math.max(at - room, regions[0].low)), Math.max(high, Math.min(at + room, regions[regions.length - 1].high))];
    }
    if (this.hold.to === null) this.isDragged = false;
    if (!this.view) this.view = [low, high];
    else if (!this.isDragged) this.view = [this.view[0] + EASE * (low - this.view[0]), this.view[1] + EASE * (high - this.view[1])];
    return this.view;
  }

  draw() {
    if (!this.applied || this.canvas.hidden) return;
    const { context, width, height, look } = prepared(this.canvas), [low, high] = this.look();
    const left = 62, right = width - 10, top = 24, bottom = height - 36;
    const limit = this.applied.own_stiffness ? Infinity : this.channel.force_limit; // a device's own spring is not limited
    const clipped = (/** @type {number} */ f) => Math.max(-limit, Math.min(limit, f));
    const shown = (/** @type {any} */ curve) => (curve ? copies(curve, low, high) : []);
    const regions = shown(this.applied), planned = shown(this.planned);
    const forces = [...regions, ...planned].flatMap(({ one, shift }) => forcesBetween(one, low - shift, high - shift)).map(clipped);
    const edges = regions.flatMap(({ one }, i) => [i || this.applied.period ? one.f[0] : 0, i + 1 < regions.length || this.applied.period ? one.f[one.f.length - 1] : 0]);
    const here = regions.flatMap(({ one, shift }) => forcesBetween(one, this.at - shift, this.at - shift)).map(clipped);
    const largest = (/** @type {number[]} */ values) => Math.max(0, ...values.map(Math.abs));
    const all = largest(forces), inner = STEEP * largest(edges);
    const most = 1.25 * Math.max(inner > 1e-3 * all ? Math.min(all, Math.max(inner, largest(here))) : all, 1e-3 * this.channel.force_limit), room = 0.12 * most;
    const least = Math.min(...forces) < -0.02 * most ? -most : -room, up = Math.max(...forces) > 0.02 * most ? most : room;
    const x = (/** @type {number} */ at) => left + ((at - low) / (high - low)) * (right - left);
    const y = (/** @type {number} */ f) => bottom - ((f - least) / (up - least)) * (bottom - top);
    this.axes(context, look, { left, right, top, bottom, x, y, low, high, least, up });
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    for (const one of regions) ground(context, look, one, x, top, bottom);
    context.setLineDash([6, 4]);
    for (const edge of [-limit, limit]) if (edge > least && edge < up) line(context, left, y(edge), right, y(edge));
    context.setLineDash([]);
    for (const { one, shift } of regions) trace(context, one, shift, limit, x, y, one.error === null ? look.quiet : colour(one.error), look.accent);
    context.setLineDash([5, 4]);
    for (const { one, shift } of planned) trace(context, one, shift, limit, x, y, look.warm, look.warm);
    context.restore();
    this.marks(context, look, { left, right, top, x, y, low, high, limit: [-limit, limit].find((one) => one > least && one < up) });
    this.dot(context, look, { left, right, top, bottom, x, y });
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {any} frame */
  axes(context, look, { left, right, top, bottom, x, y, low, high, least, up }) {
    const [[unit, per], [unitF, perF]] = [this.position, this.force];
    context.fillStyle = look.quiet;
    context.strokeStyle = look.line;
    line(context, left, y(0), right, y(0));
    line(context, left, top, left, bottom);
    context.textAlign = "center";
    for (const at of ticks(low * per, high * per, Math.min(7, (right - left) / 50))) {
      context.fillText(short(Math.abs(at) < 1e-9 * (high - low) * per ? 0 : at), x(at / per), bottom + 15);
      line(context, x(at / per), bottom, x(at / per), bottom + 4);
    }
    context.fillText(`position of ${this.channel.name}, ${unit}; up: ${this.channel.motion === "rotary" ? "torque" : "force"}, ${unitF}`, (left + right) / 2, bottom + 32);
    context.textAlign = "right";
    for (const f of ticks(least * perF, up * perF, 6)) context.fillText(short(Math.abs(f) < 1e-9 * up * perF ? 0 : f), left - 7, y(f / perF) + 4);
    context.textAlign = "left";
    ERRORS.forEach((_, i) => {
      context.fillStyle = colour(1e-3 * 1e3 ** (i / (ERRORS.length - 1)));
      context.fillRect(44 + 16 * i, 6, 16, 8);
    });
    context.fillStyle = look.quiet;
    context.fillText("0.1 %", 4, 14);
    context.fillText("100 % error of k, b", 50 + 16 * ERRORS.length, 14);
  }

  /** Energies of snaps, places to rest, the force limit. @param {CanvasRenderingContext2D} context @param {any} look @param {any} frame */
  marks(context, look, { left, right, top, x, y, low, high, limit }) {
    const { applied } = this, within = (/** @type {number} */ at) => at > low && at < high;
    let end = left;
    context.textAlign = "center";
    context.fillStyle = look.ink;
    const snaps = repeated(applied.snaps.map((/** @type {[number, number]} */ [at, energy]) => ({ at, text: `${Number((1e3 * energy).toPrecision(3))} mJ` })), applied.period, low, high);
    for (const { at, text } of snaps.filter((one) => within(one.at)).sort((a, b) => a.at - b.at)) {
      const half = context.measureText(text).width / 2;
      if (x(at) - half < end || x(at) + half > right) continue;
      written(context, look, text, x(at), top + 14);
      end = x(at) + half + 6;
    }
    const rests = repeated(applied.places.map((/** @type {[number, number]} */ [from, to]) => ({ at: from, to })), applied.period, low, high);
    const held = this.held, near = (/** @type {any} */ one) => held.some((at) => at >= one.at - 1e-6 && at <= one.to + 1e-6);
    for (const one of rests.filter((one) => one.to > low && one.at < high)) {
      context.strokeStyle = context.fillStyle = near(one) ? look.warm : look.ink;
      context.lineWidth = 3;
      line(context, Math.max(left, x(one.at) - 1.5), y(0), Math.min(right, x(one.to) + 1.5), y(0));
      if (near(one)) context.fillText("held", x((one.at + one.to) / 2), y(0) + 16);
    }
    context.textAlign = "right";
    context.fillStyle = look.quiet;
    if (limit) context.fillText(`force limit ${short(Math.abs(limit) * this.force[1])} ${this.force[0]}`, right - 4, y(limit) - 4);
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {any} frame */
  dot(context, look, { left, right, top, bottom, x, y }) {
    const at = this.at, felt = this.applied.own_stiffness * at - this.samples.newest(2, this.channel.channel);
    const within = (/** @type {number} */ px) => Math.max(left, Math.min(right, px));
    const px = within(x(at)), py = Math.max(top, Math.min(bottom, y(felt))), to = this.hold.target(this.channel.channel);
    if (to !== null) {
      context.strokeStyle = look.warm;
      context.lineWidth = 2;
      line(context, px, py, within(x(to)), py);
    }
    context.fillStyle = look.ink;
    context.strokeStyle = look.card;
    context.lineWidth = 2;
    context.beginPath();
    context.arc(px, py, 7, 0, 7);
    context.fill();
    context.stroke();
  }

  /** @param {number} x of the pointer */
  drag(x) {
    if (!this.view || !this.channel) return;
    const { left, width } = this.canvas.getBoundingClientRect(), [low, high] = this.view;
    this.isDragged = true; // so that the place under the pointer stays
    this.hold.drag([this.channel.channel], [low + ((x - left - 62) / (width - 72)) * (high - low)]);
  }

  /** @param {number} way */
  push(way) {
    if (!this.view || !this.channel) return;
    const from = this.hold.target(this.channel.channel) ?? this.at;
    this.hold.drag([this.channel.channel], [from + 0.03 * way * (this.view[1] - this.view[0])]);
  }
}

/** What repeats, between two positions. @param {any[]} ones @param {number | null} period @param {number} low @param {number} high @returns {any[]} */
export function repeated(ones, period, low, high) {
  if (!period) return ones;
  return ones.flatMap((one) => {
    const found = [];
    for (let n = Math.floor((low - one.at) / period); one.at + n * period <= high; n++) found.push({ ...one, at: one.at + n * period, to: (one.to ?? one.at) + n * period });
    return found;
  });
}

/** The regions between two positions, each with the way by which it is moved. @param {any} curve @param {number} low @param {number} high */
function copies(curve, low, high) {
  const ones = curve.regions.map((/** @type {any} */ one) => ({ one, at: one.low }));
  return repeated(ones, curve.period, low, high).map(({ one, at }) => ({ one, shift: at - one.low })).filter(({ one, shift }) => one.high + shift > low && one.low + shift < high);
}

/** The forces of a region between two positions. @param {any} one @param {number} low @param {number} high @returns {number[]} */
function forcesBetween({ x, f, up = f, down = f }, low, high) {
  const found = [];
  for (let i = 0; i + 1 < x.length; i++) {
    const from = Math.max(low, x[i]), to = Math.min(high, x[i + 1]), way = x[i + 1] - x[i];
    if (from <= to && way > 0) for (const at of [from, to]) for (const forces of [up, down]) found.push(forces[i] + ((at - x[i]) / way) * (forces[i + 1] - forces[i]));
  }
  return found;
}

/** @param {number} error */
function colour(error) {
  const at = Math.max(0, Math.min(1, Math.log10(error * 1e3) / 3)) * (ERRORS.length - 1), i = Math.min(Math.floor(at), ERRORS.length - 2);
  const mixed = `color-mix(in srgb, ${ERRORS[i + 1]} ${100 * (at - i)}%, ${ERRORS[i]})`;
  return DARK.matches ? `color-mix(in srgb, ${mixed} 65%, white)` : mixed;
}

/** The ground of a snap, and of what is unstable. @param {CanvasRenderingContext2D} context @param {any} look @param {any} region @param {(at: number) => number} x @param {number} top @param {number} bottom */
function ground(context, look, { one, shift }, x, top, bottom) {
  const from = x(one.low + shift), to = x(one.high + shift);
  context.strokeStyle = context.fillStyle = one.stable ? look.line : look.warm;
  context.globalAlpha = one.stable ? 0.45 : 0.5;
  if (one.kind === "snap") context.fillRect(from, top, to - from, bottom - top);
  context.lineWidth = 1;
  if (!one.stable) for (let at = from - (bottom - top); at < to; at += 9) hatch(context, at, from, to, top, bottom);
  context.globalAlpha = 1;
  context.strokeStyle = look.quiet;
}

/** @param {CanvasRenderingContext2D} context @param {number} at @param {number} from @param {number} to @param {number} top @param {number} bottom */
function hatch(context, at, from, to, top, bottom) {
  const begin = Math.max(at, from), end = Math.min(at + bottom - top, to);
  if (end > begin) line(context, begin, bottom - (begin - at), end, bottom - (end - at));
}

/** The points of a line of forces over positions that does not exceed a limit. @param {number[]} x @param {number[]} f @param {number} limit */
export function limited(x, f, limit) {
  return x.flatMap((at, i) => {
    const step = i ? f[i] - f[i - 1] : 0, edges = step > 0 ? [-limit, limit] : [limit, -limit];
    const crossed = edges.map((edge) => [(edge - f[i - 1]) / step, edge]).filter(([share]) => share > 0 && share < 1);
    return [...crossed.map(([share, edge]) => [at - (1 - share) * (at - x[i - 1]), edge]), [at, Math.max(-limit, Math.min(limit, f[i]))]];
  });
}

/** The force in a region: one line, or one each way with the band between. @param {CanvasRenderingContext2D} context @param {any} one @param {number} shift @param {number} limit @param {(at: number) => number} x @param {(f: number) => number} y @param {string} ink @param {string} band */
function trace(context, one, shift, limit, x, y, ink, band) {
  const path = (/** @type {number[]} */ forces) => limited(one.x, forces, limit).map(([at, f]) => [x(at + shift), y(f)]);
  const ways = one.up ? [path(one.up), path(one.down)] : [path(one.f)];
  const through = (/** @type {number[][]} */ points) => {
    context.beginPath();
    for (const [px, py] of points) context.lineTo(px, py);
  };
  if (one.up) {
    context.globalAlpha = 0.13;
    context.fillStyle = band;
    through([...ways[0], ...ways[1].reverse()]);
    context.fill();
    context.globalAlpha = 1;
  }
  context.strokeStyle = ink;
  context.lineWidth = one.up ? 2 : 3;
  for (const way of ways) {
    through(way);
    context.stroke();
  }
}
