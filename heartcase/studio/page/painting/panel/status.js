/** What goes on: saved or not, connected or not, what was refused, how far the opening is. */

import { element, problemList } from "../../shared/elements.js";
import { showCompiling, tellLost } from "../../shared/looks.js";
import { figure, language, positionText, say, structureName } from "../../shared/words.js";

/** @typedef {import("../../shared/connection.js").Problem} Problem */
/** @typedef {import("../../shared/connection.js").Connection} Connection */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../pictures/views.js").Views} Views */
/** @typedef {import("../../shared/words.js").Word} Word */
/** @typedef {import("../../shared/connection.js").Message} Message */

export class Status {
  /**
   * @param {Document} page
   * @param {Studio} studio
   * @param {Views} views
   * @param {Connection} connection
   */
  constructor(page, studio, views, connection) {
    const find = (/** @type {string} */ id) => /** @type {HTMLElement} */ (page.getElementById(id));
    this.studio = studio;
    this.views = views;
    this.connection = connection;
    this.parts = {
      saved: find("saved"), under: find("under"), notice: find("notice"), words: find("notice-words"),
      curtain: find("curtain"), curtainWords: find("curtain-words"), bar: /** @type {HTMLProgressElement} */ (find("curtain-bar")),
      compiling: find("curtain-compiling"),
    };
    find("notice-close").addEventListener("click", () => this.clear());
    for (const signal of [connection.state, connection.changing, studio.ready, studio.saved, studio.spreads, language]) {
      /** @type {import("../../shared/signal.js").Signal<any>} */ (signal).follow(() => this.#tellState());
    }
    studio.hover.follow(() => this.#tellPointer());
    studio.crosshair.listen(() => this.#tellPointer());
  }

  /** @param {string | null} text @param {number | null} fraction */
  progress(text, fraction) {
    const { curtain, curtainWords, bar } = this.parts;
    curtain.hidden = text === null;
    if (text === null) return;
    curtainWords.replaceChildren(text);
    bar.hidden = false;
    if (fraction === null) bar.removeAttribute("value");
    else bar.value = fraction;
  }

  /** How far this installation is with what it compiles once, as what is waited for may need it. @param {Message} message */
  compiling(message) {
    showCompiling(this.parts.compiling, message);
  }

  /** Nothing more will come: say why, for good. @param {Word} heading @param {readonly Problem[]} problems */
  stop(heading, problems) {
    const { curtain, curtainWords, bar } = this.parts;
    curtain.hidden = false;
    bar.hidden = this.parts.compiling.hidden = true;
    curtainWords.replaceChildren(element("strong", "", say(heading)), problemList(problems));
  }

  /** @param {readonly Problem[]} problems */
  refused(problems) {
    const { notice, words } = this.parts;
    notice.hidden = false;
    words.replaceChildren(element("strong", "", say("refused")), problemList(problems));
  }

  clear() {
    this.parts.words.replaceChildren();
    this.parts.notice.hidden = true;
  }

  #tellState() {
    const { connection, studio, parts } = this;
    const { saved } = parts;
    const state = connection.state.value;
    const isLost = state === "lost" || state === "stranger";
    tellLost(state, isLost ? say(state) : "");
    const isGone = isLost || state === "ended";
    const isSaved = studio.ready.value && studio.saved.value && connection.changing.value === 0;
    saved.textContent = isGone ? say("state_lost") : !studio.ready.value ? say("state_opening") : !isSaved ? say("saving") : studio.spreads.value ? say("spreading") : say("saved");
    saved.dataset.state = isGone ? "lost" : isSaved ? "saved" : "saving";
  }

  #tellPointer() {
    const { studio, views } = this;
    const lattice = studio.lattice.value;
    const volume = views.volume;
    if (lattice === null || volume === null) return;
    const mm = studio.hover.value?.mm ?? studio.crosshair.value;
    const voxel = lattice.voxelAt(mm);
    let text = `${positionText(mm)} mm`;
    if (voxel) {
      const intensity = volume.intensityAt(voxel);
      const value = volume.labelAt(voxel);
      const label = studio.labels.value.find((one) => one.value === value);
      const name = label ? structureName(label.name) : say("undecided");
      if (intensity !== null) text += `   ${figure(intensity, 0)}${studio.modality.value === "CT" ? " HU" : ""}`;
      text += `   ${name}`;
    }
    this.parts.under.textContent = text;
  }
}
