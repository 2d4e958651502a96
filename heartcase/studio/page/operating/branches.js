/** What was taken back, or gone back behind, and left when time went on another way: a list to bring it back from. */

import { element } from "../shared/elements.js";
import { figure, isWord, language, say } from "../shared/words.js";

/** @typedef {{number: number, start_s: number, end_s: number, marks: Record<string, number>}} Branch */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class Branches {
  /** @type {readonly Branch[]} */
  #all = [];
  /** The latest of which the page was told; null before it was told of any of this session. @type {number | null} */
  #latest = null;

  /** @param {{bringBack: (number: number) => void, left: (branch: Branch) => void}} does `left` is told when another one came */
  constructor(does) {
    this.does = does;
    language.listen(() => this.#fill());
  }

  /** Another session began, or the page came back: what it has already is no news. */
  begin() {
    this.#latest = null;
    this.#all = [];
    this.#fill();
  }

  /** @param {readonly Branch[]} all the latest first */
  show(all) {
    const latest = all.length > 0 ? all[0].number : 0;
    if (this.#latest !== null && latest > this.#latest) this.does.left(all[0]);
    this.#latest = latest;
    this.#all = all;
    this.#fill();
  }

  #fill() {
    find("branches-part").hidden = this.#all.length === 0;
    find("branches").replaceChildren(...this.#all.map((one) => {
      const row = element("li");
      const words = branchWords(one);
      const button = element("button", "", say("branch_bring_back"));
      button.type = "button";
      button.setAttribute("aria-label", `${say("branch_bring_back")}: ${words}`);
      button.addEventListener("click", () => this.does.bringBack(one.number));
      row.append(element("span", "name", words), button);
      return row;
    }));
  }
}

/** From when to when it is, and what was done. @param {Branch} branch */
export function branchWords({ start_s: start, end_s: end, marks }) {
  const acts = Object.entries(marks).map(([kind, count]) => {
    const word = `branch_${kind}_${count === 1 ? "one" : "several"}`;
    return isWord(word) ? say(word, { count: figure(count, 0) }) : `${kind}: ${count}`;
  });
  const time = say("branch_time", { start: figure(start, 2), end: figure(end, 2) });
  return acts.length > 0 ? `${time}: ${acts.join(", ")}` : time;
}
