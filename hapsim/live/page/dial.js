// @ts-check
/** The dial of a rotary hand: its angle, its places to rest and its stops. What turns it turns the mock. */

import { line, prepared, short } from "./drawing.js";
import { repeated } from "./force.js";

const TURN = 2 * Math.PI, DEGREES = 360 / TURN;

export class Dial {
  /** @param {HTMLCanvasElement} canvas @param {import("./force.js").Force} force */
  constructor(canvas, force) {
    this.canvas = canvas;
    this.force = force;
    this.from = 0; // of the pointer, rad
    this.to = 0; // of the hand, rad
    force.hold.attach(canvas, (event) => this.turn(event), (way) => force.push(way));
  }

  /** @param {any} model */
  describe(model) {
    this.canvas.style.touchAction = model.has_mock ? "none" : "";
    this.canvas.style.cursor = model.has_mock ? "grab" : "";
  }

  draw() {
    const { applied, channel, at, hold } = this.force;
    this.canvas.hidden = !applied || channel.motion !== "rotary";
    if (this.canvas.hidden) return;
    const { context, width, height, look } = prepared(this.canvas), radius = Math.min(width, height) / 2 - 16;
    const point = (/** @type {number} */ angle, /** @type {number} */ r) => [width / 2 + r * Math.sin(angle), height / 2 - r * Math.cos(angle)];
    const ray = (/** @type {number} */ angle, /** @type {number} */ from, /** @type {number} */ to) => line(context, .../** @type {[number, number]} */ (point(angle, from)), .../** @type {[number, number]} */ (point(angle, to)));
    const arc = (/** @type {number} */ from, /** @type {number} */ to, /** @type {number} */ r) => {
      context.beginPath();
      context.arc(width / 2, height / 2, r, from - TURN / 4, to - TURN / 4);
      context.stroke();
    };
    context.strokeStyle = look.line;
    context.lineWidth = 2;
    arc(0, TURN, radius);
    const isNear = (/** @type {number} */ angle) => Math.abs(angle - at) <= TURN / 2; // of several turns, the one of the hand
    const rests = repeated(applied.places.map((/** @type {[number, number]} */ [from, to]) => ({ at: from, to })), applied.period, at - TURN / 2, at + TURN / 2);
    const held = this.force.held;
    for (const one of rests.filter((one) => isNear((one.at + one.to) / 2))) {
      const isHeld = held.some((place) => place >= one.at - 1e-6 && place <= one.to + 1e-6);
      context.strokeStyle = isHeld ? look.warm : look.quiet;
      context.lineWidth = 3;
      ray((one.at + one.to) / 2, radius - (isHeld ? 14 : 8), radius + 4);
      if (one.to > one.at) arc(one.at, one.to, radius);
    }
    const [low, high] = channel.travel, ends = [[low, 1], [high, -1]].filter(([end]) => end !== null);
    context.strokeStyle = look.warm;
    for (const [end, way] of [...applied.stops, ...ends].filter(([end]) => isNear(end))) {
      context.lineWidth = 5;
      ray(end, radius - 18, radius + 8);
      context.lineWidth = 2;
      for (let i = 1; i < 5; i++) ray(end - 0.05 * way * i, radius - 3, radius + 6); // what is beyond
    }
    const to = hold.target(channel.channel);
    if (to !== null) {
      context.lineWidth = 2;
      ray(to, 0.3 * radius, radius - 6);
      arc(Math.max(Math.min(at, to), to - TURN), Math.min(Math.max(at, to), to + TURN), 0.8 * radius);
    }
    context.strokeStyle = context.fillStyle = look.accent;
    context.lineWidth = 5;
    context.lineCap = "round";
    ray(at, 0.5 * radius, radius - 10);
    context.textAlign = "center";
    context.fillStyle = look.ink;
    context.font = "600 17px system-ui, sans-serif";
    const turns = Math.trunc(at / TURN);
    context.fillText(`${short(Math.round(10 * DEGREES * at) / 10)}°`, width / 2, height / 2 + 6);
    context.font = "12px system-ui, sans-serif";
    if (turns) context.fillText(`${turns} ${Math.abs(turns) > 1 ? "turns" : "turn"} and ${Math.round(DEGREES * (at - turns * TURN))}°`, width / 2, height / 2 + 24);
  }

  /** @param {PointerEvent} event */
  turn(event) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect(), { hold, channel, at } = this.force;
    const angle = Math.atan2(event.clientX - left - width / 2, top + height / 2 - event.clientY);
    if (event.type === "pointerdown") [this.from, this.to] = [angle, at];
    const way = angle - this.from;
    this.from = angle;
    this.to += way - TURN * Math.round(way / TURN);
    hold.drag([channel.channel], [this.to]);
  }
}
