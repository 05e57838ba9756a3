// @ts-check
/** The moving picture of a scene: all that the model's `drawn` lists, where the newest row has it. What is dragged in it
 * pulls the mock; what is clicked is passed on, to be plotted. */

import { dot, line, prepared, short, shownIn, spring, ticks, trace, written } from "./drawing.js";
import { LineView } from "./line_view.js";
import { PlaneView } from "./plane_view.js";

const GRASP = 16, FINGER = 36, STILL = 4; // pixels: to what is grasped by mouse and by finger; a click moves by less
const OLD = 250; // ms: drawn again, though nothing new has come
const MOST_SPRINGS = 200, MOST_NAMES = 40, MOST_DOTS = 100;

/** Entries of `drawn`, each with the place (`from`) and the number (`count`) of its values in a row.
 * @typedef {{points: any[], structures: any[], links: any[]}} Things */

export class Picture {
  /** @param {HTMLCanvasElement} canvas @param {HTMLElement} note @param {import("./hold.js").Hold} hold
   * @param {(name: string) => void} pick called with what is clicked */
  constructor(canvas, note, hold, pick) {
    this.canvas = canvas;
    this.note = note;
    this.hold = hold;
    this.pick = pick;
    /** @type {any} */
    this.model = null;
    /** @type {any[]} */
    this.hands = []; // of the things
    /** @type {Things} */
    this.things = { points: [], structures: [], links: [] };
    /** @type {LineView | PlaneView | null} */
    this.view = null;
    /** @type {Float32Array | null} */
    this.row = null; // the newest one,
    this.width = 0; // and how many values it has
    this.drawnAt = 0; // ms
    this.held = 0; // number of the hand that is dragged
    this.chosen = ""; // what was clicked
    /** @type {{x: number, y: number, name: string} | null} */
    this.down = null; // where the pointer went down, and on what
    canvas.onpointerdown = canvas.onpointermove = (event) => this.drag(event);
    canvas.onpointerup = canvas.onpointercancel = (event) => this.release(event);
    canvas.onkeyup = canvas.onblur = () => hold.release();
    canvas.onkeydown = (event) => this.push(event);
    const holdStill = (/** @type {TouchEvent} */ event) => {
      const { left, top } = canvas.getBoundingClientRect(), { clientX, clientY } = event.touches[0];
      if (this.model?.has_mock && this.grasped(clientX - left, clientY - top, FINGER).isHand) event.preventDefault(); // a finger elsewhere scrolls the page
    };
    canvas.addEventListener("touchstart", holdStill, { passive: false });
  }

  /** @param {any} model */
  describe(model) {
    const of = (/** @type {string[]} */ ...kinds) => model.drawn.filter((/** @type {any} */ one) => kinds.includes(one.kind));
    this.things = { points: of("hand", "mass", "ground"), structures: of("structure"), links: of("link") };
    this.width = 1;
    for (const one of [...this.things.points, ...this.things.structures, ...this.things.links]) {
      one.count = one.kind === "link" ? Number(one.is_contact) : one.columns ? (one.rows?.length ?? 1) * one.columns.length : model.space;
      [one.from, this.width] = [this.width, this.width + one.count];
    }
    this.model = model;
    this.row = null;
    this.hands = of("hand");
    this.view = model.space > 1 ? new PlaneView(model, this.things) : new LineView(model, this.things);
    this.held = Math.min(this.held, this.hands.length - 1);
    this.canvas.classList.toggle("square", model.space > 1);
    const { hand, unit_force, unit_position } = model.channels[0], [unit, factor] = shownIn(`${unit_force}/${unit_position}`, model.written);
    const pull = `Drag: a spring of ${short(hand.stiffness * factor)} ${unit} pulls the handle along. `;
    this.note.textContent = `${model.has_mock ? pull : ""}Click: the scope shows what is clicked.`;
  }

  /** @param {import("./connection.js").Block} block */
  take({ rows, columns, values }) {
    if (columns === this.width) [this.row, this.drawnAt] = [values.subarray((rows - 1) * columns), 0]; // else it is of another scene
  }

  draw() {
    if (!this.row || !this.view || !this.canvas.clientWidth || performance.now() < this.drawnAt + OLD) return;
    this.drawnAt = performance.now();
    const { context, width, height, look } = prepared(this.canvas), { points, structures, links } = this.things, { view, row } = this;
    view.place(row, width, height);
    const touching = links.filter((one) => one.is_contact && row[one.from]), touched = new Set(touching.flatMap(({ between }) => between));
    if (view instanceof PlaneView) view.drawBehind(context, look, new Set(touching.map(({ name }) => name)));
    for (const one of links) if (!one.has_outline) this.drawLink(context, look, one, touching.includes(one));
    for (const one of structures) this.drawStructure(context, look, one, /** @type {LineView} */ (view));
    for (const isGround of [true, false]) for (const one of points) if ((one.kind === "ground") === isGround) this.drawPoint(context, look, one, touched.has(one.name));
    if (points.length <= MOST_NAMES) for (const one of points) this.drawName(context, look, one, width);
    const chosen = view.spots.get(this.chosen), from = view.spots.get(this.hands[this.held]?.name);
    if (chosen) {
      dot(context, ...chosen, 10, look.warm, false);
      [context.fillStyle, context.textAlign] = [look.ink, chosen[0] < width / 2 ? "left" : "right"];
      written(context, look, this.chosen, chosen[0] + (chosen[0] < width / 2 ? 14 : -14), chosen[1] - 12);
    }
    context.strokeStyle = look.warm;
    context.lineWidth = 2;
    if (this.hold.to && from && this.hold.channels === this.hands[this.held].channels) line(context, ...from, ...view.pixelsOf(this.hands[this.held], this.hold.to));
    this.drawScale(context, look, height);
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {any} link @param {boolean} isTouching */
  drawLink(context, look, { name, type, between, is_contact }, isTouching) {
    const [a, b] = between.map((/** @type {string} */ end) => this.view?.spots.get(end)), isApart = is_contact && !isTouching;
    if (!a || !b) return;
    const columns = this.view instanceof LineView ? this.view.columns : null, ground = between.findIndex((/** @type {string} */ end) => columns?.levels.has(end));
    const x = ground < 0 ? 0 : (ground ? a : b)[0] + (columns?.aside.get(name) ?? 0); // of a link that stands upright on a ground
    const ends = ground < 0 ? [a, b] : [[x, a[1]], [x, b[1]]];
    context.strokeStyle = isTouching ? look.warm : look.quiet;
    context.lineWidth = isTouching ? 2.5 : 1;
    context.setLineDash(isApart ? [3, 4] : []);
    const isPlain = isApart || type === "damper" || type === "friction" || this.things.links.length > MOST_SPRINGS;
    trace(context, isPlain ? ends : spring(ends[0], ends[1]));
    context.setLineDash([]);
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {any} structure @param {LineView} view */
  drawStructure(context, look, { name, rows, columns, rest, is_fixed }, view) {
    const { label, left, right } = /** @type {any} */ (view.columns.structures.get(name)), wide = columns.length;
    const spots = label.map((/** @type {string} */ one) => view.spots.get(one)), middle = view.up(name, rest, 0);
    if (!rows) {
      const ends = [[left, middle], [right, middle]];
      [context.strokeStyle, context.lineWidth] = [look.line, 1];
      trace(context, ends);
      [context.strokeStyle, context.lineWidth] = [look.ink, 1.5];
      trace(context, [...ends.slice(0, is_fixed[0]), ...spots, ...ends.slice(1, 1 + is_fixed[1])]);
      for (const [x, y] of spots.length <= MOST_DOTS ? spots : []) dot(context, x, y, 2, look.ink);
    }
    for (let row = 0; row < (rows?.length ?? 0); row++) { // from the back to the front, which hides what is behind it
      const here = spots.slice(row * wide, (row + 1) * wide), before = row ? spots.slice((row - 1) * wide, row * wide) : here;
      [context.strokeStyle, context.fillStyle, context.lineWidth] = [look.quiet, look.card, 0.5];
      for (let column = 0; column < wide; column += Math.ceil(wide / 20)) trace(context, [before[column], here[column]]);
      [context.strokeStyle, context.lineWidth] = [look.accent, 1];
      trace(context, here);
    }
    context.fillStyle = look.quiet;
    context.textAlign = "right"; // the scale's length stands on the left
    context.fillText(name, right, view.columns.bottom + 14);
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {any} point @param {boolean} isTouched */
  drawPoint(context, look, { kind, name }, isTouched) {
    const [x, y] = this.view?.spots.get(name) ?? [0, 0], columns = this.view instanceof LineView ? this.view.columns : null, room = columns?.unit ?? Infinity;
    const level = columns?.levels.get(name);
    [context.strokeStyle, context.lineWidth] = [look.quiet, 1.5];
    if (level) {
      line(context, level.left, y, level.right, y);
      for (let at = level.left + 6; at < level.right; at += 9) line(context, at, y, at - 5, y + 5);
    } else if (kind === "hand" && columns) {
      context.fillStyle = isTouched ? look.warm : look.accent;
      context.beginPath();
      context.roundRect(x - Math.min(22, room / 2), y - 7, Math.min(44, room), 14, 5);
      context.fill();
    } else dot(context, x, y, kind === "hand" ? 10 : kind === "ground" ? 3 : Math.max(1.5, Math.min(6, room / 3)), kind === "hand" ? look.accent : look.ink);
    if (kind === "hand" && !columns && isTouched) dot(context, x, y, 14, look.warm, false);
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {any} point @param {number} width */
  drawName(context, look, { kind, name }, width) {
    const [x, y] = this.view?.spots.get(name) ?? [0, 0], columns = this.view instanceof LineView ? this.view.columns : null, level = columns?.levels.get(name);
    const long = context.measureText(name).width, column = columns?.order.indexOf(name) ?? -1, isCrowded = columns && long > columns.unit - 4;
    let [left, up] = [x + (kind === "hand" ? 15 : 9), y - 8];
    if (columns && level) [left, up] = [level.right - long, y + 17];
    else if (columns && column >= 0) [left, up] = [x - long / 2, columns.bottom + (isCrowded ? 14 + 12 * (column % 2) : 14)];
    else if (columns) [left, up] = [x + (kind === "hand" ? 26 : 9), y - 6];
    context.fillStyle = look.quiet;
    context.textAlign = "left";
    written(context, look, name, Math.max(2, Math.min(left, width - long - 2)), up);
  }

  /** @param {CanvasRenderingContext2D} context @param {any} look @param {number} height */
  drawScale(context, look, height) {
    const isPlane = this.view instanceof PlaneView;
    [context.strokeStyle, context.fillStyle, context.lineWidth, context.textAlign] = [look.ink, look.quiet, 1, "left"];
    if (this.view instanceof LineView) context.fillText(this.view.words, 10, 14);
    this.view?.bars.forEach(([half, pixels, si], i) => {
      const [unit, factor] = shownIn(si, this.model.written), size = ticks(0, half * factor, 3)[1];
      const long = (size / factor / half) * pixels, x = 10 + 52 * i, y = isPlane ? height - 12 : height - 40;
      line(context, x, y, isPlane ? x + long : x, isPlane ? y : y - long);
      context.fillText(`${short(size)} ${unit}`, x, isPlane ? y - 6 : y + 14);
    });
  }

  /** What is nearest, if it is near. @param {number} x @param {number} y @param {number} reach pixels */
  grasped(x, y, reach) {
    let [name, away] = ["", reach];
    for (const [one, [left, top]] of this.view?.spots ?? []) if (Math.hypot(left - x, top - y) < away) [name, away] = [one, Math.hypot(left - x, top - y)];
    return { name, isHand: this.hands.some((/** @type {any} */ one) => one.name === name) };
  }

  /** @param {PointerEvent} event */
  drag({ type, offsetX: x, offsetY: y, pointerId, pointerType }) {
    if (!this.row || !this.view) return;
    if (type === "pointerdown") {
      const isFinger = pointerType === "touch", { name, isHand } = this.grasped(x, y, isFinger ? FINGER : GRASP);
      this.down = { x, y, name };
      if (!this.model.has_mock || !(isHand || (!name && !isFinger))) return; // a mouse pulls the nearest hand from afar
      this.canvas.setPointerCapture(pointerId);
      const far = this.hands.map(({ name: one }) => Math.hypot(...(this.view?.spots.get(one) ?? [0, 0]).map((at, axis) => at - [x, y][axis])));
      this.held = far.indexOf(Math.min(...far));
    } else if (this.hold.to === null) return;
    const hand = this.hands[this.held];
    this.hold.drag(hand.channels, this.view.placeAt(hand, x, y));
  }

  /** @param {PointerEvent} event */
  release({ type, offsetX, offsetY }) {
    const { x, y, name } = this.down ?? { x: 0, y: 0, name: "" };
    if (type === "pointerup" && name && Math.hypot(offsetX - x, offsetY - y) < STILL) this.pick((this.chosen = name));
    this.down = null;
    this.hold.release();
  }

  /** @param {KeyboardEvent} event */
  push(event) {
    const [axis, way] = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1] }[event.key] ?? [2, 0];
    if (!way || !this.row || !this.view || !this.model.has_mock) return;
    event.preventDefault();
    const hand = this.hands[this.held], { middle, half } = this.view.seen(hand), at = Math.min(axis, this.model.space - 1);
    const to = [...(this.hold.to ?? this.row.subarray(hand.from, hand.from + hand.count))];
    to[at] = middle[at] + Math.max(-half, Math.min(half, to[at] - middle[at] + 0.05 * way * half));
    this.hold.drag(hand.channels, to);
  }
}
