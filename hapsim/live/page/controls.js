// @ts-check
/** A slider and a number box for each live parameter; words by choice. */

import { short } from "./drawing.js";

/**
 * @param {HTMLElement} place
 * @param {any[]} parameters
 * @param {(values: Record<string, any>) => void} plan called while a slider moves
 * @param {(values: Record<string, any>) => void} apply
 * @returns {(values: Record<string, any>) => void} what shows values that were changed
 */
export function makeControls(place, parameters, plan, apply) {
  place.replaceChildren();
  /** @type {Map<string, (value: any) => void>} */
  const shown = new Map();
  for (const one of parameters.filter((each) => each.kind === "number" || each.words.length)) {
    const row = document.createElement("div");
    row.className = "parameter";
    const name = document.createElement("label");
    name.textContent = one.name;
    name.title = one.description;
    const unit = document.createElement("span");
    unit.className = "unit";
    unit.textContent = one.unit;
    const reset = document.createElement("button");
    reset.textContent = "↺";
    reset.title = `back to ${short(one.value) === "–" ? one.value : short(one.value)}`;
    reset.onclick = () => apply({ [one.name]: one.value });
    /** @type {{parts: HTMLElement[], show: (value: any) => void}} */
    const inputs = one.kind === "number" ? numbers(one, plan, apply) : words(one, apply);
    inputs.parts[0].id = `set ${one.name}`;
    name.htmlFor = inputs.parts[0].id;
    row.append(name, inputs.parts[0], inputs.parts[1], unit, reset);
    place.append(row);
    shown.set(one.name, inputs.show);
    inputs.show(one.value);
  }
  return (values) => Object.entries(values).forEach(([name, value]) => shown.get(name)?.(value));
}

/** @param {any} one @param {(values: any) => void} plan @param {(values: any) => void} apply */
function numbers(one, plan, apply) {
  const [low, high] = one.span, isLog = one.logarithmic && low > 0;
  const slider = document.createElement("input"), box = document.createElement("input");
  Object.assign(slider, { type: "range", min: "0", max: "1000", step: "1" });
  Object.assign(box, { type: "number", step: "any", ...(one.least === null ? {} : { min: one.least }) });
  box.setAttribute("aria-label", `${one.name}, ${one.unit}`);
  const value = () => {
    const share = Number(slider.value) / 1000;
    return Number((isLog ? low * (high / low) ** share : low + (high - low) * share).toPrecision(4));
  };
  slider.oninput = () => {
    box.value = short(value());
    plan({ [one.name]: value() });
  };
  slider.onchange = () => apply({ [one.name]: value() });
  box.onchange = () => box.value !== "" && apply({ [one.name]: Number(box.value) });
  const show = (/** @type {number} */ now) => {
    const share = isLog ? Math.log(Math.max(now, low) / low) / Math.log(high / low) : (now - low) / (high - low);
    slider.value = String(Math.round(1000 * share));
    box.value = short(now);
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
