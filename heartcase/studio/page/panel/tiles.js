/** Two by two, or one large: where the tiles are, and what the fourth one shows. */

import { language, say } from "../shared/words.js";
import { HELP } from "../tools/shortcuts.js";
import { element } from "./structures.js";

/** @typedef {import("../shared/studio.js").Studio} Studio */
/** @typedef {import("../shared/signal.js").Signal<boolean>} Switch */

/** @param {Studio} studio @param {import("../pictures/views.js").Views} views */
export function runTiles(studio, views) {
  const desk = /** @type {HTMLElement} */ (document.getElementById("desk"));
  for (const tile of /** @type {NodeListOf<HTMLElement>} */ (desk.querySelectorAll("[data-tile]"))) {
    const name = /** @type {import("../shared/studio.js").ViewName | "solid"} */ (tile.dataset.tile);
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

/** The fourth tile's tabs, as the pattern for tabs has them: arrows go from one to the next. */
export function runTabs(onChosen = (/** @type {string} */ _id) => {}) {
  const tabs = /** @type {HTMLElement[]} */ ([...document.querySelectorAll("[role=tab]")]);
  /** @param {HTMLElement} chosen */
  const choose = (chosen) => {
    for (const tab of tabs) {
      const isChosen = tab === chosen;
      tab.setAttribute("aria-selected", String(isChosen));
      tab.tabIndex = isChosen ? 0 : -1;
      const body = document.getElementById(tab.getAttribute("aria-controls") ?? "");
      if (body) body.hidden = !isChosen;
    }
    onChosen(chosen.id);
  };
  tabs.forEach((tab, n) => {
    tab.addEventListener("click", () => choose(tab));
    tab.addEventListener("keydown", (event) => {
      const step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
      if (step === 0) return;
      event.preventDefault();
      let at = n + step + tabs.length;
      while (tabs[at % tabs.length].hidden) at += step;
      const next = tabs[at % tabs.length];
      choose(next);
      next.focus();
    });
  });
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
