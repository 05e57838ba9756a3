// @ts-check
/** What a hand feels, and where it is in the plane of stiffness and damping. */

import { line, prepared, short, shownIn, ticks, written } from "./drawing.js";

const NEAR = 24; // pixels: words would stand in each other

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
    this.channel = 0; // the hand's
    /** @type {[string, number]} */
    this.position = ["mm", 1e3];
    /** @type {[string, number][]} */
    this.units = [];
    this.turns(false, {});
  }

  /** Sets the units. @param {boolean} isRotary the hand's channel @param {Record<string, [string, number]>} ofFile units of the scene's file */
  turns(isRotary, ofFile) {
    this.position = shownIn(isRotary ? "rad" : "m", ofFile);
    this.units = (isRotary ? ["N·m/rad", "N·m·s/rad"] : ["N/m", "N·s/m"]).map((one) => shownIn(one, ofFile));
  }

  /** @param {any} predicted @param {boolean} isApplied */
  show(predicted, isApplied) {
    if (isApplied) [this.applied, this.planned] = [predicted, null];
    else this.planned = predicted;
    const now = this.planned ?? predicted, hand = now.hands?.[this.hand];
    const shown = (/** @type {number | null} */ one, /** @type {number} */ i) => short(one === null ? NaN : one * this.units[i][1]);
    const pair = (/** @type {(number | null)[]} */ values) => values.map((one, i) => `${shown(one, i)} ${this.units[i][0]}`);
    const own = hand ? pair(hand.own).filter((_, i) => hand.own[i]).join(" and ") : "";
    const isHeld = !hand?.region || hand.region.kind === "held"; // a snap and free space have no k and b of a spring
    this.felt.textContent = hand
      ? `${pair(hand.asked).join(" and ")}${isHeld ? ` feel like ${shown(hand.k, 0)} and ${shown(hand.b, 1)}` : ""}${own && ` (the device's own ${own} included)`}\n` +
        `${verdict(now, hand, ...this.position)}${this.planned ? ", not applied yet" : ""}${margin(hand)}`
      : `${now.verdict ? `${now.verdict}${now.states && "; unstable"}` : now.stable ? "stable" : "unstable"}${now.states && ` ${now.states}`} (spectral radius ${short(now.spectral_radius)})`;
    for (const one of now.felt ?? []) {
      const along = one.angle_deg === null ? "" : ` along ${short(one.angle_deg)}°`;
      const held = one.is_held ? " while the others hold still" : "";
      this.felt.textContent += `\n${one.hand} feels ${pair([one.k, one.b]).join(" and ")}${along}${held}.`;
    }
    for (const one of now.slides ?? []) this.felt.textContent += `\n${one.module} slides off along ${short(one.angle_deg)}°: grows e-fold in ${short(1e3 * one.e_fold_s)} ms.`;
    if (now.inputs) this.felt.textContent += `\nSo it is while ${now.inputs}.`;
    if (now.contacts) this.felt.textContent += `\nAt rest here: ${now.contacts}.`;
    this.felt.classList.toggle("bad", now.verdict ? now.verdict === "unstable" || now.states !== "" : !now.stable);
    this.canvas.hidden = !hand;
    const why = Object.entries(now.why ?? {}).map(([name, reason]) => `${name}: ${reason}`);
    const less = own ? ", less the device's own" : "";
    if (!hand) this.note.textContent = why.join("; ");
    else if (hand.K < 0) this.note.textContent = "In a snap K is below 0, outside this plane.";
    else if (!now.plane) this.note.textContent = "A correction simulates another K and B than the scene's: there is no boundary to draw.";
    else this.note.textContent = `The loop is stable for K and B in the shaded area. The marks on the axes are the felt k and b${less}; the area does not apply to them.`;
    if (now.wire_delay) this.note.textContent += ` ${now.wire_delay}.`;
    this.draw();
  }

  draw() {
    if (this.canvas.hidden) return;
    const { context, width, height, look } = prepared(this.canvas);
    const hand = this.applied?.hands?.[this.hand], planned = this.planned?.hands?.[this.hand];
    if (!hand) return;
    const plane = (this.planned ?? this.applied)?.plane;
    const at = [hand, ...(planned ? [planned] : [])].filter((one) => one.K >= 0); // a snap is outside the plane
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
    const [[unitK, perK], [unitB, perB]] = this.units;
    for (const K of ticks(0, mostK * perK, 5)) context.fillText(short(K), x(K / perK), bottom + 15);
    context.textAlign = "right";
    for (const B of ticks(0, mostB * perB, 5)) context.fillText(short(B), left - 7, y(B / perB) + 4);
    context.textAlign = "center";
    context.fillText(`stiffness, ${unitK}; up: damping, ${unitB}`, (left + right) / 2, height - 4);
    context.textAlign = "left";
    if (plane?.B.length) written(context, look, "stable", left + 10, top + 18);
    for (const one of at) {
      const isPlanned = one === planned, colour = isPlanned ? look.warm : look.ink;
      const from = { x: x(one.K), y: y(one.B) };
      const felt = { x: x(one.k === null ? NaN : one.k - one.own[0]), y: y(one.b === null ? NaN : one.b - one.own[1]) };
      const isLast = one === at[at.length - 1], isApart = (/** @type {number} */ px, /** @type {number} */ py) => isLast && Math.hypot(from.x - px, from.y - py) > NEAR;
      drop(context, colour, from, left, bottom);
      mark(context, look, colour, { x: Math.max(felt.x, left), y: bottom }, true, isApart(felt.x, bottom) ? "felt k" : "");
      mark(context, look, colour, { x: left, y: Math.min(felt.y, bottom) }, false, isApart(left, felt.y) ? "felt b" : "");
      dot(context, colour, from, !isPlanned);
      if (isLast) label(context, look, colour, from, isPlanned ? "not applied yet" : "K, B of the scene", right);
    }
  }
}

/** How far the axes go. @param {any[]} hands @param {any} plane */
function reach(hands, plane) {
  const far = Math.max(0, ...(plane?.most.filter(Number.isFinite) ?? [])), up = Math.max(0, ...(plane?.B ?? []));
  const mostK = 1.6 * Math.max(0, ...hands.flatMap((one) => [one.K, (one.k ?? 0) - one.own[0]])), mostB = 2.2 * Math.max(0, ...hands.flatMap((one) => [one.B, (one.b ?? 0) - one.own[1]]));
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

/** Whether it is stable, and where. @param {any} now @param {any} hand @param {string} unit @param {number} factor how many of it are one SI unit */
function verdict(now, hand, unit, factor) {
  const region = hand.region, whole = now.stable ? "stable" : "unstable";
  if (!region) return whole;
  const [low, high] = [region.low_m, region.high_m].map((one) => one !== null && `${Number((factor * one).toPrecision(4))}`), of = unit === "°" ? "°" : ` ${unit}`;
  const where = low && high ? `from ${low} to ${high}${of}: ` : low ? `above ${low}${of}: ` : high ? `below ${high}${of}: ` : "";
  const energy = region.snap_energy_j ? ` of ${Number((1e3 * region.snap_energy_j).toPrecision(3))} mJ` : "";
  const kinds = { held: "stable", free: "no spring", snap: `a snap${energy} drives the hand on` };
  const here = region.stable ? kinds[/** @type {keyof kinds} */ (region.kind)] : "unstable";
  return `${where}${here}${!now.stable && region.stable ? "; unstable elsewhere" : ""}`;
}

/** @param {any} hand */
function margin(hand) {
  const factor = hand.stiffness_factor;
  if (hand.region && hand.region.kind !== "held") return "";
  if (factor === null) return "; stable whatever its stiffness";
  return factor > 1 ? `; unstable from ${short(factor)} times its stiffness` : `; stable below ${short(factor)} of its stiffness`;
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

/** From a point down to both axes. @param {CanvasRenderingContext2D} context @param {string} colour @param {Point} from @param {number} left @param {number} bottom */
function drop(context, colour, from, left, bottom) {
  context.save();
  context.strokeStyle = colour;
  context.globalAlpha = 0.5;
  context.setLineDash([2, 4]);
  line(context, from.x, from.y, from.x, bottom);
  line(context, from.x, from.y, left, from.y);
  context.restore();
}

/** What is felt: a wedge that points at its place on an axis. @param {CanvasRenderingContext2D} context @param {any} look @param {string} colour @param {Point} at @param {boolean} isUpright on the horizontal axis @param {string} text */
function mark(context, look, colour, at, isUpright, text) {
  if (!Number.isFinite(at.x + at.y)) return;
  context.fillStyle = colour;
  context.beginPath();
  for (const [along, across] of [[0, 0], [9, 5], [9, -5]])
    context.lineTo(at.x + (isUpright ? across : along), at.y - (isUpright ? along : across));
  context.fill();
  context.textAlign = "left";
  if (text) written(context, look, text, at.x + (isUpright ? 8 : 13), at.y - (isUpright ? 6 : -4));
}

/** @param {CanvasRenderingContext2D} context @param {any} look @param {string} colour @param {Point} at @param {string} text @param {number} right */
function label(context, look, colour, at, text, right) {
  const isLeft = at.x + 12 + context.measureText(text).width > right;
  context.fillStyle = colour;
  context.textAlign = isLeft ? "right" : "left";
  written(context, look, text, at.x + (isLeft ? -10 : 10), at.y - 8);
  context.textAlign = "left";
}
