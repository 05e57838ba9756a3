// @ts-check
/** What a hand feels, and where it is in the plane of stiffness and damping. */

import { line, prepared, short, ticks, written } from "./drawing.js";

export class Plane {
  /** @param {HTMLCanvasElement} canvas @param {HTMLElement} felt @param {HTMLElement} note */
  constructor(canvas, felt, note) {
    this.canvas = canvas;
    this.felt = felt;
    this.note = note;
    /** @type {any} */
    this.applied = null;
    /** @type {any} */
    this.planned = null; // while a slider moves
    this.hand = 0;
    this.isRotary = false;
  }

  /** @param {any} predicted @param {boolean} isApplied */
  show(predicted, isApplied) {
    if (isApplied) [this.applied, this.planned] = [predicted, null];
    else this.planned = predicted;
    const now = this.planned ?? predicted, hand = now.hands?.[this.hand];
    const [stiffness, damping] = this.isRotary ? ["N·m/rad", "N·m·s/rad"] : ["N/m", "N·s/m"];
    this.felt.textContent = hand
      ? `${short(hand.K)} ${stiffness} and ${short(hand.B)} ${damping} feel like ${short(hand.k)} and ${short(hand.b)}\n` +
        `${now.stable ? "stable" : "unstable"}${this.planned ? ", not applied yet" : ""}; ${margin(hand)}`
      : `${now.stable ? "stable" : "unstable"} (spectral radius ${short(now.spectral_radius)})`;
    this.felt.classList.toggle("bad", !now.stable);
    this.canvas.hidden = !hand;
    const why = Object.entries(now.why ?? {}).map(([name, reason]) => `${name}: ${reason}`);
    if (hand) this.note.textContent = now.plane ? "" : "With a correction, K and B are not what is simulated: no boundary of theirs is drawn.";
    else this.note.textContent = why.join("; ") || "No single k and b describe what this hand feels.";
    if (now.wire_delay) this.note.textContent += ` ${now.wire_delay}.`;
    this.draw();
  }

  draw() {
    if (this.canvas.hidden) return;
    const { context, width, height, look } = prepared(this.canvas);
    const hand = this.applied?.hands?.[this.hand], planned = this.planned?.hands?.[this.hand];
    if (!hand) return;
    const plane = (this.planned ?? this.applied)?.plane, at = [hand, ...(planned ? [planned] : [])];
    const [mostK, mostB] = reach(at, plane);
    const left = 58, right = width - 10, top = 10, bottom = height - 36;
    const x = (/** @type {number} */ K) => left + (K / mostK) * (right - left);
    const y = (/** @type {number} */ B) => bottom - (B / mostB) * (bottom - top);
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    if (plane?.B.length) shade(context, look, plane, x, y);
    context.restore();
    context.fillStyle = look.quiet;
    context.strokeStyle = look.line;
    context.lineWidth = 1;
    line(context, left, bottom, right, bottom);
    line(context, left, top, left, bottom);
    context.textAlign = "center";
    for (const K of ticks(0, mostK, 5)) context.fillText(short(K), x(K), bottom + 15);
    context.textAlign = "right";
    for (const B of ticks(0, mostB, 5)) context.fillText(short(B), left - 7, y(B) + 4);
    context.textAlign = "center";
    context.fillText(this.isRotary ? "stiffness, N·m/rad; up: damping, N·m·s/rad" : "stiffness, N/m; up: damping, N·s/m", (left + right) / 2, height - 4);
    context.textAlign = "left";
    if (plane?.B.length) written(context, look, "stable", left + 10, top + 18);
    for (const one of at) {
      const isPlanned = one === planned, colour = isPlanned ? look.warm : look.ink;
      const from = { x: x(one.K), y: y(one.B) }, to = { x: x(one.k), y: Math.min(y(one.b), bottom) };
      arrow(context, colour, from, to);
      dot(context, colour, from, !isPlanned);
      if (one === at[at.length - 1]) label(context, look, colour, from, to, isPlanned ? "not applied yet" : "K, B of the scene", right);
    }
  }
}

/** How far the axes go. @param {any[]} hands @param {any} plane */
function reach(hands, plane) {
  const far = Math.max(0, ...(plane?.most.filter(Number.isFinite) ?? [])), up = Math.max(0, ...(plane?.B ?? []));
  const mostK = 1.6 * Math.max(...hands.flatMap((one) => [one.K, one.k ?? 0])), mostB = 2.2 * Math.max(...hands.flatMap((one) => [one.B, one.b ?? 0]));
  return [(far && Math.min(1.08 * far, Math.max(mostK, 0.25 * far))) || mostK || 1, (up && Math.min(1.08 * up, Math.max(mostB, 0.12 * up))) || mostB || 1];
}

/** @param {CanvasRenderingContext2D} context @param {any} look @param {any} plane @param {(K: number) => number} x @param {(B: number) => number} y */
function shade(context, look, plane, x, y) {
  context.beginPath();
  plane.B.forEach((/** @type {number} */ B, /** @type {number} */ i) => context.lineTo(x(plane.most[i] ?? 0), y(B)));
  for (let i = plane.B.length - 1; i >= 0; i--) context.lineTo(x(plane.least[i] ?? 0), y(plane.B[i]));
  context.closePath();
  context.globalAlpha = 0.12;
  context.fillStyle = look.accent;
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = look.accent;
  context.lineWidth = 1.5;
  context.stroke();
}

/** @param {any} hand */
function margin(hand) {
  const factor = hand.stiffness_factor;
  if (factor === null) return "stable whatever its stiffness";
  return factor > 1 ? `unstable from ${short(factor)} times its stiffness` : `stable below ${short(factor)} of its stiffness`;
}

/** @typedef {{x: number, y: number}} Point */

/** @param {CanvasRenderingContext2D} context @param {string} colour @param {Point} at @param {boolean} isFull */
function dot(context, colour, at, isFull) {
  context.fillStyle = context.strokeStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(at.x, at.y, 5, 0, 7);
  if (isFull) context.fill();
  else context.stroke();
}

/** From K and B to the k and b that are felt. @param {CanvasRenderingContext2D} context @param {string} colour @param {Point} from @param {Point} to */
function arrow(context, colour, from, to) {
  const angle = Math.atan2(to.y - from.y, to.x - from.x);
  if (!Number.isFinite(to.x + to.y) || Math.hypot(to.x - from.x, to.y - from.y) < 9) return;
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = 1.5;
  line(context, from.x + 6 * Math.cos(angle), from.y + 6 * Math.sin(angle), to.x, to.y);
  context.beginPath();
  for (const [along, across] of [[0, 0], [-9, 3.5], [-9, -3.5]])
    context.lineTo(to.x + along * Math.cos(angle) - across * Math.sin(angle), to.y + along * Math.sin(angle) + across * Math.cos(angle));
  context.fill();
}

/** @param {CanvasRenderingContext2D} context @param {any} look @param {string} colour @param {Point} from @param {Point} to @param {string} text @param {number} right */
function label(context, look, colour, from, to, text, right) {
  context.fillStyle = colour;
  const [above, below] = from.y < to.y ? [text, "felt"] : ["felt", text], upper = from.y < to.y ? from : to, lower = upper === from ? to : from;
  const write = (/** @type {string} */ words, /** @type {Point} */ at, /** @type {number} */ dy) => {
    const isLeft = at.x + 12 + context.measureText(words).width > right;
    context.textAlign = isLeft ? "right" : "left";
    written(context, look, words, at.x + (isLeft ? -10 : 10), at.y + dy);
  };
  const isClose = Math.hypot(to.x - from.x, to.y - from.y) < 9 || !Number.isFinite(to.x + to.y);
  if (isClose) write(`${text}, felt as it is`, from, 4);
  else {
    write(above, upper, 0);
    write(below, lower, 8);
  }
  context.textAlign = "left";
}
