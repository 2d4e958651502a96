/** Where a recording was cut, patched or stitched, on its time line: a click goes there; keys have the slider. */

import { timeMark } from "../operating/time_line.js";
import { language } from "../shared/words.js";

/** @typedef {import("../shared/connection.js").Package} Package */
/** Number of the moment, what was done then, and when [s]. @typedef {{at: number, kind: "cut" | "patch" | "stitch", time: number}} Mark */

/** Stitches of a row that come one after the other have one mark: those within so long, s. */
const ROW_S = 1;

/** @param {Package[][]} moments @returns {Mark[]} */
export function marksOf(moments) {
  /** @type {Mark[]} */
  const marks = [];
  const before = { cut: 0, patch: 0, stitch: 0 };
  const last = { cut: -Infinity, patch: -Infinity, stitch: -Infinity };
  moments.forEach((parts, at) => {
    const header = /** @type {Record<string, any>} */ (parts.at(-1)?.header ?? {});
    const now = { cut: header.cut_count ?? before.cut, patch: header.patches?.length ?? 0, stitch: header.stitches?.length ?? 0 };
    const time = header.time_s ?? 0;
    for (const kind of /** @type {const} */ (["cut", "patch", "stitch"])) {
      if (now[kind] > before[kind]) {
        if (time - last[kind] > ROW_S) marks.push({ at, kind, time });
        last[kind] = time;
      }
      before[kind] = now[kind];
    }
  });
  return marks;
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
