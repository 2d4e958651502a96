/** The series of a scan, as a table with pictures: one is chosen, and a recipe is begun for it. */

import { element } from "../shared/elements.js";
import { figure, isWord, language, say } from "../shared/words.js";

/** @typedef {import("./chooser.js").Ask} Ask */
/**
 * @typedef {{series: string | null, number: number, modality: string, description: string, slice_count: number,
 *   spacing_mm: [number, number, number] | null, trigger_times_ms: number[], echo_times_ms: number[], good_for: string[],
 *   can_be_read: boolean, picture: string | null}} Shown
 */

/** The heart moves least late in the beat: the phase that is proposed lies nearest to this part of the last one's time. */
const REST = 0.75;
const GOOD = ["fine", "medium"];

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
/** @param {string} id */
const field = (id) => /** @type {HTMLInputElement} */ (find(id));

export class Series {
  #path = "";
  /** @type {Shown[]} */
  #shown = [];
  #picked = -1;

  /** @param {Ask} ask */
  constructor(ask) {
    find("begin-form").addEventListener("submit", (event) => {
      event.preventDefault();
      const chosen = this.#shown[this.#picked];
      if (!chosen) return;
      void ask({
        do: "begin",
        path: this.#path,
        ...(chosen.series ? { series: chosen.series } : {}),
        ...(find("phase-part").hidden ? {} : { trigger_time_ms: Number(field("phase").value) }),
        ...(find("echo-part").hidden ? {} : { echo_time_ms: Number(field("echo").value) }),
        folder: field("recipe-folder").value,
        file: field("recipe-file").value.trim(),
        name: field("case-named").value.trim(),
      });
    });
    // the file is called like the case, until it is told otherwise
    let isOwn = true;
    field("recipe-file").addEventListener("input", () => (isOwn = false));
    field("case-named").addEventListener("input", () => {
      if (isOwn) field("recipe-file").value = `${field("case-named").value.trim().replace(/[^A-Za-z0-9_-]+/g, "_") || "heart"}.toml`;
    });
    language.listen(() => this.#draw());
  }

  hide() {
    find("series").hidden = true;
  }

  /** @param {string} path @param {string} folder where the recipe goes, unless told otherwise @param {Shown[]} shown */
  show(path, folder, shown) {
    this.#path = path;
    this.#shown = shown;
    field("recipe-folder").value = folder;
    find("series").hidden = false;
    const best = shown.findIndex((one) => one.can_be_read && one.good_for.some((key) => GOOD.includes(key)));
    this.#picked = best >= 0 ? best : shown.findIndex((one) => one.can_be_read);
    this.#draw();
    this.#offer();
    find("series").scrollIntoView({ block: "nearest" });
    /** @type {HTMLElement | null} */ (find("series-rows").querySelector("input:checked"))?.focus();
  }

  #draw() {
    const had = document.activeElement?.id;
    find("series-rows").replaceChildren(...this.#shown.map((one, n) => this.#row(one, n)));
    if (had?.startsWith("series-")) document.getElementById(had)?.focus();
  }

  /** @param {Shown} one @param {number} n */
  #row(one, n) {
    const row = element("tr", n === this.#picked ? "picked" : "");
    const radio = element("input");
    radio.type = "radio";
    radio.name = "series";
    radio.id = `series-${n}`;
    radio.checked = n === this.#picked;
    radio.disabled = !one.can_be_read;
    radio.setAttribute("aria-label", `${one.number}: ${one.description}`);
    radio.addEventListener("change", () => this.#pick(n));
    row.addEventListener("click", (event) => {
      if (one.can_be_read && event.target !== radio) radio.click();
    });
    const picture = one.picture ? element("img") : element("span", "soft", "–");
    if (picture instanceof HTMLImageElement && one.picture) {
      picture.src = one.picture;
      picture.alt = "";
    }
    const what = element("div");
    what.append(element("span", "modality", one.modality), element("div", "soft", one.description));
    const good = element("ul", "good-for");
    good.append(...one.good_for.map((key) => {
      const word = `start_good_${key}`;
      return element("li", GOOD.includes(key) ? "good" : key === "phases" ? "" : "look", isWord(word) ? say(word) : key);
    }));
    const voxel = one.spacing_mm ? `${one.spacing_mm.map((mm) => figure(mm, 2)).join(" × ")} mm` : "–";
    for (const part of [radio, picture, what, element("span", "figures", voxel), element("span", "figures", figure(one.slice_count, 0)), good]) {
      const cell = element("td");
      cell.append(part);
      row.append(cell);
    }
    return row;
  }

  /** @param {number} n */
  #pick(n) {
    this.#picked = n;
    for (const [at, row] of [...find("series-rows").children].entries()) row.classList.toggle("picked", at === n);
    this.#offer();
  }

  /** The phases and echoes of the series that is picked. */
  #offer() {
    const one = this.#shown[this.#picked];
    find("begin-form").hidden = !one;
    if (!one) return;
    const times = one.trigger_times_ms;
    const rest = REST * (times.at(-1) ?? 0);
    const proposed = times.reduce((best, time) => (Math.abs(time - rest) < Math.abs(best - rest) ? time : best), times[0] ?? 0);
    offer("phase", times, proposed);
    offer("echo", one.echo_times_ms, one.echo_times_ms[0] ?? 0);
  }
}

/** @param {"phase" | "echo"} what @param {number[]} times @param {number} chosen */
function offer(what, times, chosen) {
  find(`${what}-part`).hidden = times.length < 2;
  find(what).replaceChildren(
    ...times.map((time) => {
      const option = element("option", "", `${figure(time, 0)} ms`);
      option.value = String(time);
      option.selected = time === chosen;
      return option;
    }),
  );
}
