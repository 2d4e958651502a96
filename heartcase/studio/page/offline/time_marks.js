/** Where a recording was cut, patched or stitched, on its time line: a click goes there; keys have the slider. */

import { timeMark } from "../operating/time_line.js";
import { language } from "../shared/words.js";

/** @typedef {import("../shared/connection.js").Package} Package */
/** Number of the moment, what was done then, and when [s]. @typedef {{at: number, kind: "cut" | "excision" | "patch" | "stitch", time: number}} Mark */

/** What the frames tell of steps, as moments. @param {Package[][]} moments @returns {Mark[]} */
export function marksOf(moments) {
  const headers = moments.map((parts) => /** @type {Record<string, any>} */ (parts.at(-1)?.header ?? {}));
  const told = /** @type {[number, Mark["kind"]][]} */ (headers.findLast(({ marks }) => marks !== undefined)?.marks ?? []);
  return told.map(([step, kind]) => {
    const found = headers.findIndex((header) => header.step >= step);
    const at = found < 0 ? headers.length - 1 : found;
    return { at, kind, time: headers[at].time_s };
  });
}

export class TimeMarks {
  /** @type {Mark[]} */
  #marks = [];
  #count = 1;

  /** @param {HTMLElement} list @param {(at: number) => void} goTo */
  constructor(list, goTo) {
    this.list = list;
    this.goTo = goTo;
    language.listen(() => this.#fill());
  }

  /** @param {Package[][]} moments of what is played */
  show(moments) {
    this.#marks = marksOf(moments);
    this.#count = Math.max(moments.length - 1, 1);
    this.#fill();
  }

  #fill() {
    this.list.replaceChildren(...this.#marks.map(({ at, kind, time }) => {
      const mark = timeMark(kind, time, () => this.goTo(at));
      mark.style.left = `${(100 * at) / this.#count}%`;
      return mark;
    }));
  }
}
