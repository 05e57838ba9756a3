// @ts-check
/** A scene on a line, as its picture shows it: positions go upwards, things stand side by side. What a spring of its own
 * or a structure holds is magnified about where it rests if its motion would hardly be seen. */

import { columnsOf } from "./columns.js";
import { around, FARTHEST, NEAR, ROOM } from "./plane_view.js";

const MOST = 2000, LARGE = 0.45, SMALL = 0.03, WANTED = 0.2, KEPT = 0.97; // of what is seen, to and from which motion is magnified; of its peak, kept from row to row
const BACK = 0.002; // of the way back to the first range, from row to row

/** What is seen of one kind of motion, m or rad; at first, and at most.
 * @typedef {{low: number, high: number, first: number[], most: number[]}} Range */

export class LineView {
  /** @param {any} model @param {import("./picture.js").Things} things */
  constructor(model, things) {
    this.model = model;
    this.things = things;
    this.motions = motionsOf(model);
    /** @type {Record<string, Range>} */
    this.ranges = {}; // by the kind of motion
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
    for (const range of Object.values(this.ranges)) {
      range.low += BACK * (range.first[0] - range.low);
      range.high += BACK * (range.first[1] - range.high);
    }
    for (const { kind, name, rest, from } of this.things.points) {
      const range = this.range(name), room = 0.05 * (range.high - range.low);
      if (kind === "ground" || rest !== null) continue;
      if (row[from] < range.low) range.low = Math.max(row[from] - room, range.most[0]);
      if (row[from] > range.high) range.high = Math.min(row[from] + room, range.most[1]);
    }
    this.magnify(row);
    const { at, structures, levels } = this.columns;
    for (const { name, rest, from } of this.things.points) {
      const level = levels.get(name), base = at.get(name) ?? { x: 0, lift: 0 };
      if (!level) this.spots.set(name, [base.x, this.up(name, row[from], base.lift, rest)]);
      else this.spots.set(name, [level.right, this.up(name, row[from], level.lift, this.things.structures.find((one) => level.of.startsWith(`${one.name}.`))?.rest ?? null)]);
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
      const [low, high] = [y - (1 + ROOM) * half, y + (1 + ROOM) * half];
      this.ranges[motion] = { low, high, first: [low, high], most: [y - FARTHEST * half, y + FARTHEST * half] };
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
      const { low, high } = this.range(name);
      for (let i = from; i < from + count; i++) share = Math.max(share, Math.abs(row[i] - rest) / (high - low));
    }
    this.peak = Math.max(share, KEPT * this.peak);
    const shown = this.peak * this.magnified, isLarge = shown > LARGE && this.magnified > 1, isSmall = shown < SMALL && this.magnified < MOST && share > 0;
    if (!isLarge && !isSmall) return;
    const wanted = Math.min(MOST, Math.max(1, WANTED / this.peak)), unit = 10 ** Math.floor(Math.log10(wanted));
    this.magnified = unit * (wanted >= 5 * unit ? 5 : wanted >= 2 * unit ? 2 : 1);
  }

  /** Pixels from the top. @param {string} name @param {number} at m or rad @param {number} lift @param {number | null} rest about which it is magnified */
  up(name, at, lift, rest = null) {
    const { top, bottom } = this.columns, { low, high } = this.range(name), shown = rest === null ? at : rest + this.magnified * (at - rest);
    const pixels = bottom - ((shown - low) / (high - low)) * (bottom - top);
    return Math.min(Math.max(pixels, top - 12), bottom + 8) - lift; // what is beyond stays at the edge
  }

  /** @param {any} hand @param {number[]} place @returns {[number, number]} pixels */
  pixelsOf({ name }, [at]) {
    const { x, lift } = /** @type {any} */ (this.columns.at.get(name));
    return [x, this.up(name, at, lift)];
  }

  /** @param {any} hand @param {number} _x @param {number} y pixels @returns {number[]} */
  placeAt({ name }, _x, y) {
    const { top, bottom } = this.columns, { low, high } = this.range(name);
    return [low + ((bottom - y - (this.columns.at.get(name)?.lift ?? 0)) / (bottom - top)) * (high - low)];
  }

  /** Middle and half of what is seen around a hand. @param {any} hand */
  seen({ name }) {
    const { low, high } = this.range(name);
    return { middle: [(low + high) / 2], half: (high - low) / 2 };
  }

  /** Bars that say the scale: half of what is seen, its pixels, its unit. @returns {[number, number, string][]} */
  get bars() {
    const pixels = (this.columns.bottom - this.columns.top) / 2;
    return Object.entries(this.ranges).map(([motion, { low, high }]) => [(high - low) / 2, pixels, motion === "rotary" ? "rad" : "m"]);
  }

  /** Words on what is magnified; none if nothing is. */
  get words() {
    const held = [...this.things.structures, ...this.things.points.filter(({ kind, rest }) => kind === "mass" && rest !== null)].map(({ name }) => name);
    return this.magnified > 1 ? `motion of ${held.length > 2 ? `${held[0]} and ${held.length - 1} others` : held.join(" and ")} × ${this.magnified}` : "";
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
