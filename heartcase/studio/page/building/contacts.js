/** Places where the outlines of two cavities touch: what was found there, with a picture, and what it is, by a button. */

import { element } from "../shared/elements.js";
import { distance } from "../shared/geometry.js";
import { figure, say, structureName } from "../shared/words.js";

/** @typedef {import("../shared/geometry.js").Vector} Vector */
/** @typedef {import("../shaping/shaping.js").Entry} Entry */
/** @typedef {import("../shaping/shaping.js").Shaping} Shaping */
/** @typedef {import("./build_tab.js").Grown} Grown */
/** @typedef {import("./build_tab.js").Opening} Opening */
/** @typedef {{between: string[], area_mm2: number, center_mm: Vector, reach_mm: number}} Place */

/** So much farther than the place itself a statement reaches: the rim of a voxel. */
const BEYOND_MM = 1;
/** Thickness of a wall that is grown where the page was told that one belongs there; it can be changed in Shape. */
export const WALL_MM = 1.5;

export class Contacts {
  /** Pictures that were drawn, by their place. @type {Map<string, Promise<string>>} */
  #pictures = new Map();
  /** Told when what the recipe says of places changed. @type {() => void} */
  onSaid = () => undefined;
  /** What the recipe says of places; empty before it is known. */
  #saidNow = "";
  /** What it said when the case was known to be built from it; null where it is not. @type {string | null} */
  #saidBuilt = null;

  /**
   * @param {Shaping} shaping
   * @param {import("../shaping/shaping.js").Ask} ask
   * @param {(between: readonly string[]) => ((mm: Vector) => void) | null} painting what leads to painting the wall between two structures at a place; null where nothing does
   */
  constructor(shaping, ask, painting = () => null) {
    this.shaping = shaping;
    this.ask = ask;
    this.painting = painting;
    shaping.shape.listen((shape) => {
      const said = JSON.stringify([shape?.lines["walls.contact"], shape?.lines["walls.septum"], shape?.walls]);
      const before = this.#saidNow;
      this.#saidNow = said;
      if (before === "" && this.#saidBuilt !== null) this.#saidBuilt = said;
      if (said !== before) this.onSaid();
    });
  }

  /** Whether the case was built from the recipe as it stands. That is told later than what the recipe says. @param {boolean} isCurrent */
  setCurrent(isCurrent) {
    if (isCurrent === (this.#saidBuilt !== null)) return;
    this.#saidBuilt = isCurrent ? this.#saidNow : null;
    this.onSaid();
  }

  /** Of another case pictures are drawn anew. */
  forget() {
    this.#pictures.clear();
  }

  /**
   * A line about a place where a wall was grown.
   * @param {Grown} place
   * @param {() => void} onFly
   */
  grownRow(place, onFly) {
    const row = element("li", "contact");
    const words = say("contact_grown", {
      mm2: figure(place.area_mm2, place.area_mm2 < 10 ? 1 : 0), mm: figure(diameterOf(place.area_mm2), 1), wall: figure(place.thickness_mm, 1),
    });
    const body = element("div", "contact-body");
    body.append(element("strong", "", pairWords(place.between)), element("span", "", words));
    const at = { ...place, reach_mm: place.radius_mm };
    const buttons = element("div", "row");
    buttons.append(this.#fly(onFly), ...this.#acts(at, place.state === "grown" ? "grown" : place.state === "opened" ? "opened" : "confirmed"));
    body.append(buttons);
    row.append(this.#picture(place.center_mm), body);
    return row;
  }

  /**
   * What may be said of an opening that no normal heart has.
   * @param {Opening} opening
   * @returns {HTMLElement[]}
   */
  openingActs({ between, area_mm2, center_mm, reach_mm, verdict }) {
    const place = { between, area_mm2, center_mm, reach_mm: reach_mm ?? diameterOf(area_mm2) };
    return [this.#picture(center_mm), ...this.#acts(place, verdict === "unexpected" ? "unexpected" : "odd")];
  }

  /**
   * What can be done about blood that is open to the outside: a wall where no muscle is, or what was asked for already.
   * @param {string | undefined} label
   * @param {() => Vector} [place] which one is looked at, where it has one
   * @returns {HTMLElement[]}
   */
  wallActs(label, place) {
    const wall = this.shaping.shape.value?.walls.find((one) => one.label === label);
    if (wall === undefined || wall.has_table) return [];
    if (wall.wall_thickness_mm > 0) {
      const words = say("contact_walled", { mm: figure(wall.wall_thickness_mm, 1) });
      return [element("span", "said", `${words} ${say("contact_build")}`)];
    }
    const grow = button("contact_outer_wall", () => void this.shaping.set(["labels", wall.label, "wall_thickness_mm"], WALL_MM));
    return [grow, ...(place ? this.#paint("contact_paint_outer", [wall.label], place) : [])];
  }

  /** @param {() => void} onFly */
  #fly(onFly) {
    return button("contact_fly", onFly);
  }

  /**
   * Buttons, or what was said already.
   * @param {Place} place
   * @param {"grown" | "opened" | "confirmed" | "unexpected" | "odd"} state as it was built
   * @returns {HTMLElement[]}
   */
  #acts(place, state) {
    const said = this.#said(place);
    const isBuilt = said?.entry.is_open ? state === "opened" : state === "confirmed";
    // it was built, and came out otherwise: the place reaches farther than what is stated
    const isUnfit = said !== null && !isBuilt && state !== "opened" && this.#saidBuilt === this.#saidNow;
    if (said && !isUnfit) {
      const words = say(said.entry.is_open ? "contact_said_open" : "contact_said_wall");
      return [
        element("span", "said", isBuilt ? words : `${words} ${say(said.entry.is_open ? "contact_build" : "contact_noted")}`),
        button("contact_back", () => void this.shaping.remove({ list: "walls.contact", number: said.number }, said.entry)),
      ];
    }
    if (state === "opened") return [element("span", "said", say("contact_stated"))];
    if (state === "unexpected" && this.#isApart(place)) return [element("span", "said", `${say("contact_apart")} ${say("contact_build")}`)];
    const real = button("contact_real", () => void this.#say(place, true));
    const before = isUnfit ? [element("span", "said", say("contact_unfit"))] : [];
    const paint = this.#paint("contact_paint", place.between, () => place.center_mm);
    if (state === "odd") return [...before, real, ...paint];
    const wall = state === "unexpected"
      ? button("contact_grow", () => void this.shaping.add("walls.septum", [{ between: place.between, thickness_mm: WALL_MM }]))
      : button("contact_is_wall", () => void this.#say(place, false));
    return [...before, real, wall, ...(state === "unexpected" ? paint : [])];
  }

  /** A button that leads to painting the wall. @param {"contact_paint" | "contact_paint_outer"} word @param {readonly string[]} between @param {() => Vector} place */
  #paint(word, between, place) {
    const act = this.painting(between);
    return act === null ? [] : [button(word, () => act(place()))];
  }

  /** @param {Place} place @param {boolean} isOpen */
  async #say({ between, center_mm, reach_mm }, isOpen) {
    const radius = Math.ceil(10 * (reach_mm + BEYOND_MM)) / 10;
    await this.shaping.add("walls.contact", [{ between, position_mm: center_mm, radius_mm: radius, is_open: isOpen }]);
  }

  /** What the recipe says of a place now: of several statements the one that was made nearest to it. @param {Place} place @returns {{number: number, entry: Entry} | null} */
  #said({ between, center_mm }) {
    const lines = this.shaping.shape.value?.lines["walls.contact"] ?? [];
    let at = -1;
    let least = Infinity;
    lines.forEach((one, n) => {
      const far = distance(one.position_mm, center_mm);
      if (!isPair(one.between, between) || far > Math.min(one.radius_mm, least)) return;
      [at, least] = [n, far];
    });
    return at < 0 ? null : { number: at + 1, entry: lines[at] };
  }

  /** @param {Place} place */
  #isApart({ between }) {
    return (this.shaping.shape.value?.lines["walls.septum"] ?? []).some((one) => isPair(one.between, between));
  }

  /** @param {Vector} mm */
  #picture(mm) {
    const key = mm.join(" ");
    const picture = element("img", "place-picture");
    picture.width = 168;
    picture.height = 84;
    picture.alt = picture.title = say("contact_picture");
    let url = this.#pictures.get(key);
    if (url === undefined) {
      url = this.ask({ do: "picture", position_mm: mm }).then((answer) => String(answer.url));
      this.#pictures.set(key, url);
    }
    url.then((found) => (picture.src = found)).catch(() => {
      this.#pictures.delete(key);
      picture.hidden = true;
    });
    return picture;
  }
}

/** @param {import("../shared/words.js").Word} word @param {() => void} act */
function button(word, act) {
  const found = element("button", "fly", say(word));
  found.type = "button";
  found.addEventListener("click", ({ detail }) => {
    if (detail < 2) act();
  });
  return found;
}

/** Diameter of a circle of this area. @param {number} area */
const diameterOf = (area) => 2 * Math.sqrt(area / Math.PI);

/** What every label of a chamber begins with says little beside its side. @param {readonly string[]} names */
export function pairWords(names) {
  return names.map((name) => structureName(name).replace(/^morphologically /, "")).join(" – ");
}

/** @param {readonly string[]} one @param {readonly string[]} other */
function isPair(one, other) {
  const [a, b] = [one, other].map((names) => names.map((name) => name.toLowerCase()).sort().join("\n"));
  return a === b;
}
