/** A folder of this machine: the browser cannot name files, so the server lists them. */

import { element, icon } from "../shared/elements.js";
import { figure, isWord, language, say } from "../shared/words.js";

/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {import("./start.js").Request} Request */
/** @typedef {(request: Request, then?: (answer: Message) => void, isQuiet?: boolean) => Promise<void>} Ask */
/** @typedef {{name: string, kind: string}} Entry */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class Chooser {
  /** The folder that is shown. */
  folder = "";
  #parent = /** @type {string | null} */ (null);
  #more = 0;
  #isCut = false;

  /** @param {Ask} ask @param {import("./series.js").Series} series */
  constructor(ask, series) {
    this.ask = ask;
    this.series = series;
    this.path = /** @type {HTMLInputElement} */ (find("path"));
    find("path-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.go(this.path.value.trim() || null);
    });
    find("up").addEventListener("click", () => void (this.#parent !== null && this.go(this.#parent)));
    find("look").addEventListener("click", () => this.look());
    // Arrows go from one entry to the next, as in any list of files.
    find("entries").addEventListener("keydown", (event) => {
      const step = { ArrowDown: 1, ArrowUp: -1 }[event.key] ?? 0;
      const buttons = [.../** @type {NodeListOf<HTMLElement>} */ (find("entries").querySelectorAll("button"))];
      const at = buttons.indexOf(/** @type {HTMLElement} */ (document.activeElement));
      if (event.key === "Backspace" && this.#parent !== null) void this.go(this.#parent);
      if (step === 0 || at < 0) return;
      event.preventDefault();
      buttons[Math.min(Math.max(at + step, 0), buttons.length - 1)].focus();
    });
    language.listen(() => this.#tellMore());
  }

  /** Show a folder; where a file is named, open it. @param {string | null} path */
  async go(path) {
    await this.ask(path === null ? { do: "list" } : { do: "list", path }, (answer) => {
      const hadFocus = find("entries").contains(document.activeElement);
      this.#show(answer);
      if (hadFocus) find("entries").querySelector("button")?.focus();
      const chosen = answer.entries.find((/** @type {Entry} */ one) => one.name === answer.chosen);
      if (answer.chosen !== null && !chosen) queueMicrotask(() => this.#look(`${answer.path}/${answer.chosen}`, answer.path));
      if (chosen) queueMicrotask(() => this.#choose(chosen));
    });
  }

  /** List the series of the folder that is shown. */
  look(isQuiet = false) {
    this.#look(this.folder, this.#parent ?? this.folder, isQuiet);
  }

  /** @param {string} path @param {string} beside @param {boolean} [isQuiet] */
  #look(path, beside, isQuiet = false) {
    this.series.hide();
    void this.ask({ do: "look", path }, (answer) => this.series.show(path, beside, answer.series), isQuiet);
  }

  /** @param {Message} answer */
  #show(answer) {
    this.folder = answer.path;
    this.#parent = answer.parent;
    this.#more = answer.more;
    this.#isCut = answer.is_cut;
    this.path.value = answer.path;
    /** @type {HTMLButtonElement} */ (find("up")).disabled = answer.parent === null;
    find("roots").hidden = answer.roots.length < 2;
    find("roots").replaceChildren(
      ...answer.roots.map((/** @type {string} */ root) => {
        const button = element("button", "", root);
        button.type = "button";
        button.addEventListener("click", () => void this.go(root));
        return button;
      }),
    );
    find("entries").replaceChildren(...answer.entries.map((/** @type {Entry} */ one) => this.#row(one)));
    if (answer.dicom_count > 0) find("entries").prepend(this.#row({ name: figure(answer.dicom_count, 0), kind: "dicom" }));
    this.series.hide();
    this.#tellMore();
  }

  /** @param {Entry} entry */
  #row(entry) {
    const button = element("button");
    button.type = "button";
    const word = `start_kind_${entry.kind}`;
    const kind = element("span", "kind", isWord(word) ? say(word) : entry.kind);
    kind.dataset.word = word;
    button.append(icon(entry.kind === "zip" ? "dicom" : entry.kind), element("span", "", entry.name), kind);
    button.addEventListener("click", () => this.#choose(entry));
    const row = element("li");
    row.append(button);
    return row;
  }

  /** @param {Entry} entry */
  #choose({ name, kind }) {
    const separator = this.folder.includes("\\") && !this.folder.includes("/") ? "\\" : "/";
    const path = this.folder.endsWith(separator) ? this.folder + name : this.folder + separator + name;
    if (kind === "folder") void this.go(path);
    else if (kind === "recipe" || kind === "case") void this.ask({ do: "open", path });
    else if (kind === "dicom") this.look();
    else this.#look(path, this.folder);
  }

  #tellMore() {
    const isEmpty = find("entries").childElementCount === 0;
    find("entries").hidden = isEmpty;
    find("entries-more").textContent = this.#isCut
      ? say("start_cut")
      : this.#more > 0 ? say("start_more", { count: this.#more }) : isEmpty && this.folder ? say("start_empty") : "";
  }
}
