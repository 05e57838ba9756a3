// @ts-check
/** A scene in the plane, as its picture shows it: seen from above, with the outlines of its surfaces and paths. */

export const NEAR = 5, FARTHEST = 5; // halves of a view: what rests farther away does not widen the first one; what moves widens it so far
export const ROOM = 0.15; // of what there is, around it
const GLOW = 70; // pixels around the place that is touched

/** @typedef {[number, number]} Place */

export class PlaneView {
  /** @param {any} model @param {import("./picture.js").Things} things */
  constructor(model, things) {
    this.model = model;
    this.things = things;
    /** @type {Float32Array | null} */
    this.row = null;
    /** @type {Place} */
    this.middle = [0, 0]; // m
    this.half = this.most = 0; // of what is seen, m
    /** @type {Map<string, Place>} */
    this.spots = new Map();
    this.size = [1, 1];
    this.outlines = model.drawn.filter((/** @type {any} */ one) => one.places);
    /** @type {any[][]} */
    this.surfaces = []; // outlines that bound one material together
    for (const one of this.outlines) {
      const last = this.surfaces[this.surfaces.length - 1]?.[0];
      if (last && isSolid(one) && isSolid(last) && last.of === one.of && last.about === one.about) this.surfaces[this.surfaces.length - 1].push(one);
      else this.surfaces.push([one]);
    }
  }

  /** @param {Float32Array} row @param {number} width @param {number} height pixels */
  place(row, width, height) {
    [this.row, this.size] = [row, [width, height]];
    if (!this.half) this.begin();
    for (const one of this.things.points) {
      const place = this.at(one.name), far = Math.max(...place.map((at, axis) => Math.abs(at - this.middle[axis])));
      if (one.kind !== "ground" && far > this.half) this.half = Math.min(1.1 * far, this.most);
      this.spots.set(one.name, this.pixelsOf(one, place));
    }
  }

  /** Begins with the travel or the reach of the hands, with what moves, and of all else with what is near. */
  begin() {
    const { points } = this.things, travel = this.outlines.find((/** @type {any} */ { kind }) => kind === "travel"), { reach } = this.model.channels[0].hand;
    const hands = points.filter(({ kind }) => kind === "hand").map(({ name }) => this.at(name));
    const seen = [...points.filter(({ kind }) => kind === "mass").map(({ name }) => this.at(name)), ...hands];
    seen.push(...(travel ? travel.places : hands.flatMap(([x, y]) => [[x - reach, y - reach], [x + reach, y + reach]])));
    const first = around(seen), near = [...points.map(({ name }) => this.at(name)), ...this.outlines.flatMap((/** @type {any} */ one) => this.along(one))];
    seen.push(...near.filter(([x, y]) => Math.max(Math.abs(x - first.x), Math.abs(y - first.y)) < NEAR * first.half));
    const { x, y, half } = around(seen);
    [this.middle, this.half, this.most] = [[x, y], (1 + 2 * ROOM) * half, FARTHEST * half];
  }

  /** Position of a point, m; of none 0. @param {string} name @returns {Place} */
  at(name) {
    const from = this.things.points.find((one) => one.name === name)?.from;
    return this.row && from ? [this.row[from], this.row[from + 1]] : [0, 0];
  }

  /** Places along an outline, m. @param {any} outline @returns {Place[]} */
  along({ places, about }) {
    const [x, y] = this.at(about);
    return places.map((/** @type {Place} */ [dx, dy]) => [x + dx, y + dy]);
  }

  get scale() {
    return Math.min(...this.size) / 2 / this.half;
  }

  /** @param {any} _hand @param {number[]} place m @returns {Place} pixels */
  pixelsOf(_hand, [x, y]) {
    return [this.size[0] / 2 + (x - this.middle[0]) * this.scale, this.size[1] / 2 - (y - this.middle[1]) * this.scale];
  }

  /** @param {any} _hand @param {number} x @param {number} y pixels @returns {Place} m */
  placeAt(_hand, x, y) {
    return [this.middle[0] + (x - this.size[0] / 2) / this.scale, this.middle[1] - (y - this.size[1] / 2) / this.scale];
  }

  /** Middle and half of what is seen. @param {any} _hand */
  seen(_hand) {
    return { middle: this.middle, half: this.half };
  }

  /** Bars that say the scale: half of what is seen, its pixels, its unit. @returns {[number, number, string][]} */
  get bars() {
    return [[this.half, Math.min(...this.size) / 2, "m"]];
  }

  /** Draws what is behind all points. @param {CanvasRenderingContext2D} context @param {any} look @param {Set<string>} touching links */
  drawBehind(context, look, touching) {
    const hands = this.things.points.filter(({ kind }) => kind === "hand").map(({ name }) => name);
    for (const outlines of this.surfaces) {
      const [one] = outlines, names = outlines.flatMap(({ name }) => name.split(", ")), spot = this.spots.get(one.of);
      context.beginPath();
      for (const each of outlines) this.along(each).forEach((place, n) => context[n ? "lineTo" : "moveTo"](...this.pixelsOf(each, place)));
      context.setLineDash(isSolid(one) ? [] : one.kind === "guide" ? [6, 4] : [2, 4]);
      context.strokeStyle = one.kind === "travel" ? look.line : look.quiet;
      context.lineWidth = 1.5;
      context.stroke();
      context.setLineDash([]);
      if (spot && names.some((name) => touching.has(name))) {
        const glow = context.createRadialGradient(...spot, 0, ...spot, GLOW);
        for (const [share, colour] of /** @type {[number, string][]} */ ([[0.4, look.warm], [1, "transparent"]])) glow.addColorStop(share, colour);
        [context.strokeStyle, context.lineWidth] = [glow, 3];
        context.stroke();
      }
      if (one.kind === "inside") context.rect(-1, -1, this.size[0] + 2, this.size[1] + 2);
      context.fillStyle = look.quiet;
      context.globalAlpha = 0.14;
      if (isSolid(one) && (hands.includes(one.of) || hands.includes(one.about))) context.fill("evenodd"); // others are not felt
      context.globalAlpha = 1;
    }
  }
}

/** @param {any} outline */
const isSolid = ({ kind }) => kind === "outside" || kind === "inside";

/** Middle of places, and half of the longer side. @param {number[][]} places */
export function around(places) {
  const [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
  for (const place of places) place.forEach((at, axis) => ([low[axis], high[axis]] = [Math.min(low[axis], at), Math.max(high[axis], at)]));
  return { x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2, half: Math.max(high[0] - low[0], high[1] - low[1]) / 2 };
}
