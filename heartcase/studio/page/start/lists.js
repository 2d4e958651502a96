/** What was opened last, and the sample cases. */

import { element, icon } from "../shared/elements.js";
import { isWord, language, say } from "../shared/words.js";

/** @typedef {import("./chooser.js").Ask} Ask */
/** @typedef {{key: string, kind: string, name: string, folder: string | null, opened: string, is_there: boolean}} Work */
/** @typedef {{name: string, titles: Record<string, string>, can_be_opened: boolean}} Sample */

/** Letters of a folder's path that are shown: more would take a second line. */
const SHOWN_LETTERS = 40;

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class Lists {
  /** @type {Work[]} */
  #recent = [];
  /** Null until they came. @type {Sample[] | null} */
  #samples = null;

  /** @param {Ask} ask @param {() => string} folder that copies go into */
  constructor(ask, folder) {
    this.ask = ask;
    this.folder = folder;
    language.listen(() => this.#draw());
  }

  /** @param {Work[]} recent */
  showRecent(recent) {
    this.#recent = recent;
    this.#draw();
  }

  /** @param {Sample[]} samples */
  showSamples(samples) {
    this.#samples = samples;
    this.#draw();
  }

  #draw() {
    const none = element("li", "soft", say("start_no_recent"));
    find("recent-rows").replaceChildren(...(this.#recent.length > 0 ? this.#recent.map((one) => this.#work(one)) : [none]));
    const samples = this.#samples ?? [];
    find("samples-says").textContent = say(this.#samples === null ? "looking" : samples.length > 0 ? "start_samples_says" : "start_no_samples");
    find("sample-rows").replaceChildren(...samples.map((one) => this.#sample(one)));
  }

  /** @param {Work} work */
  #work({ key, kind, name, folder, opened, is_there: isThere }) {
    const row = element("li");
    const word = `start_kind_${kind}`;
    const date = new Date(opened).toLocaleString(language.value, { dateStyle: "medium", timeStyle: "short" });
    const about = `${isWord(word) ? say(word) : kind}, ${date}`;
    if (isThere) {
      const button = element("button", "open");
      button.type = "button";
      button.append(element("b", "", name), where(folder), element("span", "", about));
      button.addEventListener("click", () => void this.ask({ do: "reopen", key }));
      row.append(button);
    } else {
      const gone = element("div", "gone", name);
      gone.append(where(folder), element("span", "gone-says", say("start_gone")));
      row.append(gone);
    }
    const forget = element("button", "", "×");
    forget.type = "button";
    forget.title = say("start_forget", { name });
    forget.setAttribute("aria-label", forget.title);
    forget.addEventListener("click", () => void this.ask({ do: "forget", key }));
    row.append(forget);
    return row;
  }

  /** @param {Sample} sample */
  #sample({ name, titles, can_be_opened: canBeOpened }) {
    const row = element("li");
    const button = element("button");
    button.type = "button";
    button.disabled = !canBeOpened;
    button.append(icon("case"), element("span", "", titles[language.value] ?? titles.en ?? name));
    button.addEventListener("click", () => void this.ask({ do: "sample", name, folder: this.folder() }));
    row.append(button);
    if (!canBeOpened) row.append(element("div", "why", say("start_sample_not")));
    return row;
  }
}

/** The folder that an entry lies in: two of one name are told apart by it. @param {string | null} folder */
function where(folder) {
  if (folder === null) return element("span", "folder", say("start_elsewhere"));
  const shown = element("span", "folder", shortened(folder));
  shown.title = folder;
  return shown;
}

/** The last folders of a path, as many as there is room for: they tell two apart sooner than the first. @param {string} path */
export function shortened(path) {
  if (path.length <= SHOWN_LETTERS) return path;
  const parts = path.split("/");
  let shown = /** @type {string} */ (parts.pop());
  while (parts.length > 0 && shown.length + parts[parts.length - 1].length + 3 <= SHOWN_LETTERS) shown = `${parts.pop()}/${shown}`;
  return parts.length > 0 ? `…/${shown}` : shown;
}
