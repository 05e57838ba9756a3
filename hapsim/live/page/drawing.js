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

/** How a quantity in SI units is shown. @param {string} unit @param {Record<string, [string, number]>} written the units of the scene's file
 * @returns {[string, number]} the unit, and how many of it one SI unit is */
export function shownIn(unit, written) {
  return written[unit] ?? [unit, 1];
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
