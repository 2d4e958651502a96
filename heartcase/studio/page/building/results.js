/** What a case holds: warnings that lead to their places, volumes, openings; marks in the slices. */

import { element } from "../shared/elements.js";
import { distance } from "../shared/geometry.js";
import { figure, isWord, language, say, showNotice, structureName } from "../shared/words.js";
import { warningWords } from "./warning_words.js";

/** @typedef {import("./build_tab.js").Case} Case */
/** @typedef {import("./build_tab.js").Warning} Warning */
/** @typedef {import("./build_tab.js").Opening} Opening */

const GRADES = ["anatomy", "look", "note"];
/** Warning of walls that were grown and that nobody saw. */
const GROWN = "grown-septum";
/** Openings that no normal heart has, or that nobody stated. */
const ODD = ["unexpected", "other ventricle", "unknown", "walled"];

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class Results {
  /** @type {Case | null} */
  #case = null;
  /** @type {Record<string, number>} */
  #beforeMl = {};
  /** Texts of warnings that were looked at. @type {Set<string>} */
  #seen = new Set();
  /** Which place of a warning was looked at last. @type {Map<string, number>} */
  #at = new Map();
  /** Which of its places were. @type {Map<string, Set<number>>} */
  #shown = new Map();
  /** Told when a warning was looked at. @type {() => void} */
  onSeen = () => undefined;

  /**
   * @param {import("../painting/studio.js").Studio} studio
   * @param {import("../painting/pictures/views.js").Views} views
   * @param {import("./contacts.js").Contacts} contacts
   */
  constructor(studio, views, contacts) {
    this.studio = studio;
    this.views = views;
    this.contacts = contacts;
    contacts.onSaid = () => this.#case && this.#drawWarnings(this.#case);
    const box = /** @type {HTMLInputElement} */ (find("openings-marked"));
    box.addEventListener("change", () => this.#mark());
    language.listen(() => this.#draw());
  }

  /** Whether every warning that is more than a note was looked at. */
  get areSeen() {
    return (this.#case?.warnings ?? []).every(({ text, grade }) => grade === "note" || this.#seen.has(text));
  }

  /** @param {Case} made @param {Record<string, number>} beforeMl */
  show(made, beforeMl) {
    const isSame = this.#case?.sha256 === made.sha256;
    if (!isSame) {
      this.#seen.clear();
      this.#shown.clear();
      this.#at.clear();
      this.contacts.forget();
    }
    const hadDrawn = isSame && JSON.stringify(this.#beforeMl) === JSON.stringify(beforeMl);
    this.#case = made;
    this.#beforeMl = beforeMl;
    if (!hadDrawn) this.#draw();
  }

  #draw() {
    const made = this.#case;
    if (made === null) return;
    showNotice(find("build-notice"), made.notice);
    find("report-link").hidden = !made.has_report;
    find("build-figures").textContent = say("build_figures", {
      nodes: figure(made.node_count, 0), cell: figure(made.cell_mm, 2), ml: figure(made.tissue_volume_ml, 1),
    });
    this.#drawWarnings(made);
    this.#drawVolumes(made);
    this.#drawOpenings(made);
    this.#mark();
  }

  /** @param {Case} made */
  #drawWarnings({ warnings }) {
    // what has the focus keeps it
    const box = find("build-warnings");
    const at = [...box.querySelectorAll("button, input")].indexOf(/** @type {Element} */ (document.activeElement));
    const parts = [];
    /** @param {string} grade @param {readonly Warning[]} alike */
    const group = (grade, alike) => {
      if (alike.length === 0) return;
      const word = `build_grade_${grade}`;
      const list = element("ol", `warnings ${grade}`);
      list.append(...alike.map((one) => this.#warning(one)));
      parts.push(element("h4", grade, isWord(word) ? say(word) : grade), list);
    };
    // whether a hole was walled over is asked first, until it is answered
    const asked = warnings.filter(({ code }) => code === GROWN && (this.#case?.grown ?? []).some(({ state }) => state === "grown"));
    group("look", asked);
    for (const grade of GRADES) group(grade, warnings.filter((one) => one.grade === grade && !asked.includes(one)));
    if (parts.length === 0) parts.push(element("p", "soft", say("build_no_warnings")));
    box.replaceChildren(...parts);
    if (at >= 0) /** @type {HTMLElement | undefined} */ (box.querySelectorAll("button, input")[at])?.focus({ preventScroll: true });
  }

  /** @param {Warning} warning */
  #warning(warning) {
    const { text, grade, places_mm: places, code } = warning;
    const grown = code === GROWN ? (this.#case?.grown ?? []) : [];
    if (grown.length > 0) return this.#grown(warning, grown);
    const row = element("li");
    row.append(element("span", "says", warningWords(warning)));
    const line = element("div", "where");
    const seen = element("input");
    seen.type = "checkbox";
    seen.checked = this.#seen.has(text);
    if (places.length > 0) {
      const button = element("button", "fly", placeWords(this.#at.get(text) ?? -1, places.length));
      button.type = "button";
      button.addEventListener("click", () => {
        const at = ((this.#at.get(text) ?? -1) + 1) % places.length;
        this.#at.set(text, at);
        this.views.lookAt(places[at]);
        button.textContent = placeWords(at, places.length);
        const shown = this.#shown.get(text) ?? new Set();
        this.#shown.set(text, shown.add(at));
        // looked at is what was shown at all of its places
        if (shown.size < places.length) return;
        seen.checked = true;
        this.#see(text, true);
      });
      line.append(button);
    } else line.append(element("span", "soft", say("build_no_place")));
    if (grade !== "note") line.append(this.#seenBox(seen, text));
    row.append(line);
    const walls = code === "open-to-outside" ? this.contacts.wallActs(warning.parts.label, places.length > 0 ? () => places[this.#at.get(text) ?? 0] : undefined) : [];
    if (walls.length > 0) {
      const acts = element("div", "where");
      acts.append(...walls);
      row.append(acts);
    }
    const opening = code.startsWith("opening-") ? this.#openingAt(places[0]) : undefined;
    if (opening && ODD.includes(opening.verdict)) {
      const acts = element("div", "where");
      acts.append(...this.contacts.openingActs(opening));
      row.append(acts);
    }
    return row;
  }

  /** Walls that nobody saw: a line for each place. @param {Warning} warning @param {readonly import("./build_tab.js").Grown[]} places */
  #grown({ text }, places) {
    const row = element("li");
    row.append(element("span", "says", say("contact_head")));
    const seen = element("input");
    seen.type = "checkbox";
    seen.checked = this.#seen.has(text);
    const list = element("ul", "contacts");
    list.append(...places.map((place, n) => this.contacts.grownRow(place, () => {
      this.views.lookAt(place.center_mm);
      const shown = this.#shown.get(text) ?? new Set();
      this.#shown.set(text, shown.add(n));
      if (shown.size < places.length) return;
      seen.checked = true;
      this.#see(text, true);
    })));
    const line = element("div", "where");
    line.append(this.#seenBox(seen, text));
    row.append(list, line);
    return row;
  }

  /** @param {HTMLInputElement} seen @param {string} text */
  #seenBox(seen, text) {
    const label = element("label");
    seen.addEventListener("change", () => this.#see(text, seen.checked));
    label.append(seen, element("span", "", say("build_seen")));
    return label;
  }

  /** @param {import("../shared/geometry.js").Vector | undefined} mm */
  #openingAt(mm) {
    return mm && this.#case?.openings.find(({ center_mm }) => distance(center_mm, mm) < 0.2);
  }

  /** @param {string} text @param {boolean} isSeen */
  #see(text, isSeen) {
    if (isSeen) this.#seen.add(text);
    else this.#seen.delete(text);
    this.onSeen();
  }

  /** @param {Case} made */
  #drawVolumes({ volumes_ml: volumes }) {
    const rows = Object.entries(volumes).map(([name, ml]) => {
      const row = element("tr");
      const before = this.#beforeMl[name];
      const sign = before === undefined || Math.abs(ml - before) < 0.05 ? "" : ml > before ? "+" : "−";
      const change = before === undefined ? "" : `${sign}${figure(sign ? Math.abs(ml - before) : 0, 1)}`;
      const head = element("th", "", short(name));
      head.scope = "row";
      row.append(head, element("td", "n", figure(ml, 1)), element("td", "n", change));
      return row;
    });
    find("volume-rows").replaceChildren(...rows);
  }

  /** @param {Case} made */
  #drawOpenings({ openings, grown }) {
    const walled = grown.filter(({ state }) => state === "grown").map((one) => ({ ...one, verdict: "walled" }));
    find("openings").hidden = openings.length + walled.length === 0;
    find("opening-rows").replaceChildren(...[...walled, ...openings].map((one) => {
      const row = element("tr", ODD.includes(one.verdict) ? "odd" : "");
      const button = element("button", "fly", one.between.map(short).join(" – "));
      button.type = "button";
      button.addEventListener("click", () => this.views.lookAt(one.center_mm));
      const word = `build_verdict_${one.verdict.replaceAll(" ", "_")}`;
      const head = element("th");
      head.scope = "row";
      head.append(button, element("div", "verdict", isWord(word) ? say(word) : one.verdict));
      row.append(head, element("td", "n", figure(one.area_mm2, 0)));
      return row;
    }));
  }

  #mark() {
    const isOn = /** @type {HTMLInputElement} */ (find("openings-marked")).checked;
    this.studio.marks.value = isOn
      ? (this.#case?.openings ?? []).map(({ center_mm: mm, area_mm2: area, verdict }) => (
        { mm, text: `${figure(area, 0)} mm²`, isOdd: ODD.includes(verdict) }))
      : [];
    this.views.redrawOverlays();
  }
}

/** What every label of a chamber begins with says little in a table. @param {string} name */
export function short(name) {
  return structureName(name).replace(/^morphologically /, "");
}

/** @param {number} at the place that was looked at last, or -1 @param {number} count */
function placeWords(at, count) {
  return at < 0 ? say("build_fly", { count }) : say("place_of", { at: at + 1, count });
}
