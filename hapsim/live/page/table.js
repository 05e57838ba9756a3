// @ts-check
/** The hands of a mock in the plane: dragged among outlines and points, as on a table seen from above. */

import { line, short, ticks } from "./drawing.js";

const FAR = 5; // m: an outline that goes so far has no end
const ROOM = 0.15; // of what there is, around it

/** @typedef {[number, number]} Place */
/** @typedef {{x: number, y: number, half: number}} View its centre and half of its side, m */

/** The hands: the channels of x and y of each. @param {any} model @returns {[number, number][]} */
export function handsOf(model) {
  const channel = new Map(model.channels.map((/** @type {any} */ one) => [one.name, one.channel]));
  const names = [...channel.keys()].filter((name) => name.endsWith(".x")).map((name) => name.slice(0, -2));
  return names.map((name) => [channel.get(`${name}.x`), channel.get(`${name}.y`)]);
}

/** Coordinates of the points that are no hands: "ball.x". @param {any} model @returns {string[]} */
export function coordinatesOf(model) {
  const hands = model.channels.map((/** @type {any} */ one) => one.name);
  return model.modules.map((/** @type {any} */ one) => one.name).filter((/** @type {string} */ name) => !hands.includes(name));
}

/** Where every point is, by name. @param {Map<string, number>} coordinates @returns {Map<string, Place>} */
export function placesOf(coordinates) {
  const places = new Map();
  for (const [name, x] of coordinates) {
    const y = coordinates.get(`${name.slice(0, -2)}.y`);
    if (name.endsWith(".x") && y !== undefined) places.set(name.slice(0, -2), [x, y]);
  }
  return places;
}

/** A view of all that there is, and of the last view. @param {any} model @param {Map<string, Place>} places @param {View | null} before @returns {View} */
export function viewOf(model, places, before) {
  const reach = model.channels[0].hand.reach, seen = [...places.values()].flatMap(([x, y]) => [[x, y]]);
  if (before) {
    const isWithin = seen.every(([x, y]) => Math.max(Math.abs(x - before.x), Math.abs(y - before.y)) < before.half);
    if (isWithin) return before;
    seen.push([before.x - before.half, before.y - before.half], [before.x + before.half, before.y + before.half]);
  }
  for (const one of before ? [] : model.outlines)
    for (const [dx, dy] of one.places) {
      const [x, y] = places.get(one.about) ?? [0, 0];
      if (Math.hypot(dx, dy) < FAR) seen.push([x + dx, y + dy]);
    }
  const [left, right] = [0, 1].map((end) => seen.map(([x]) => x).sort((a, b) => (end ? b - a : a - b))[0]);
  const [low, high] = [0, 1].map((end) => seen.map(([, y]) => y).sort((a, b) => (end ? b - a : a - b))[0]);
  const half = before ? Math.max(right - left, high - low) / 2 : Math.max(reach, (0.5 + ROOM) * Math.max(right - left, high - low));
  return { x: (left + right) / 2, y: (low + high) / 2, half };
}

/** @param {{context: CanvasRenderingContext2D, width: number, height: number, look: any}} canvas @param {any} model
 * @param {Map<string, Place>} places @param {View} view @param {{from: Place, to: Place} | null} pull */
export function drawTable({ context, width, height, look }, model, places, view, pull) {
  const scale = Math.min(width, height) / 2 / view.half;
  const x = (/** @type {number} */ at) => width / 2 + (at - view.x) * scale, y = (/** @type {number} */ at) => height / 2 - (at - view.y) * scale;
  const hands = model.channels.map((/** @type {any} */ one) => one.name.slice(0, -2));
  const isShape = (/** @type {any} */ one) => one?.kind === "outside" || one?.kind === "inside";
  for (let i = 0; i < model.outlines.length; ) {
    const one = model.outlines[i], isSolid = isShape(one), about = one.about ? places.get(one.about) : [0, 0];
    const first = i++;
    while (isSolid && isShape(model.outlines[i]) && model.outlines[i].of === one.of && model.outlines[i].about === one.about) i++;
    if (!about) continue;
    context.beginPath();
    for (const { places: spots } of model.outlines.slice(first, i)) // all outlines of a surface together
      for (const [n, [dx, dy]] of spots.entries()) context[n ? "lineTo" : "moveTo"](x(about[0] + dx), y(about[1] + dy));
    context.setLineDash(isSolid ? [] : one.kind === "guide" ? [6, 4] : [2, 4]);
    context.strokeStyle = one.kind === "travel" ? look.line : look.quiet;
    context.lineWidth = 1.5;
    context.stroke();
    context.setLineDash([]);
    if (one.kind === "inside") context.rect(-1, -1, width + 2, height + 2);
    context.fillStyle = look.quiet;
    context.globalAlpha = 0.14;
    if (isSolid && (hands.includes(one.of) || hands.includes(one.about))) context.fill("evenodd"); // others are not felt
    context.globalAlpha = 1;
  }
  if (pull) {
    context.strokeStyle = look.warm;
    context.lineWidth = 2;
    line(context, x(pull.from[0]), y(pull.from[1]), x(pull.to[0]), y(pull.to[1]));
  }
  for (const [name, [px, py]] of places) {
    const isHand = hands.includes(name);
    context.fillStyle = isHand ? look.accent : look.ink;
    context.beginPath();
    context.arc(x(px), y(py), isHand ? 10 : 4, 0, 7);
    context.fill();
    context.fillStyle = look.quiet;
    context.textAlign = "left";
    context.fillText(name, x(px) + (isHand ? 14 : 8), y(py) - 8);
  }
  const [unit, factor] = model.written.m ?? ["mm", 1e3], bar = ticks(0, view.half * factor, 3)[1];
  context.strokeStyle = look.ink;
  context.lineWidth = 1;
  line(context, 12, height - 12, 12 + (bar / factor) * scale, height - 12);
  context.fillText(`${short(bar)} ${unit}`, 12, height - 18);
}
