// @ts-check
/** Where the things of a scene on a line stand side by side: positions go upwards, so that a string lies as it does on
 * an instrument. What is linked to a mass of a string or a membrane stands at that mass, everything else in a column. */

const EDGE = 56, TOP = 30, BOTTOM = 40; // pixels around the picture
const BESIDE = 34; // pixels between what stands at one mass
const DEEP = 0.3, ASLANT = 0.22; // of its height and width: how a membrane is seen from above

/** @typedef {{x: number, lift: number}} Base pixels from the left, and above where the position alone puts it */
/** @typedef {{at: Map<string, Base>, structures: Map<string, {base: Base[], label: string[], left: number, right: number}>,
 * levels: Map<string, {left: number, right: number, lift: number, of: string}>, aside: Map<string, number>, order: string[], unit: number,
 * top: number, bottom: number}} Columns */

/** @param {any[]} entries of `drawn` @param {number} width @param {number} height pixels @returns {Columns} */
export function columnsOf(entries, width, height) {
  const links = entries.filter(({ kind }) => kind === "link"), structures = entries.filter(({ kind }) => kind === "structure");
  const movers = entries.filter(({ kind }) => kind === "hand" || kind === "mass").map(({ name }) => name);
  const neighbours = neighboursOf(entries, links), hung = hungOf(neighbours, movers), order = orderOf(neighbours, movers.filter((name) => !hung.has(name)));
  const wide = Math.max(8, order.length), unit = (width - 2 * EDGE) / Math.max(1, order.length + wide * structures.length);
  /** @type {Columns} */
  const found = { at: new Map(), structures: new Map(), levels: new Map(), aside: new Map(), order, unit, top: TOP, bottom: height - BOTTOM };
  order.forEach((name, i) => found.at.set(name, { x: EDGE + (i + 0.5) * unit, lift: 0 }));
  structures.forEach((one, i) => spread(found, one, EDGE + (order.length + wide * i) * unit + 8, wide * unit - 16, height));
  for (const [name, { mass, steps }] of hung) {
    const base = found.at.get(mass) ?? { x: width / 2, lift: 0 }, way = base.x > width / 2 ? -1 : 1;
    found.at.set(name, { x: base.x + way * steps * BESIDE, lift: base.lift });
  }
  level(found, entries, links, width);
  return found;
}

/** Which points and masses are linked, grounds aside. @param {any[]} entries @param {any[]} links @returns {Map<string, string[]>} */
function neighboursOf(entries, links) {
  const grounds = new Set(entries.filter(({ kind }) => kind === "ground").map(({ name }) => name)), found = new Map();
  for (const { between: [a, b] } of links)
    if (!grounds.has(a) && !grounds.has(b)) for (const [one, other] of [[a, b], [b, a]]) found.set(one, [...(found.get(one) ?? []), other]);
  return found;
}

/** The points that hang on a mass of a structure, with the number of those before them there.
 * @param {Map<string, string[]>} neighbours @param {string[]} movers @returns {Map<string, {mass: string, steps: number}>} */
function hungOf(neighbours, movers) {
  const points = new Set(movers), found = new Map(), count = new Map();
  const front = [...neighbours.keys()].filter((name) => !points.has(name)).map((mass) => ({ name: mass, mass }));
  for (const { name, mass } of front) // which grows meanwhile
    for (const next of neighbours.get(name) ?? [])
      if (points.has(next) && !found.has(next)) {
        found.set(next, { mass, steps: count.get(mass) ?? 0 });
        count.set(mass, (count.get(mass) ?? 0) + 1);
        front.push({ name: next, mass });
      }
  return found;
}

/** Points in an order in which those that are linked stand beside each other. @param {Map<string, string[]>} neighbours @param {string[]} points */
function orderOf(neighbours, points) {
  const found = new Set(), waiting = [...points].reverse();
  while (waiting.length) {
    const name = /** @type {string} */ (waiting.pop());
    if (found.has(name)) continue;
    found.add(name);
    waiting.push(...(neighbours.get(name) ?? []).filter((one) => !found.has(one)).reverse());
  }
  return [...found];
}

/** Spreads the masses of a structure. @param {Columns} found @param {any} structure @param {number} left @param {number} width @param {number} height */
function spread(found, { name, rows, columns, is_fixed }, left, width, height) {
  const deep = rows ? DEEP * height : 0, aslant = rows ? ASLANT * width : 0, last = rows?.[rows.length - 1] || 1;
  const [first, end] = rows ? [0, columns[columns.length - 1]] : [is_fixed[0] ? -1 : 0, columns[columns.length - 1] + (is_fixed[1] ? 1 : 0)];
  /** @type {Base[]} */
  const base = [];
  const label = [];
  for (const row of rows ?? [last])
    for (const column of columns) {
      const back = 1 - row / last, along = (column - first) / Math.max(1, end - first);
      base.push({ x: left + aslant * back + along * (width - aslant), lift: deep * (back - 0.5) * (rows ? 1 : 0) });
      label.push(rows ? `${name}.${row}.${column}` : `${name}.${column}`);
      found.at.set(label[label.length - 1], base[base.length - 1]);
    }
  found.structures.set(name, { base, label, left, right: left + width });
}

/** Draws the grounds out over all that is linked to them, the links between a point and grounds beside each other.
 * @param {Columns} found @param {any[]} entries @param {any[]} links @param {number} width */
function level(found, entries, links, width) {
  const half = Math.max(16, Math.min(found.unit / 2 - 4, 60)), grounded = new Map();
  const ends = new Map(entries.filter(({ kind }) => kind === "ground").map(({ name }) => [name, /** @type {string[]} */ ([])]));
  for (const { name, between: [a, b] } of links) {
    const [ground, end] = ends.has(a) ? [a, b] : [b, a];
    if (!ends.has(ground)) continue;
    ends.get(ground)?.push(end);
    grounded.set(end, [...(grounded.get(end) ?? []), name]);
  }
  for (const [name, of] of ends) {
    const bases = of.map((end) => found.at.get(end)).filter((one) => one !== undefined), x = bases.map((one) => one.x);
    const [left, right] = x.length ? [least(x) - half, -least(x.map((one) => -one)) + half] : [EDGE, width - EDGE];
    found.levels.set(name, { left, right, lift: bases[0]?.lift ?? 0, of: of[0] ?? "" });
  }
  for (const names of grounded.values()) names.forEach((/** @type {string} */ name, /** @type {number} */ i) => found.aside.set(name, (i - (names.length - 1) / 2) * 12));
}

/** @param {number[]} values */
const least = (values) => values.reduce((low, one) => Math.min(low, one), Infinity);
