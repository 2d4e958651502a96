/** Recordings as plans: named, two of them played side by side, figures of several in one table. */

import { element } from "../shared/elements.js";
import { saidOf } from "../shared/said.js";
import { figure, language, say } from "../shared/words.js";
import { KINDS, rows, trusted, vesselRows } from "./live_figures.js";

/** @typedef {import("../shared/connection.js").Message} Message */

const ENDING = /\.recording$/;
const MOST = 6;

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
/** @param {string} name of a recording's folder */
const shown = (name) => name.replace(ENDING, "");

export class Plans {
  /** @type {readonly string[]} */
  #names = [];
  /** @type {Set<string>} */
  #unfinished = new Set();
  /** In the order in which they were chosen. @type {string[]} */
  #chosen = [];
  /** @type {string | null} */
  #renamed = null;
  /** @type {Message | null} */
  #message = null;

  /**
   * @param {{ask: (request: Record<string, unknown> & {do: string}) => void, replay: (name: string) => void,
   *   sideBySide: (names: [string, string]) => void}} does
   */
  constructor(does) {
    this.does = does;
    find("compare").addEventListener("click", () => does.ask({ do: "compare", names: [...this.#chosen] }));
    find("side-by-side").addEventListener("click", () => {
      const [one, other] = this.#chosen;
      does.sideBySide([one, other]);
    });
    language.follow(() => this.#fill());
  }

  /** Recordings that are ticked. @returns {readonly string[]} */
  get chosen() {
    return this.#chosen;
  }

  /** @param {readonly string[]} names the newest first @param {readonly string[]} unfinished those that were never finished */
  showRecordings(names, unfinished = []) {
    this.#unfinished = new Set(unfinished);
    this.#names = names;
    this.#chosen = this.#chosen.filter((one) => names.includes(one));
    this.#renamed = null;
    this.#fill();
  }

  /** @param {Message} message */
  hear(message) {
    this.#message = message;
    this.#fillTable();
  }

  #fill() {
    find("recordings").replaceChildren(...this.#names.map((name) => (name === this.#renamed ? this.#naming(name) : this.#row(name))));
    find("plans-tools").hidden = this.#names.length === 0;
    this.#tellChosen();
    this.#fillTable();
  }

  /** @param {string} name */
  #row(name) {
    const row = element("li");
    const choose = element("input");
    choose.type = "checkbox";
    choose.checked = this.#chosen.includes(name);
    choose.setAttribute("aria-label", say("plans_choose", { name: shown(name) }));
    choose.addEventListener("change", () => {
      this.#chosen = this.#chosen.filter((one) => one !== name);
      if (choose.checked) this.#chosen.push(name);
      this.#tellChosen();
    });
    const replay = button(say("operate_replay"), `${say("operate_replay")}: ${shown(name)}`, () => this.does.replay(name));
    const rename = button(say("plans_rename"), `${say("plans_rename")}: ${shown(name)}`, () => {
      this.#renamed = name;
      this.#fill();
      /** @type {HTMLInputElement | null} */ (find("recordings").querySelector("input[type=text]"))?.select();
    });
    const named = element("span", "name", shown(name));
    if (this.#unfinished.has(name)) named.append(element("span", "unfinished", say("recording_unfinished")));
    row.append(choose, named, replay, rename);
    return row;
  }

  /** @param {string} name */
  #naming(name) {
    const row = element("li");
    const text = element("input");
    text.type = "text";
    text.maxLength = 80;
    text.value = shown(name);
    text.setAttribute("aria-label", say("plans_new_name", { name: shown(name) }));
    const leave = () => {
      this.#renamed = null;
      this.#fill();
    };
    const done = () => {
      const to = text.value.trim();
      leave();
      if (to && to !== shown(name)) this.does.ask({ do: "rename", name, to });
    };
    text.addEventListener("keydown", (event) => {
      if (event.key === "Enter") done();
      else if (event.key === "Escape") leave();
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
    row.append(text, button(say("plans_name_it"), `${say("plans_rename")}: ${shown(name)}`, done));
    return row;
  }

  #tellChosen() {
    const count = this.#chosen.length;
    /** @type {HTMLButtonElement} */ (find("compare")).disabled = count === 0 || count > MOST;
    /** @type {HTMLButtonElement} */ (find("side-by-side")).disabled = count !== 2;
  }

  #fillTable() {
    const message = this.#message;
    find("plans-state").textContent = message?.is_working ? say("plans_working") : "";
    if (message === null) return;
    /** @type {HTMLElement[]} */
    const parts = [];
    for (const { name: defect, figures, ranked } of message.defects) {
      const names = message.names.filter((/** @type {string} */ name) => name in figures);
      const all = names.map((/** @type {string} */ name) => trusted(figures[name], message.about[name]?.inverted_cell_count ?? 0));
      const lines = [...(defect === "" ? [] : rows(all, KINDS.OF_DEFECT)), ...rows(all, KINDS.OF_INCISION), ...vesselRows(all)];
      const placed = new Map(ranked.map((/** @type {any} */ one) => [one.name, one]));
      if (names.length > 1 && placed.size > 0) {
        const cells = (/** @type {(one: any) => string} */ of) => names.map((/** @type {string} */ name) => (placed.has(name) ? of(placed.get(name)) : "–"));
        lines.unshift([say("plans_place"), cells((one) => `${one.place}${one.is_too_near ? " !" : ""}${one.is_inverted ? " !!" : ""}`)]);
        lines.push([say("plans_score"), cells((one) => (one.score === null ? "–" : figure(one.score, 2)))]);
      }
      parts.push(table(defect, names.map(shown), lines));
    }
    find("plans-table").replaceChildren(...parts);
    const remarks = [];
    for (const name of message.names) {
      const about = message.about[name];
      for (const problem of message.problems[name] ?? []) remarks.push(`${shown(name)}: ${saidOf(problem)}`);
      if (about === undefined) continue;
      if (about.shown_s !== null) remarks.push(`${shown(name)}: ${say("recording_not_whole", { seconds: figure(about.shown_s, 1) })}`);
      remarks.push(say("plans_about", { name: shown(name), incision: about.incision, time: figure(about.time_s, 2) }));
      if (about.inverted_cell_count) remarks.push(`${shown(name)}: ${say("figures_inverted", { count: figure(about.inverted_cell_count, 0) })}`);
      for (const one of about.problems) remarks.push(`${shown(name)}: ${say("figures_left_out", { name: one.place, why: saidOf(one) })}`);
    }
    if (message.defects.some((/** @type {any} */ one) => one.ranked.some((/** @type {any} */ each) => each.is_too_near))) remarks.push(say("plans_too_near"));
    if (message.defects.some((/** @type {any} */ one) => one.ranked.some((/** @type {any} */ each) => each.is_inverted))) remarks.push(say("plans_inverted"));
    if (parts.length > 0) remarks.push(say("plans_scores"));
    find("plans-remarks").replaceChildren(...remarks.map((one) => element("p", "", one)));
  }
}

/** @param {string} caption @param {readonly string[]} names @param {readonly [string, string[]][]} lines */
function table(caption, names, lines) {
  const made = element("table");
  if (caption) made.append(element("caption", "", caption));
  const top = element("tr");
  top.append(element("td"));
  for (const name of names) {
    const head = element("th", "", name);
    head.scope = "col";
    top.append(head);
  }
  const head = element("thead");
  head.append(top);
  const body = element("tbody");
  for (const [label, cells] of lines) {
    const row = element("tr");
    const first = element("th", "", label);
    first.scope = "row";
    row.append(first, ...cells.map((text) => element("td", "", text)));
    body.append(row);
  }
  made.append(head, body);
  const box = element("div", "wide-table");
  box.tabIndex = 0;
  box.setAttribute("role", "region");
  box.setAttribute("aria-label", caption || say("plans_table"));
  box.append(made);
  return box;
}

/** @param {string} words @param {string} label @param {() => void} does */
function button(words, label, does) {
  const made = element("button", "", words);
  made.type = "button";
  made.setAttribute("aria-label", label);
  made.addEventListener("click", does);
  return made;
}
