// @ts-check
/** What the hand feels, and where it is in the plane of stiffness and damping. */

import { line, prepared, short, ticks } from "./scope.js";

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
    this.isRotary = false;
  }

  /** @param {any} predicted @param {boolean} isApplied */
  show(predicted, isApplied) {
    if (isApplied) [this.applied, this.planned] = [predicted, null];
    else this.planned = predicted;
    const now = this.planned ?? predicted, hand = now.hands?.[0];
    const [stiffness, damping] = this.isRotary ? ["N·m/rad", "N·m·s/rad"] : ["N/m", "N·s/m"];
    this.felt.textContent = hand
      ? `${short(hand.K)} ${stiffness} and ${short(hand.B)} ${damping} feel like ${short(hand.k)} and ${short(hand.b)}\n` +
        `${now.stable ? "stable" : "unstable"}${this.planned ? ", not applied yet" : ""}; ${margin(hand)}`
      : `${now.stable ? "stable" : "unstable"} (spectral radius ${short(now.spectral_radius)})`;
    this.felt.classList.toggle("bad", !now.stable);
    const why = Object.entries(now.why ?? {}).map(([name, reason]) => `${name}: ${reason}`);
    this.note.textContent = hand ? "" : why.join("; ") || "No single k and b describe what this hand feels.";
    this.draw();
  }

  draw() {
    const { context, width, height, look } = prepared(this.canvas);
    const hand = this.applied?.hands?.[0], plane = (this.planned ?? this.applied)?.plane;
    if (!hand || !plane?.B.length) return;
    const planned = this.planned?.hands?.[0];
    const at = [hand, ...(planned ? [planned] : [])];
    const far = Math.max(...plane.most.filter(Number.isFinite)), up = Math.max(...plane.B);
    const mostK = Math.min(far * 1.08, Math.max(...at.map((one) => one.K)) * 3) || far;
    const mostB = Math.min(up * 1.08, Math.max(...at.map((one) => one.B)) * 4) || up;
    const left = 58, right = width - 10, top = 10, bottom = height - 36;
    const x = (/** @type {number} */ K) => left + (K / mostK) * (right - left);
    const y = (/** @type {number} */ B) => bottom - (B / mostB) * (bottom - top);
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
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
    context.fillText(this.isRotary ? "K, N·m/rad; up: B, N·m·s/rad" : "K, N/m; up: B, N·s/m", (left + right) / 2, height - 4);
    context.textAlign = "left";
    context.fillText("stable", left + 10, top + 18);
    dot(context, x(hand.K), y(hand.B), look.ink, planned ? "" : "K and B of the scene", true);
    if (planned) dot(context, x(planned.K), y(planned.B), look.warm, "not applied yet", false);
  }
}

/** @param {any} hand */
function margin(hand) {
  const factor = hand.stiffness_factor;
  if (factor === null) return "stable whatever its stiffness";
  return factor > 1 ? `unstable from ${short(factor)} times its stiffness` : `stable below ${short(factor)} of its stiffness`;
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {string} colour @param {string} text @param {boolean} full */
function dot(context, x, y, colour, text, full) {
  context.fillStyle = context.strokeStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(x, y, 5, 0, 7);
  if (full) context.fill();
  else context.stroke();
  context.textAlign = "left";
  context.fillText(text, x + 10, y + 4);
}
