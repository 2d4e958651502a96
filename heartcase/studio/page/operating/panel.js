/** The panel beside the heart: what is shown, what the instruments feel, recordings, keys. */

import { element, icon } from "../shared/elements.js";
import { nameOf } from "../shared/said.js";
import { figure, isWord, language, say, structureName } from "../shared/words.js";

/** @typedef {import("../shared/words.js").Word} Word */
/** @typedef {import("./heart.js").Structure & {name: string, word?: Word}} Structure */

const FORCES_EVERY_MS = 250;

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** Keys and what they do, in the order in which they are shown. @type {readonly (readonly [string, Word])[]} */
export const HELP = [
  ["O", "operate_help_orbit"],
  ["G P C J F R S N E Z", "operate_help_tools"],
  ["[  ]", "operate_help_size"],
  ["Enter", "operate_help_enter"],
  ["↑ ↓ ← →", "operate_help_arrows"],
  ["Shift + ↑ ↓ ← →", "operate_help_move"],
  ["+  -", "operate_help_zoom"],
  ["Page ↑ ↓", "operate_help_deeper"],
  ["Esc", "operate_help_escape"],
  ["X  T", "operate_help_let_go"],
  ["U  Y", "operate_help_undo"],
  ["Space", "operate_help_pause"],
  ["B  L", "operate_help_back"],
  ["W", "operate_help_record"],
  ["V  A  Home", "operate_help_view"],
  ["Q  M  H", "tour_help"],
  ["K  <  >", "scene_help_plane"],
  ["I  D", "scene_help_views"],
];

/** Name of a structure in a list. @param {Structure} one */
export const shownName = (one) => (one.name === "cut faces" && isWord("operate_cut_faces") ? say("operate_cut_faces") : one.word ? say(one.word) : structureName(one.name));

export class Panel {
  /** @type {Set<number>} */
  hidden = new Set();
  /** @type {readonly Structure[]} */
  #structures = [];
  #toldAt = -Infinity;

  /**
   * @param {{hiddenChanged: () => void, replay: (name: string) => void}} does
   * @param {readonly (readonly [string, Word])[]} [help] keys that there are
   */
  constructor(does, help = HELP) {
    this.does = does;
    find("show-all").addEventListener("click", () => this.showAll());
    language.follow(() => {
      this.#build();
      find("keys").replaceChildren(...help.flatMap(([keys, word]) => [element("dt", "", keys), element("dd", "", say(word))]));
    });
  }

  /** @param {readonly Structure[]} structures */
  setStructures(structures) {
    this.#structures = structures;
    this.#build();
  }

  get structures() {
    return this.#structures;
  }

  showAll() {
    this.hide([]);
  }

  /** Hide these structures, and show all others. @param {readonly number[]} numbers */
  hide(numbers) {
    this.hidden = new Set(numbers);
    this.#build();
    this.does.hiddenChanged();
  }

  hideAll() {
    for (const { value } of this.#structures) this.hidden.add(value);
    this.#build();
    this.does.hiddenChanged();
  }

  #build() {
    find("structures").replaceChildren(
      ...this.#structures.map((one) => {
        const row = element("li", "structure");
        row.dataset.value = String(one.value);
        const chip = element("span", "chip");
        chip.style.background = one.colour;
        const show = element("button", "show");
        show.type = "button";
        show.append(icon("eye"));
        const tell = () => {
          show.setAttribute("aria-pressed", String(!this.hidden.has(one.value)));
          show.setAttribute("aria-label", say("show_structure", { name: shownName(one) }));
        };
        show.addEventListener("click", () => {
          if (!this.hidden.delete(one.value)) this.hidden.add(one.value);
          tell();
          this.does.hiddenChanged();
        });
        tell();
        row.append(chip, element("span", "name", shownName(one)), show);
        return row;
      }),
    );
  }

  /** What instruments, stitches and patches feel. @param {Record<string, any>} header of a frame */
  showForces(header) {
    const now = performance.now();
    if (now - this.#toldAt < FORCES_EVERY_MS && header.mode === "running") return;
    this.#toldAt = now;
    /** @type {[string, number, string][]} */
    const rows = [
      ...header.instruments.map((/** @type {any} */ one) => [nameOf(one.name), Math.hypot(...one.force_n), ""]),
      ...header.stitches.map((/** @type {any} */ one) => [nameOf(one.name), one.force_n, one.tied ? "" : say("operate_not_tied")]),
      ...header.patches.map((/** @type {any} */ one) => [nameOf(one.name), one.force_n, say("operate_in_rim")]),
    ];
    find("no-forces").hidden = rows.length > 0;
    find("forces").replaceChildren(
      ...rows.flatMap(([name, newtons, more]) => [
        element("dt", "", more ? `${name} (${more})` : name), element("dd", "", `${figure(newtons, 2)} N`),
      ]),
    );
  }

  /** @param {readonly string[]} names */
  showRecordings(names) {
    find("recordings").replaceChildren(
      ...names.map((name) => {
        const row = element("li");
        const button = element("button", "", say("operate_replay"));
        button.type = "button";
        button.setAttribute("aria-label", `${say("operate_replay")}: ${name}`);
        button.addEventListener("click", () => this.does.replay(name));
        row.append(element("span", "name", name.replace(/\.recording$/, "")), button);
        return row;
      }),
    );
  }
}
