/** The time line: where the session is, how far it is known, going back and on along it. */

import { element } from "../shared/elements.js";
import { figure, fillWords, language, say } from "../shared/words.js";

/** Step, and what was done then. @typedef {[number, "cut" | "excision" | "patch" | "stitch"]} Mark */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** A mark on the line: a click goes there. @param {Mark[1]} kind @param {number} timeS @param {() => void} go */
export function timeMark(kind, timeS, go) {
  const mark = element("span", kind);
  mark.title = say(`operate_mark_${kind}`, { time: figure(timeS, 2) });
  mark.addEventListener("click", go);
  return mark;
}

/** How many times as quick as it was. */
const SPEEDS = [0.25, 0.5, 1, 2, 4];

/** The speeds that can be chosen, in the page's language; what was chosen stays. @param {HTMLSelectElement} select */
export function fillSpeeds(select) {
  const chosen = Number(select.value || 1);
  select.replaceChildren(...SPEEDS.map((one) => new Option(`${one.toLocaleString(language.value)} ×`, String(one), one === 1, one === chosen)));
}

export class TimeLine {
  #slider = /** @type {HTMLInputElement} */ (find("time"));
  #wanted = /** @type {number | null} */ (null);
  #isAsking = false;
  stepS = 1;
  mode = "";
  /** @type {readonly Mark[]} */
  #marks = [];
  #markLanguage = "";
  #markEnd = 0;

  /** @param {(step: number) => Promise<unknown>} goTo */
  constructor(goTo) {
    this.goTo = goTo;
    this.#slider.addEventListener("input", () => {
      this.#wanted = Number(this.#slider.value);
      void this.#go();
    });
  }

  /** @param {Record<string, any>} header of a frame */
  show(header) {
    const end = Math.round(header.end_s / this.stepS);
    this.#showMarks(header.marks ?? this.#marks, Math.max(end, 1));
    if (this.#wanted === null && !this.#isAsking) {
      this.#slider.max = String(Math.max(end, 1));
      this.#slider.value = String(header.step);
    }
    const words = say("operate_time_words", { time: figure(header.time_s, 2), end: figure(header.end_s, 2) });
    find("time-words").textContent = words;
    this.#slider.setAttribute("aria-valuetext", words);
    /** @type {HTMLButtonElement} */ (find("play")).disabled = header.mode === "playing" || header.end_s <= header.time_s;
    /** @type {HTMLButtonElement} */ (find("back")).disabled = header.step === 0;
    if (header.mode !== this.mode) this.tell(header.mode);
  }

  /** Where something was cut, patched or stitched: a click goes there; keys have the slider. @param {readonly Mark[]} marks @param {number} end */
  #showMarks(marks, end) {
    const list = find("time-marks");
    if (marks !== this.#marks || language.value !== this.#markLanguage) {
      this.#marks = marks;
      this.#markLanguage = language.value;
      this.#markEnd = 0;
      list.replaceChildren(...marks.map(([step, kind]) => timeMark(kind, step * this.stepS, () => {
        this.#wanted = step;
        void this.#go();
      })));
    }
    // what is pointed at stays the same element while time goes on
    if (end === this.#markEnd) return;
    this.#markEnd = end;
    marks.forEach(([step], n) => (/** @type {HTMLElement} */ (list.children[n]).style.left = `${(100 * step) / end}%`));
  }

  /** @param {string} mode */
  tell(mode) {
    this.mode = mode;
    const words = find("mode");
    words.dataset.mode = mode;
    words.textContent = mode ? say(/** @type {any} */ (`operate_mode_${mode}`)) : "";
    const pause = find("pause");
    const isStanding = mode === "paused";
    pause.dataset.label = isStanding ? "operate_go_on" : "operate_pause";
    /** @type {Element} */ (pause.querySelector("use")).setAttribute("href", isStanding ? "#icon-go" : "#icon-pause");
    fillWords(/** @type {ParentNode} */ (pause.parentNode));
  }

  async #go() {
    if (this.#isAsking) return;
    this.#isAsking = true;
    while (this.#wanted !== null) {
      const step = this.#wanted;
      this.#wanted = null;
      await this.goTo(step).catch(() => undefined);
    }
    this.#isAsking = false;
  }
}
