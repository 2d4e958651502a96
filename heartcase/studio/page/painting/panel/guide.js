/** What to do next: the place where one more stroke is worth most, and the list of what is still missing. */

import { figure, isWord, language, say, structureName } from "../../shared/words.js";
import { paintHere } from "./paint_here.js";
import { element } from "../../shared/elements.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../pictures/views.js").Views} Views */
/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {{position_mm: Vector, label: string, rival: string, change_ml: number, radius_mm: number}} Place */
/** @typedef {{key: string, done: boolean, missing: string[]}} Item */

/** As many as are looked at for how sure structures are. */
const COUNT = 12;

/** Where it is in the sample heart. @param {string} key @param {string} words */
function pictureOf(key, words) {
  const picture = element("img", "where");
  picture.src = `/static/painting/guide/${key}.png`;
  picture.alt = picture.title = words;
  picture.width = 68;
  picture.height = 68;
  return picture;
}

export class Guide {
  /** Where to look, best first; null when they must be asked for anew. @type {Place[] | null} */
  #places = null;
  #at = -1;
  /** Those that were shown. @type {Set<Place>} */
  #shown = new Set();
  /** Whether the one that is shown had been shown before, and all others, too. */
  #isSecondRound = false;
  /** Places that were said to be right since the page was opened. */
  #rightCount = 0;
  /** How far each structure is, as it was worked out last. @type {Record<string, string>} */
  #states = {};
  /** @type {readonly Item[]} */
  #items = [];
  /** @type {readonly string[]} */
  #marked = [];

  /**
   * @param {Studio} studio
   * @param {Views} views
   * @param {(request: Record<string, unknown> & {do: string}) => Promise<Record<string, any>>} ask
   * @param {{place: HTMLElement, right: HTMLElement, wrong: HTMLElement, checklist: HTMLElement, heading: HTMLElement}} parts
   * @param {(error: unknown) => void} onFault
   */
  constructor(studio, views, ask, parts, onFault) {
    this.studio = studio;
    this.views = views;
    this.ask = ask;
    this.parts = parts;
    this.onFault = onFault;
    parts.right.addEventListener("click", () => void this.confirm());
    parts.wrong.addEventListener("click", () => this.paint());
    language.listen(() => {
      this.#showItems();
      this.#showPlace();
    });
  }

  /** Labels changed: other places may be worth more now. */
  forget() {
    this.#places = null;
    this.#at = -1;
    this.#showPlace();
  }

  async next() {
    if (!this.studio.ready.value) return;
    if (this.#places === null) {
      this.parts.place.textContent = say("looking");
      try {
        this.#places = (await this.ask({ do: "suggest", count: COUNT })).places ?? [];
      } catch (error) {
        this.parts.place.textContent = "";
        this.onFault(error);
        return;
      }
      this.#at = -1;
      this.#shown.clear();
    }
    const places = this.#places ?? [];
    this.#isSecondRound = places.every((one) => this.#shown.has(one));
    if (places.length > 0) {
      this.#at = (this.#at + 1) % places.length;
      this.#shown.add(places[this.#at]);
      this.views.lookAt(places[this.#at].position_mm);
    }
    this.#showPlace();
  }

  /** The place that is shown is right as it is: it does not come again, and the next one is shown. */
  async confirm() {
    const shown = this.#places?.[this.#at];
    if (!shown || !this.studio.ready.value) return;
    const { position_mm, label, rival } = shown;
    const { right } = this.parts;
    const hadFocus = document.activeElement === right;
    try {
      await this.ask({ do: "confirm", position_mm, label, rival });
    } catch (error) {
      this.onFault(error);
      return;
    }
    this.#rightCount += 1;
    const left = (this.#places ?? []).filter((one) => one !== shown);
    // one after the other, and then those that are worth most by then
    this.#places = left.length > 0 ? left : null;
    this.#at = left.length > 0 ? (this.#at - 1 + left.length) % left.length : -1;
    await this.next();
    if (hadFocus) (right.hidden ? document.getElementById("next-place") : right)?.focus();
  }

  /** The place that is shown is the other structure: that one is picked, with a brush that fits. */
  paint() {
    const shown = this.#places?.[this.#at];
    const rival = this.#rivalOf(shown);
    if (!shown || !rival || !this.studio.ready.value) return;
    // below what the place is wide
    paintHere(this.studio, this.views, { value: rival.value, mm: shown.position_mm, mostMm: shown.radius_mm - 0.1 });
  }

  /** @param {Place | undefined} place */
  #rivalOf(place) {
    return this.studio.labels.value.find(({ name }) => name === place?.rival);
  }

  /** How far each structure is. @param {Record<string, string>} states */
  tellStates(states) {
    this.#states = states;
    this.#showPlace();
  }

  /** Whether no structure has places that are worth a look, together: what is left can be left. */
  get #isEnough() {
    const states = this.#marked.map((name) => this.#states[name]);
    return states.length > 0 && states.every((state) => state === "confident");
  }

  /** Whether all that a heart has is marked; vessel ends are no strokes. */
  get #isComplete() {
    return this.#items.every(({ key, done }) => done || key === "ends");
  }

  /** @param {readonly Item[]} items @param {readonly string[]} marked names of structures that are marked */
  tell(items, marked) {
    this.#items = items;
    this.#marked = marked;
    // they are worked out anew
    this.#states = {};
    this.#showItems();
  }

  #showPlace() {
    const { place, right, wrong } = this.parts;
    const rival = this.#rivalOf(this.#places?.[this.#at]);
    right.hidden = !this.#places?.[this.#at];
    wrong.hidden = rival === undefined;
    wrong.textContent = rival ? say("place_wrong", { label: structureName(rival.name) }) : "";
    if (this.#places === null) {
      place.textContent = "";
      return;
    }
    const shown = this.#places[this.#at];
    if (!shown) {
      place.textContent = say("no_place");
      return;
    }
    const at = say("place_of", { at: this.#at + 1, count: this.#places.length });
    const enough = this.#isEnough ? (this.#isComplete ? "places_enough" : "places_enough_marked") : this.#isSecondRound ? "places_seen" : null;
    place.replaceChildren(
      ...(enough ? [element("strong", "enough", say(enough))] : []),
      element("strong", "", this.#rightCount ? `${at} · ${say("places_right", { count: this.#rightCount })}` : at),
      element("span", "", say("place_says", {
        label: structureName(shown.label),
        other: structureName(shown.rival),
        ml: figure(shown.change_ml, shown.change_ml < 1 ? 2 : 1),
        mm: figure(shown.radius_mm, 1),
      })),
    );
  }

  #showItems() {
    const rows = this.#items.map(({ key, done, missing }) => {
      const word = `item_${key}`;
      // without background everything is a structure, which looks like a fault
      const isAll = key === "background" && !done && this.#marked.length > 0;
      const text = isAll ? say("item_background_first", { names: this.#marked.map(structureName).join(", ") }) : isWord(word) ? say(word) : key;
      const row = element("li", done ? "done" : "open");
      row.append(
        element("span", "tick", done ? "✓" : "○"),
        element("span", "hidden-words", done ? say("item_done") : say("item_open")),
        element("span", "words", missing.length > 0 && key !== "background" ? `${text}: ${missing.map(structureName).join(", ")}` : text),
      );
      const where = `where_${key}`;
      if (!done && isWord(where)) row.append(pictureOf(key, say(where)));
      return row;
    });
    if (this.#marked.length === 1) {
      const spreads = element("li", "note");
      const sign = element("span", "tick", "→");
      sign.setAttribute("aria-hidden", "true");
      spreads.append(sign, element("span", "words", say("item_spreads", { name: structureName(this.#marked[0]) })));
      rows.unshift(spreads);
    }
    if (rows.length > 0) {
      const defects = element("li", "note");
      const sign = element("span", "tick", "→");
      sign.setAttribute("aria-hidden", "true");
      defects.append(sign, element("span", "words", say("item_defects")));
      rows.push(defects);
    }
    const isDone = this.#items.length > 0 && this.#items.every(({ done }) => done);
    this.parts.heading.textContent = say(isDone ? "checklist_done" : "checklist");
    this.parts.checklist.replaceChildren(...rows);
  }
}
