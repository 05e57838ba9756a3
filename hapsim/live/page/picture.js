// @ts-check
/** The picture of a scene: its hand on a line, or its hands among outlines and points in the plane. What is dragged in
 * it pulls the mock. */

import { line, prepared, shownIn } from "./drawing.js";
import { coordinatesOf, drawTable, handsOf, placesOf, viewOf } from "./table.js";

export class Picture {
  /** @param {HTMLCanvasElement} canvas @param {HTMLElement} note @param {import("./samples.js").Samples} samples @param {import("./hold.js").Hold} hold */
  constructor(canvas, note, samples, hold) {
    [this.canvas, this.note, this.samples, this.hold] = [canvas, note, samples, hold];
    /** @type {any} */
    this.model = null;
    this.reach = 0; // of the line
    /** @type {import("./table.js").View | null} */
    this.view = null; // of the plane
    this.held = 0; // the hand that is dragged: of the plane
    canvas.onpointerdown = canvas.onpointermove = (event) => this.drag(event);
    canvas.onpointerup = canvas.onpointercancel = canvas.onkeyup = canvas.onblur = () => hold.release();
    canvas.onkeydown = (event) => this.push(event);
  }

  /** @param {any} model */
  describe(model) {
    this.model = model;
    const { hand, unit_force, unit_position } = model.channels[0];
    const [unit, factor] = shownIn(`${unit_force}/${unit_position}`, model.written);
    this.reach = Math.max(this.reach, hand.reach);
    this.view = null;
    this.canvas.classList.toggle("square", this.isPlane);
    this.note.textContent = `Drag: a spring of ${Number((hand.stiffness * factor).toPrecision(3))} ${unit} pulls the handle along.`;
  }

  get isPlane() {
    return this.model?.space > 1;
  }

  /** Names that it needs the positions of. */
  get watched() {
    return this.isPlane ? coordinatesOf(this.model) : [];
  }

  draw() {
    if (!this.model?.has_mock) return;
    this.isPlane ? this.drawPlane() : this.drawLine();
  }

  drawPlane() {
    const { model, samples, hold } = this, channels = handsOf(model)[this.held];
    const hands = model.channels.map((/** @type {any} */ one) => [one.name, samples.position(one.channel)]);
    const places = placesOf(new Map([...hands, ...samples.latest]));
    this.view = viewOf(model, places, this.view);
    const from = /** @type {[number, number]} */ (channels.map((one) => samples.position(one)));
    drawTable(prepared(this.canvas), model, places, this.view, hold.to && { from, to: [hold.to[0], hold.to[1]] });
    if (!model.outlines.every((/** @type {any} */ one) => !one.about || places.has(one.about))) this.view = null; // more is to come
  }

  drawLine() {
    const { context, width, height, look } = prepared(this.canvas);
    const position = this.samples.position(0);
    this.reach = Math.max(this.reach, Math.abs(position) * 1.1);
    const x = (/** @type {number} */ at) => width / 2 + (at / this.reach) * (width / 2 - 20), y = height / 2;
    context.strokeStyle = look.line;
    line(context, 10, y, width - 10, y);
    line(context, x(0), y - 14, x(0), y + 14);
    if (this.hold.to !== null) {
      context.strokeStyle = look.warm;
      context.lineWidth = 2;
      line(context, x(position), y, x(this.hold.to[0]), y);
    }
    context.fillStyle = look.accent;
    context.beginPath();
    context.roundRect(x(position) - 9, y - 24, 18, 48, 5);
    context.fill();
  }

  /** @param {PointerEvent} event */
  drag(event) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect(), { view, samples } = this;
    if (this.isPlane && !view) return;
    const along = (2 * (event.clientX - left)) / width - 1, up = 1 - (2 * (event.clientY - top)) / height, side = Math.min(width, height);
    const to = this.isPlane && view ? [view.x + along * view.half * (width / side), view.y + up * view.half * (height / side)] : [along * this.reach];
    if (event.type === "pointerdown") {
      this.canvas.setPointerCapture(event.pointerId);
      const away = handsOf(this.model).map((channels) => Math.hypot(...channels.map((one, axis) => samples.position(one) - to[axis])));
      this.held = Math.max(0, away.indexOf(Math.min(...away)));
    } else if (this.hold.to === null) return;
    this.hold.drag(this.channels, to);
  }

  /** The channels that are dragged. */
  get channels() {
    return this.isPlane ? handsOf(this.model)[this.held] : [0];
  }

  /** @param {KeyboardEvent} event */
  push(event) {
    const [axis, way] = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1] }[event.key] ?? [2, 0];
    if (axis >= this.model?.space || !way) return;
    event.preventDefault();
    const { view } = this, farthest = view?.half ?? this.reach, middle = view ? [view.x, view.y] : [0];
    const to = [...(this.hold.to ?? (view ? this.channels.map((one) => this.samples.position(one)) : [0]))];
    to[axis] = middle[axis] + Math.max(-farthest, Math.min(farthest, to[axis] - middle[axis] + 0.05 * way * farthest));
    this.hold.drag(this.channels, to);
  }
}
