/** The list of structures: which is in hand, which are shown and locked, how large and how far each is. */

import { element, icon } from "../../shared/elements.js";
import { figure, language, say, structureName } from "../../shared/words.js";
import { keyOf } from "../tools/shortcuts.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../studio.js").Label} Label */
/** @typedef {import("../pictures/views.js").Views} Views */
/** @typedef {"nothing" | "marked" | "confident" | "unsure"} State */

/** What stands for a state in the list. @type {Record<State, string>} */
const SIGNS = { nothing: "○", marked: "·", confident: "✓", unsure: "?" };

export class Structures {
  /** Null while they are counted. @type {Record<string, number> | null} */
  #volumes = {};
  /** Names of those that are marked; null while the server has not said. @type {ReadonlySet<string> | null} */
  #marked = null;
  /** @type {ReadonlySet<string>} */
  #locked = new Set();
  /** Whether a structure can be right: while others are missing it may hold them. */
  #isComplete = true;
  /** As they were worked out last. @type {Record<string, State>} */
  #states = {};

  /**
   * @param {HTMLElement} list
   * @param {Studio} studio
   * @param {Views} views
   * @param {(name: string, locked: boolean) => void} lock
   */
  constructor(list, studio, views, lock) {
    this.list = list;
    this.lock = lock;
    this.studio = studio;
    this.views = views;
    studio.labels.listen(() => this.#build());
    studio.picked.listen(() => this.#update());
    studio.hidden.listen(() => this.#update());
    language.listen(() => this.#build());
  }

  /** @param {Record<string, State>} states */
  tellStates(states) {
    this.#states = states;
    this.#update();
  }

  /** @param {Record<string, number>} volumesMl */
  tellVolumes(volumesMl) {
    this.#volumes = volumesMl;
    this.#update();
  }

  /** @param {Record<string, number> | undefined} volumesMl where they are known already @param {readonly string[] | undefined} marked @param {readonly string[]} locked @param {boolean} [isComplete] whether all that a heart has is marked */
  tell(volumesMl, marked, locked, isComplete = true) {
    this.#isComplete = isComplete;
    this.#volumes = volumesMl ?? null;
    this.#locked = new Set(locked);
    // they are worked out anew
    this.#states = {};
    this.#marked = marked ? new Set(marked) : null;
    this.#update();
  }

  #build() {
    const { labels } = this.studio;
    this.list.replaceChildren(...labels.value.map((label) => this.#row(label)));
    this.#update();
  }

  /** @param {Label} label */
  #row(label) {
    const row = element("li", "structure");
    row.dataset.value = String(label.value);
    const pick = element("button", "pick");
    pick.type = "button";
    const chip = element("span", "chip");
    chip.style.background = label.colour;
    const key = keyOf(label, this.studio.labels.value);
    const shown = structureName(label.name);
    const name = element("span", "name", shown);
    name.title = shown;
    pick.append(chip, name, element("kbd", "", key), element("span", "volume"), element("span", "mark"));
    pick.addEventListener("click", (event) => {
      this.studio.pick(label.value);
      // By mouse one goes on in the picture, where the arrows step slices.
      if (event.detail > 0) this.views.active.surface.focus({ preventScroll: true });
    });
    const show = element("button", "show");
    show.type = "button";
    show.setAttribute("aria-label", say("show_structure", { name: shown }));
    show.title = say("show_structure", { name: shown });
    show.append(icon("eye"));
    show.addEventListener("click", () => this.studio.toggleShown(label.value));
    const lock = element("button", "lock");
    lock.type = "button";
    lock.setAttribute("aria-label", say("lock_structure", { name: shown }));
    lock.title = `${say("lock_structure", { name: shown })}. ${say("lock_says")}`;
    lock.append(icon("lock"));
    lock.addEventListener("click", () => this.lock(label.name, !this.#locked.has(label.name)));
    row.append(pick, lock, show);
    return row;
  }

  #update() {
    const { labels, picked, hidden } = this.studio;
    const background = labels.value.find(({ role }) => role === "background");
    // until then they are those of the whole scan
    const isBounded = !background || this.#marked === null || this.#marked.has(background.name);
    for (const row of /** @type {Iterable<HTMLElement>} */ (this.list.children)) {
      const value = Number(row.dataset.value);
      const label = labels.value.find((one) => one.value === value);
      if (!label) continue;
      const volume = this.#volumes?.[label.name];
      // Before the server says what is marked, what has a volume must be.
      const isMarked = this.#marked ? this.#marked.has(label.name) : (volume ?? 0) > 0;
      const isPicked = picked.value === value;
      row.classList.toggle("picked", isPicked);
      part(row, ".pick").setAttribute("aria-pressed", String(isPicked));
      part(row, ".show").setAttribute("aria-pressed", String(!hidden.value.has(value)));
      const hasVolume = isBounded && label.role !== "background" && isMarked;
      const text = this.#volumes === null ? "…" : volume === undefined ? "" : `${figure(volume, volume < 10 ? 2 : 1)} ml`;
      part(row, ".volume").textContent = hasVolume ? text : "";
      part(row, ".volume").title = hasVolume ? say("volume_says") : "";
      part(row, ".lock").setAttribute("aria-pressed", String(this.#locked.has(label.name)));
      const state = !isMarked ? "nothing" : (this.#states[label.name] ?? "marked");
      const mark = part(row, ".mark");
      const words = say(`state_${state}`);
      const shown = SIGNS[state === "confident" && !this.#isComplete ? "marked" : state];
      if (mark.dataset.state === state && mark.title === words && mark.lastElementChild?.textContent === shown) continue;
      const sign = element("span", "", shown);
      sign.setAttribute("aria-hidden", "true");
      mark.replaceChildren(element("span", "hidden-words", words), sign);
      mark.dataset.state = state;
      mark.title = words;
    }
  }
}

/** @param {HTMLElement} row @param {string} selector */
function part(row, selector) {
  return /** @type {HTMLElement} */ (row.querySelector(selector));
}
