/** Two by two, or one large: where the tiles are, and what the fourth one shows. */

import { language, say } from "../../shared/words.js";
import { HELP } from "../tools/shortcuts.js";
import { element } from "../../shared/elements.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../../shared/signal.js").Signal<boolean>} Switch */

/** @param {Studio} studio @param {import("../pictures/views.js").Views} views */
export function runTiles(studio, views) {
  const desk = /** @type {HTMLElement} */ (document.getElementById("desk"));
  for (const tile of /** @type {NodeListOf<HTMLElement>} */ (desk.querySelectorAll("[data-tile]"))) {
    const name = /** @type {import("../studio.js").ViewName | "solid"} */ (tile.dataset.tile);
    const button = /** @type {HTMLButtonElement} */ (tile.querySelector(".enlarge"));
    button.addEventListener("click", () => (studio.large.value = studio.large.value === name ? null : name));
    tile.querySelector(".tile-bar")?.addEventListener("dblclick", (event) => {
      if (!(/** @type {Element} */ (event.target).closest("button, input"))) button.click();
    });
    studio.large.follow((large) => {
      tile.classList.toggle("large", large === name);
      button.setAttribute("aria-pressed", String(large === name));
    });
  }
  studio.large.follow((large) => desk.classList.toggle("one-large", large !== null));
  studio.activeView.follow((active) => {
    for (const view of views.all) view.tile.classList.toggle("active", view.name === active);
  });
  for (const view of views.all) {
    view.slider.addEventListener("input", () => {
      const lattice = studio.lattice.value;
      if (lattice) view.scroll(Number(view.slider.value) - view.slices(lattice).at);
    });
  }
}

/** @param {Switch} keysAreOn */
export function runHelp(keysAreOn) {
  const list = /** @type {HTMLElement} */ (document.getElementById("keys"));
  language.follow(() => {
    list.replaceChildren(
      ...HELP.flatMap(([keys, word]) => [element("dt", "", keys), element("dd", "", say(word))]),
    );
  });
  const box = /** @type {HTMLInputElement} */ (document.getElementById("keys-on"));
  box.addEventListener("change", () => (keysAreOn.value = box.checked));
  keysAreOn.follow((on) => (box.checked = on));
}
