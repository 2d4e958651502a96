/** Buttons for what is taken in hand, its size, and where keys lead it: the same with a server and without. */

import { element } from "../shared/elements.js";
import { figure, isWord, say } from "../shared/words.js";

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class ToolBar {
  /** Key of what is in hand; empty for nothing. */
  tool = "";

  /** @param {(tool: string) => void} take what a button's click does */
  constructor(take) {
    this.take = take;
  }

  /** A button for nothing, and one for each tool. @param {readonly string[]} keys */
  fill(keys) {
    find("tools").replaceChildren(
      ...["", ...keys].map((key) => {
        const shown = key || "o";
        const word = `operate_tool_${shown}`;
        const button = element("button", "", isWord(word) ? say(word) : shown);
        button.type = "button";
        button.dataset.key = key;
        button.title = `${button.textContent} (${shown.toUpperCase()})`;
        button.setAttribute("aria-pressed", String(key === this.tool));
        button.addEventListener("click", () => this.take(key));
        return button;
      }),
    );
  }

  /** @param {string} tool that is in hand now */
  choose(tool) {
    this.tool = tool;
    document.body.dataset.tool = tool;
    for (const button of find("tools").querySelectorAll("button")) {
      button.setAttribute("aria-pressed", String(button.dataset.key === tool));
    }
  }

  /** @param {boolean} isRecording what the button of recordings does then: end it */
  tellRecording(isRecording) {
    const button = find("record"), word = isRecording ? "operate_stop_recording" : "operate_record";
    button.classList.toggle("is-on", isRecording);
    const words = /** @type {HTMLElement} */ (button.querySelector("span"));
    if (words.dataset.word === word) return;
    words.dataset.word = word;
    words.textContent = say(word);
  }

  /** @param {boolean} isBegun whether hands were asked for that hold the last cut open, and are still to close */
  tellHolding(isBegun) {
    const button = /** @type {HTMLButtonElement} */ (find("hold-last"));
    button.disabled = isBegun;
    button.dataset.word = isBegun ? "operate_holding" : "figures_hold";
    button.textContent = say(isBegun ? "operate_holding" : "figures_hold");
  }

  /** @param {number | null} size of what is in hand; null where it has none @param {number} [digits] behind the point */
  tellSize(size, digits = 0) {
    for (const id of ["smaller", "larger"]) /** @type {HTMLButtonElement} */ (find(id)).disabled = !size;
    const word = `operate_size_${this.tool}`;
    const words = size === null ? say("operate_no_tool") : isWord(word) ? say(word, { size: figure(size, digits) }) : String(size);
    find("size").textContent = words;
    const hint = `operate_hint_${this.tool}`;
    // without a server there is no place for it
    const shown = document.getElementById("tool-hint");
    if (shown === null) return;
    shown.hidden = !isWord(hint);
    shown.textContent = isWord(hint) ? say(hint) : "";
  }
}

/** Show where keys lead what is in hand. @param {{x: number, y: number} | null} cursor @param {string} [id] of the element that shows it */
export function showCursor(cursor, id = "cursor") {
  const shown = find(id);
  shown.hidden = cursor === null;
  if (cursor) Object.assign(shown.style, { left: `${cursor.x}px`, top: `${cursor.y}px` });
}
