// @ts-check
/** Inputs and outputs: lights and numbers, with a control for each that a program may set. */

import { refuseAt } from "./controls.js";

export class Words {
  /**
   * @param {HTMLElement} place @param {import("./samples.js").Samples} samples
   * @param {(values: Record<string, number>) => Promise<any>} set sends values; answers with why they were refused
   */
  constructor(place, samples, set) {
    this.place = place;
    this.samples = samples;
    this.set = set;
    /** @type {HTMLOutputElement[]} */
    this.shown = [];
    this.inputCount = 0; // they come first
    /** Values that are set, by name. @type {Map<string, any>} */
    this.known = new Map();
  }

  /** @param {any} model */
  describe(model) {
    const parameters = new Map(model.parameters.map((/** @type {any} */ one) => [one.name, one]));
    this.known = new Map(model.parameters.map((/** @type {any} */ one) => [one.name, one.value]));
    this.shown = model.words.map(() => document.createElement("output"));
    this.inputCount = model.words.filter((/** @type {string} */ name) => name.startsWith("inputs.")).length;
    this.place.replaceChildren(
      ...model.words.map((/** @type {string} */ name, /** @type {number} */ i) => {
        const row = document.createElement("div"), label = document.createElement("label");
        const parameter = parameters.get(name.startsWith("inputs.") ? `mock.${name}` : name);
        row.className = "word";
        label.append(name.slice(name.indexOf(".") + 1));
        row.append(this.shown[i], label);
        if (parameter) label.append(this.control(row, parameter));
        return row;
      }),
    );
  }

  /** A switch of a bit, or the field of a number. @param {HTMLElement} row @param {any} one a parameter */
  control(row, one) {
    const field = document.createElement("input"), isBit = one.most === 1;
    Object.assign(field, isBit ? { type: "checkbox", checked: one.value === 1 } : { type: "number", min: 0, max: one.most, value: one.value });
    field.onchange = async () => {
      const answer = await this.set({ [one.name]: isBit ? Number(field.checked) : Number(field.value) });
      refuseAt(row, answer.type === "rejected" ? answer.reason : "");
      if (answer.type === "rejected") this.take({ [one.name]: this.known.get(one.name) });
    };
    field.dataset.name = one.name;
    field.title = `${one.name}: ${one.description}`;
    return field;
  }

  /** Takes values that were set. @param {Record<string, any>} values */
  take(values) {
    Object.entries(values).forEach(([name, value]) => this.known.set(name, value));
    for (const field of this.place.querySelectorAll("input")) {
      const value = values[field.dataset.name ?? ""];
      if (value !== undefined) [field.checked, field.value] = field.type === "checkbox" ? [value === 1, field.value] : [false, value];
    }
  }

  /** Which inputs are on: a gate makes another scene of each. */
  inputs() {
    return this.shown.slice(0, this.inputCount).map((one) => one.value).join();
  }

  draw() {
    const { columns } = this.samples, first = columns.length - this.shown.length;
    this.shown.forEach((one, i) => {
      const value = this.samples.newestOf(first + i);
      if (one.value !== String(value)) one.value = String(value);
      one.classList.toggle("on", value !== 0);
    });
  }
}
