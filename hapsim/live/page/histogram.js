// @ts-check
/** How long something took: a histogram over a logarithmic axis of time. */

import { line, prepared, short } from "./drawing.js";

const LEAST_S = 1e-6, LEFT = 8, RIGHT = 8, TOP = 18, BOTTOM = 18;

/** @param {HTMLCanvasElement} canvas @param {string} title @param {{edges_s: number[], counts: number[]}} bins */
export function drawHistogram(canvas, title, bins) {
  const { context, width, height, look } = prepared(canvas);
  const edges = bins.edges_s.map((edge) => Math.max(edge, LEAST_S)), all = bins.counts.reduce((sum, one) => sum + one, 0);
  context.fillStyle = look.ink;
  context.textAlign = "left";
  const [half, nearlyAll] = [0.5, 0.99].map((share) => time(quantile(bins, all, share)));
  context.fillText(all ? `${title}: half within ${half}, 99 % within ${nearlyAll}` : `${title}: nothing yet`, LEFT, 12);
  if (!all) return;
  const low = Math.floor(Math.log10(Math.min(...edges))), high = Math.max(low + 1, Math.ceil(Math.log10(Math.max(...edges)) + 0.05));
  const bottom = height - BOTTOM, x = (/** @type {number} */ s) => LEFT + ((Math.log10(s) - low) / (high - low)) * (width - LEFT - RIGHT);
  context.fillStyle = look.quiet;
  context.strokeStyle = look.line;
  line(context, LEFT, bottom, width - RIGHT, bottom);
  const every = Math.ceil((75 * (high - low)) / (width - LEFT - RIGHT)); // powers of ten, each 75 pixels for its text
  for (let power = low; power <= high; power++) {
    context.textAlign = power === low ? "left" : power === high ? "right" : "center";
    if ((high - power) % every === 0) context.fillText(time(10 ** power), x(10 ** power), height - 4);
    line(context, x(10 ** power), bottom, x(10 ** power), bottom + 4);
  }
  /** @type {Map<number, number>} */
  const bars = new Map(); // by column of 4 pixels
  edges.forEach((edge, i) => {
    const column = Math.floor(x(edge) / 4);
    bars.set(column, (bars.get(column) ?? 0) + bins.counts[i]);
  });
  const most = Math.max(...bars.values());
  context.fillStyle = look.accent;
  for (const [column, count] of bars) {
    const up = Math.max(1, ((bottom - TOP - 4) * Math.log1p(count)) / Math.log1p(most)); // rare ones are seen, too
    context.fillRect(4 * column, bottom - up, 3, up);
  }
}

/** @param {{edges_s: number[], counts: number[]}} bins @param {number} all @param {number} share */
function quantile(bins, all, share) {
  let left = share * all;
  const at = bins.counts.findIndex((count) => (left -= count) <= 0);
  return bins.edges_s[at < 0 ? bins.edges_s.length - 1 : at];
}

/** @param {number} seconds */
function time(seconds) {
  if (seconds >= 1) return `${short(seconds)} s`;
  return seconds >= 1e-3 ? `${three(seconds * 1e3)} ms` : `${three(seconds * 1e6)} µs`;
}

/** @param {number} value */
const three = (value) => String(Number(value.toPrecision(3)));
