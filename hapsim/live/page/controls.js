// @ts-check
/** A slider and a number box for each live parameter; words by choice. */

import { short } from "./drawing.js";

const SCENE = "Scene", MOCK = "Hand of the mock";
const isPhone = () => matchMedia("(max-width: 620px)").matches;
const most = () => (isPhone() ? 12 : 40); // parameters in one group; of more, each module has its own

/** What was refused, by the parameter's name: it stays until the user changes that parameter again.
 * @type {Map<string, {typed: any, reason: string}>} */
const refused = new Map();

/** Whether each group is folded, once the user has folded or opened it. @type {Map<string, boolean>} */
const folded = new Map();

/** Returns a group of parameters, made when it is first asked for. On a phone that of the mock begins folded, and one of many.
 * @param {HTMLElement} place @param {string} title */
function groupOf(place, title) {
  const known = [...place.querySelectorAll("details")].find((one) => one.dataset.title === title);
  if (known) return known;
  const group = document.createElement("details"), summary = document.createElement("summary");
  group.dataset.title = summary.textContent = title;
  group.append(summary);
  group.open = !(folded.get(title) ?? (title !== SCENE && (title !== MOCK || isPhone())));
  summary.onclick = () => folded.set(title, group.open); // it is still as it was
  place.append(group);
  return group;
}

/** Says at the end of a part of the page what was refused there, until it is closed or replaced; "": nothing was.
 * @param {HTMLElement} place @param {string} text @param {() => void} [closed] */
export function refuseAt(place, text, closed) {
  const before = place.querySelector(":scope > .refusal");
  if (before?.firstChild?.textContent === text) return;
  before?.remove();
  if (!text) return;
  const said = document.createElement("p"), close = document.createElement("button");
  said.className = "refusal";
  said.setAttribute("role", "alert");
  Object.assign(close, { textContent: "×", title: "close", onclick: () => (said.remove(), closed?.()) });
  said.append(text, close);
  place.append(said);
}

/** @param {any} one @param {any} other */
const isSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);

/**
 * @param {HTMLElement} place
 * @param {any[]} parameters
 * @param {(values: Record<string, any>) => void} plan called while a slider moves
 * @param {(values: Record<string, any>) => void} apply
 * @returns what shows values that were changed; what says why values were refused, false where none has a row; and the
 * names of the parameters that differ from the scene's file
 */
export function makeControls(place, parameters, plan, apply) {
  place.replaceChildren();
  /** @type {Map<string, {show: (value?: any) => void, say: () => void}>} */
  const rows = new Map();
  const now = new Map(parameters.map((one) => [one.name, one.value])), saved = new Map(parameters.map((one) => [one.name, one.saved]));
  // The hand that holds the mock does not count: a drag leaves it anywhere.
  const differs = (/** @type {string} */ name) => !name.startsWith("mock.") && (saved.get(name) ?? null) !== null && !isSame(now.get(name), saved.get(name));
  const touched = (/** @type {(values: any) => void} */ then) => (/** @type {Record<string, any>} */ values) => {
    for (const name of Object.keys(values)) if (refused.delete(name)) rows.get(name)?.say();
    then(values);
  };
  /** @param {Record<string, any>} values @param {string} reason @param {boolean} [goesBack] to what is set */
  const refuse = (values, reason, goesBack = true) => {
    const names = Object.keys(values).filter((name) => rows.has(name));
    for (const name of names) {
      refused.set(name, { typed: values[name], reason });
      rows.get(name)?.[goesBack ? "show" : "say"]();
    }
    return names.length > 0;
  };
  for (const one of parameters.filter((each) => each.kind === "number" || each.words.length)) {
    const row = document.createElement("div");
    row.className = "parameter";
    const name = document.createElement("label");
    const dot = one.name.lastIndexOf("."), module = parameters.length > most() ? one.name.slice(0, dot) : SCENE;
    const group = groupOf(place, one.name.startsWith("mock.") ? MOCK : module);
    const shown = group.dataset.title === SCENE ? one.name : one.name.slice(dot + 1);
    // Long names break behind a dot or an underscore.
    for (const part of shown.split(/(?<=[._])/)) name.append(part, document.createElement("wbr"));
    name.title = `${one.name}: ${one.description}`;
    const unit = document.createElement("span");
    unit.className = "unit";
    const [shownUnit, factor] = one.shown;
    unit.textContent = shownUnit;
    const reset = document.createElement("button");
    reset.textContent = "↺";
    const before = one.saved ?? one.value;
    reset.title = `back to ${short(before) === "–" ? before : short(before * factor)}`;
    reset.onclick = () => touched(apply)({ [one.name]: saved.get(one.name) ?? before });
    /** @type {{parts: HTMLElement[], show: (value: any) => void}} */
    const inputs = one.kind === "number" ? numbers(one, touched(plan), touched(apply), refuse) : words(one, touched(apply));
    inputs.parts[0].id = `set ${one.name}`;
    name.htmlFor = inputs.parts[0].id;
    row.append(name, inputs.parts[0], inputs.parts[1], unit, reset);
    group.append(row);
    const say = () => {
      row.classList.toggle("unsaved", differs(one.name));
      const why = refused.get(one.name);
      if (why) group.setAttribute("open", "");
      const written = (/** @type {any} */ value) => (typeof value === "number" ? `${Number((value * factor).toPrecision(12))} ${shownUnit}`.trim() : value);
      refuseAt(row, why ? `${written(why.typed)} was rejected, the value is still ${written(now.get(one.name))}: ${why.reason}` : "", () => refused.delete(one.name));
    };
    rows.set(one.name, { show: (value = now.get(one.name)) => (inputs.show(value), say()), say });
    rows.get(one.name)?.show();
  }
  const show = (/** @type {Record<string, any>} */ values) =>
    Object.entries(values).forEach(([name, value]) => (now.set(name, value), rows.get(name)?.show(value)));
  return { show, refuse, unsaved: () => [...now.keys()].filter(differs) };
}

/** @param {any} one @param {(values: any) => void} plan @param {(values: any) => void} apply @param {(values: any, reason: string) => void} refuse */
function numbers(one, plan, apply, refuse) {
  const [low, high] = one.span, [unit, factor] = one.shown, isLog = one.logarithmic && low > 0;
  const slider = document.createElement("input"), box = document.createElement("input");
  Object.assign(slider, { type: "range", min: "0", max: "1000", step: "1" });
  Object.assign(box, { type: "text", inputMode: "decimal", title: `a number of ${unit || "no unit"}, or with a unit, such as 2 N/mm` });
  box.setAttribute("aria-label", `${one.name}, ${unit}`);
  const value = () => {
    const share = Number(slider.value) / 1000;
    const found = isLog ? low * (high / low) ** share : low + (high - low) * share;
    return Number((found * factor).toPrecision(4)) / factor; // round in the unit that the file has
  };
  slider.oninput = () => {
    box.value = short(value() * factor);
    plan({ [one.name]: value() });
  };
  slider.onchange = () => apply({ [one.name]: value() });
  box.onchange = () => {
    const typed = box.value.trim(), number = Number(typed);
    if (typed === "") refuse({ [one.name]: "what was typed" }, "expected a number");
    else apply({ [one.name]: Number.isFinite(number) ? number / factor : typed }); // hapsim reads units
  };
  const show = (/** @type {number} */ now) => {
    const share = isLog ? Math.log(Math.max(now, low) / low) / Math.log(high / low) : (now - low) / (high - low);
    slider.value = String(Math.round(1000 * share));
    box.value = short(now * factor);
  };
  return { parts: [slider, box], show };
}

/** @param {any} one @param {(values: any) => void} apply */
function words(one, apply) {
  const choice = document.createElement("select"), empty = document.createElement("span");
  choice.append(...one.words.map((/** @type {string} */ word) => new Option(word)));
  choice.onchange = () => apply({ [one.name]: choice.value });
  return { parts: [choice, empty], show: (/** @type {string} */ now) => void (choice.value = now) };
}
