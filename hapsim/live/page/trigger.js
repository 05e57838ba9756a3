// @ts-check
/** Where the scope stands still: at the last crossing of a level whose picture is whole. */

import { firstFrom } from "./samples.js";

/** How much of the picture is before the crossing. */
export const BEFORE = 0.2;

export class Trigger {
  /** @type {"off" | "auto" | "normal" | "single"} */
  mode = "off";
  level = 0;
  isRising = true;
  from = 0; // crossings before it do not count
  /** @type {number | null} */
  at = null; // the last crossing

  /** Forgets the last crossing. @param {number} from the place from which crossings count */
  rearm(from) {
    this.from = from;
    this.at = null;
  }

  /**
   * The place at which the picture ends; null: at the newest sample.
   * @param {import("./samples.js").Series} series @param {number} newest @param {number} span samples in the picture
   * @param {number} patience samples for which `auto` waits
   * @returns {{end: number, isNew: boolean} | null}
   */
  find(series, newest, span, patience) {
    if (this.mode === "off") return null;
    const after = (1 - BEFORE) * span, before = this.at;
    const oldest = Math.max(this.at ?? 0, this.from, newest - after - Math.max(patience, span));
    const start = firstFrom(series, oldest);
    for (let i = firstFrom(series, newest - after) - 1; i > start && series.place(i) > (before ?? -1); i--) {
      const [earlier, later] = [series.value(i - 1) - this.level, series.value(i) - this.level];
      if (this.isRising ? earlier < 0 && later >= 0 : earlier > 0 && later <= 0) {
        this.at = series.place(i - 1) + (earlier / (earlier - later)) * (series.place(i) - series.place(i - 1));
        break;
      }
    }
    if (this.at === null) return this.mode === "auto" ? null : { end: newest, isNew: false };
    if (this.mode === "auto" && newest - this.at > after + patience) return null;
    return { end: this.at + after, isNew: this.at !== before };
  }
}
