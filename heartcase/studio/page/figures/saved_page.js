/** The case saved as one HTML file, with the recordings that are ticked: what is known of it. */

import { problemList } from "../shared/elements.js";
import { figure, language, say } from "../shared/words.js";

/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {import("../shared/connection.js").Problem} Problem */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class SavedPage {
  /** @type {Message | null} */
  #message = null;

  /** @param {() => void} save @param {() => void} leave @param {string} address of what was saved */
  constructor(save, leave, address) {
    find("save-page").addEventListener("click", save);
    find("save-page-cancel").addEventListener("click", leave);
    /** @type {HTMLAnchorElement} */ (find("saved-page")).href = address;
    language.follow(() => this.#fill());
  }

  /** @param {Message} message */
  hear(message) {
    this.#message = message;
    this.#fill();
  }

  #fill() {
    const { state, fraction, name, folder, byte_count: byteCount, problems } = /** @type {Record<string, any>} */ (this.#message ?? {});
    /** @type {HTMLButtonElement} */ (find("save-page")).disabled = state === "working";
    const bar = /** @type {HTMLProgressElement} */ (find("save-page-bar"));
    bar.hidden = find("save-page-cancel").hidden = state !== "working";
    // until something is played through, nobody knows how far it is
    const isCounted = (fraction ?? 0) > 0;
    if (!isCounted) bar.removeAttribute("value");
    else bar.value = fraction;
    const link = find("saved-page");
    link.hidden = state !== "saved";
    link.textContent = state === "saved" ? say("save_page_take", { name }) : "";
    const said = state === "working" ? isCounted ? say("save_page_working", { percent: figure(100 * fraction, 0) }) : say("save_page_packing")
      : state === "saved" ? say("save_page_saved", { name, folder, mb: figure(byteCount / 1e6, 1) })
      : state === "failed" ? say("save_page_failed") : "";
    // of a page that is saved they are about its recordings, by the names that users gave these
    const about = state === "saved" ? problems.map((/** @type {Problem} */ one) => ({ ...one, name: one.place, place: "" })) : problems;
    find("save-page-state").replaceChildren(said, ...(about?.length ? [problemList(about)] : []));
  }
}
