// @ts-check
/** A scene on a line, as its picture shows it: positions go upwards, things stand side by side. What a spring of its own
 * or a structure holds is magnified about where it rests if its motion would hardly be seen. */

import { columnsOf } from "./columns.js";
import { around, FARTHEST, NEAR, ROOM } from "./plane_view.js";

const MOST = 2000, LARGE = 0.45, SMALL = 0.03, WANTED = 0.2, KEPT = 0.97; // of the view, to and from which motion is magnified; of its peak, kept from row to row

export class LineView {
  /** @param {any} model @param {import("./picture.js").Things} things */
  constructor(model, things) {
    [this.model, this.things, this.motions] = [model, things, motionsOf(model)];
    /** @type {Record<string, {y: number, half: number, most: number}>} */
    this.ranges = {}; // of what is seen, by the kind of motion, m or rad
    /** @type {Map<string, [number, number]>} */
    this.spots = new Map();
    this.magnified = 1;
    this.peak = 0;
    this.size = [0, 0];
    this.columns = columnsOf(model.drawn, 1, 1);
  }

  /** @param {Float32Array} row @param {number} width @param {number} height pixels */
  place(row, width, height) {
    if (this.size[0] !== width || this.size[1] !== height) [this.size, this.columns] = [[width, height], columnsOf(this.model.drawn, width, height)];
    if (!Object.keys(this.ranges).length) this.begin(row);
    for (const { kind, name, rest, from } of this.things.points) {
      const range = this.range(name);
      if (kind === "ground" || rest !== null) continue;
      const far = Math.min(Math.abs(row[from] - range.y), range.most);
      if (far > range.half) range.half = 1.1 * far;
    }
    this.magnify(row);
    const { at, structures, levels } = this.columns;
    for (const { name, rest, from } of this.things.points) {
      const level = levels.get(name), base = at.get(name) ?? { x: 0, lift: 0 };
      if (!level) this.spots.set(name, [base.x, this.up(name, row[from], base.lift, rest)]);
      else this.spots.set(name, [(level.left + level.right) / 2, this.up(name, row[from], level.lift, this.things.structures.find((one) => level.of.startsWith(`${one.name}.`))?.rest ?? null)]);
    }
    for (const { name, rest, from } of this.things.structures) {
      const { base, label } = /** @type {any} */ (structures.get(name));
      for (let i = 0; i < base.length; i++) this.spots.set(label[i], [base[i].x, this.up(name, row[from + i], base[i].lift, rest)]);
    }
  }

  /** Begins with travel or reach of the hands, with what moves, and with the grounds near them. @param {Float32Array} row */
  begin(row) {
    for (const motion of new Set(this.motions.values())) {
      const own = this.things.points.filter(({ name }) => this.motions.get(name) === motion);
      const seen = own.filter(({ kind, rest }) => kind !== "ground" && rest === null).map(({ from }) => row[from]);
      for (const { channels: [channel], from } of own.filter(({ kind }) => kind === "hand")) {
        const { hand, travel: [low, high] } = this.model.channels[channel];
        seen.push(low ?? row[from] - hand.reach, high ?? row[from] + hand.reach);
      }
      const first = around((seen.length ? seen : [-0.01, 0.01]).map((at) => [0, at]));
      const near = own.map(({ from }) => row[from]).filter((at) => Math.abs(at - first.y) < NEAR * first.half);
      const { y, half } = around([first.y - first.half, first.y + first.half, ...near].map((at) => [0, at]));
      this.ranges[motion] = { y, half: (1 + ROOM) * half, most: FARTHEST * half };
    }
  }

  /** @param {string} name of a point or a structure */
  range(name) {
    return this.ranges[this.motions.get(name) ?? ""];
  }

  /** @param {Float32Array} row */
  magnify(row) {
    let share = 0;
    for (const { kind, name, rest, from, count } of [...this.things.points, ...this.things.structures]) {
      if (rest === null || kind === "ground") continue;
      const { half } = this.range(name);
      for (let i = from; i < from + count; i++) share = Math.max(share, Math.abs(row[i] - rest) / (2 * half));
    }
    this.peak = Math.max(share, KEPT * this.peak);
    const shown = this.peak * this.magnified, isLarge = shown > LARGE && this.magnified > 1, isSmall = shown < SMALL && this.magnified < MOST && share > 0;
    if (!isLarge && !isSmall) return;
    const wanted = Math.min(MOST, Math.max(1, WANTED / this.peak)), unit = 10 ** Math.floor(Math.log10(wanted));
    this.magnified = unit * (wanted >= 5 * unit ? 5 : wanted >= 2 * unit ? 2 : 1);
  }

  /** Pixels from the top. @param {string} name @param {number} at m or rad @param {number} lift @param {number | null} rest about which it is magnified */
  up(name, at, lift, rest = null) {
    const { top, bottom } = this.columns, { y, half } = this.range(name), shown = rest === null ? at : rest + this.magnified * (at - rest);
    const pixels = (top + bottom) / 2 - ((shown - y) / half) * ((bottom - top) / 2);
    return Math.min(Math.max(pixels, top - 12), bottom + 8) - lift; // what is beyond stays at the edge
  }

  /** @param {any} hand @param {number[]} place @returns {[number, number]} pixels */
  pixelsOf({ name }, [at]) {
    const { x, lift } = /** @type {any} */ (this.columns.at.get(name));
    return [x, this.up(name, at, lift)];
  }

  /** @param {any} hand @param {number} _x @param {number} y pixels @returns {number[]} */
  placeAt({ name }, _x, y) {
    const { top, bottom } = this.columns, { y: middle, half } = this.range(name);
    return [middle + (((top + bottom) / 2 - y - (this.columns.at.get(name)?.lift ?? 0)) / ((bottom - top) / 2)) * half];
  }

  /** Middle and half of what is seen around a hand. @param {any} hand */
  seen({ name }) {
    const { y, half } = this.range(name);
    return { middle: [y], half };
  }

  /** Bars that say the scale: half of what is seen, its pixels, its unit. @returns {[number, number, string][]} */
  get bars() {
    return Object.entries(this.ranges).map(([motion, { half }]) => [half, (this.columns.bottom - this.columns.top) / 2, motion === "rotary" ? "rad" : "m"]);
  }
}

/** Whether what each point and structure does is linear or rotary: as the hand that it is linked to. @param {any} model @returns {Map<string, string>} */
function motionsOf(model) {
  const links = model.drawn.filter((/** @type {any} */ one) => one.kind === "link"), neighbours = new Map(), found = new Map();
  for (const { between } of links) {
    const [a, b] = between.map((/** @type {string} */ end) => end.split(".")[0]);
    for (const [one, other] of [[a, b], [b, a]]) neighbours.set(one, (neighbours.get(one) ?? new Set()).add(other));
  }
  const hands = model.drawn.filter((/** @type {any} */ one) => one.kind === "hand");
  const front = hands.map((/** @type {any} */ one) => [one.name, model.channels[one.channels[0]].motion]);
  for (const [name, motion] of front) { // which grows meanwhile
    if (found.has(name)) continue;
    found.set(name, motion);
    for (const next of neighbours.get(name) ?? []) front.push([next, motion]);
  }
  for (const { name, kind } of model.drawn) if (!found.has(name) && kind !== "link") found.set(name, model.channels[0].motion);
  return found;
}
