/** Tabs of a panel. */

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
