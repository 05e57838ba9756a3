// @ts-check
/** What all pictures of the page share: canvases, colours, round numbers. */

/** A canvas of the size that it has on the screen, cleared, with the page's colours. @param {HTMLCanvasElement} canvas */
export function prepared(canvas) {
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  context.lineWidth = 1;
  return { context, width, height, look: colours(canvas) };
}

/** @type {WeakMap<Element, {at: number, look: any}>} */
const seen = new WeakMap();

/** @param {Element} element */
function colours(element) {
  const known = seen.get(element);
  if (known && performance.now() - known.at < 1000) return known.look;
  const probe = document.createElement("i");
  document.body.append(probe);
  /** @type {Record<string, string>} */
  const look = {};
  for (const name of ["ink", "quiet", "line", "accent", "warm", "card"]) {
    probe.style.color = `var(--${name})`;
    look[name] = getComputedStyle(probe).color;
  }
  probe.remove();
  seen.set(element, { at: performance.now(), look });
  return look;
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} to @param {number} down */
export function line(context, x, y, to, down) {
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(to, down);
  context.stroke();
}

/** A line through places. @param {CanvasRenderingContext2D} context @param {number[][]} places pixels */
export function trace(context, places) {
  context.beginPath();
  for (const [x, y] of places) context.lineTo(x, y);
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} radius @param {string} colour @param {boolean} [isSolid] */
export function dot(context, x, y, radius, colour, isSolid = true) {
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  [context.fillStyle, context.strokeStyle, context.lineWidth] = [colour, colour, 2];
  isSolid ? context.fill() : context.stroke();
}

/** Places along a spring between two, pixels. @param {number[]} from @param {number[]} to */
export function spring([x, y], [right, down]) {
  const [dx, dy] = [right - x, down - y], long = Math.hypot(dx, dy), turns = 12;
  if (long < 16) return [[x, y], [right, down]];
  const inner = Array.from({ length: turns }, (_, i) => [0.15 + (0.7 * (i + 0.5)) / turns, i % 2 ? 5 : -5]);
  return [[x, y], ...[[0.15, 0], ...inner, [0.85, 0]].map(([share, off]) => [x + share * dx - (off * dy) / long, y + share * dy + (off * dx) / long]), [right, down]];
}

/** How a quantity in SI units is shown: lengths, angles and speeds in the file's unit of position, or in mm and mrad. @param {string} unit @param {Record<string, [string, number]>} written the units of the scene's file
 * @returns {[string, number]} the unit, and how many of it one SI unit is */
export function shownIn(unit, written) {
  const [, way, per] = unit.match(/^(m|rad)(\/s)?$/) ?? [], [name, factor] = written[way] ?? [`m${way}`, 1e3];
  return written[unit] ?? (way ? [`${name}${per ?? ""}`, factor] : [unit, 1]);
}

/** Round numbers between two. @param {number} least @param {number} most @param {number} about */
export function ticks(least, most, about) {
  const raw = (most - least) / about, unit = 10 ** Math.floor(Math.log10(raw));
  const step = unit * ([1, 2, 5, 10].find((one) => one * unit >= raw) ?? 10);
  const found = [];
  for (let i = Math.ceil(least / step); i * step <= most; i++) found.push(i * step);
  return found;
}

/** @param {number} value */
export function short(value) {
  return value === null || !Number.isFinite(value) ? "–" : String(Number(value.toPrecision(4)));
}

/** A text that can be read over lines. @param {CanvasRenderingContext2D} context @param {any} look @param {string} text @param {number} x @param {number} y */
export function written(context, look, text, x, y) {
  context.save();
  context.strokeStyle = look.card;
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeText(text, x, y);
  context.restore();
  context.fillText(text, x, y);
}
