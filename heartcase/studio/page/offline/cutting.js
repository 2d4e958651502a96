/** The plane that opens the heart: along the body's axes, along the heart's own, or facing whoever looks. */

import { cross, dot, unit } from "../operating/camera.js";
import { element } from "../panel/structures.js";
import { say } from "../shared/words.js";

/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {import("../shared/words.js").Word} Word */
/** @typedef {{key: string, point: Vector, normal: Vector, up: Vector | null}} Cut */

/** What is taken away lies on the side of the normal. @type {readonly {key: string, normal: Vector, up: Vector}[]} */
const BODY = [
  { key: "front", normal: [0, -1, 0], up: [0, 0, 1] },
  { key: "back", normal: [0, 1, 0], up: [0, 0, 1] },
  { key: "left", normal: [1, 0, 0], up: [0, 0, 1] },
  { key: "right", normal: [-1, 0, 0], up: [0, 0, 1] },
  { key: "head", normal: [0, 0, 1], up: [0, -1, 0] },
  { key: "feet", normal: [0, 0, -1], up: [0, -1, 0] },
];

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/**
 * How far from the origin a plane lies: at 0 nothing is taken away, at 50 it goes through its point, at 100 all is.
 * @param {Vector} normal @param {Vector} point @param {readonly [Vector, Vector]} box @param {number} depth percent
 */
export function planeAt(normal, point, box, depth) {
  let [low, high] = [Infinity, -Infinity];
  for (const x of [0, 1]) {
    for (const y of [0, 1]) {
      for (const z of [0, 1]) {
        const along = dot(normal, [box[x][0], box[y][1], box[z][2]]);
        low = Math.min(low, along);
        high = Math.max(high, along);
      }
    }
  }
  const middle = Math.min(Math.max(dot(normal, point), low), high);
  const part = depth / 50;
  return part <= 1 ? high + part * (middle - high) : middle + (part - 1) * (low - middle);
}

/** Axes of a view against a direction, with something near `up` on top. @param {Vector} towards @param {Vector} up @returns {[Vector, Vector, Vector]} */
export function axesFacing(towards, up) {
  const eye = unit(towards);
  const right = unit(cross(up, eye));
  return [right, cross(eye, right), eye];
}

export class Cutting {
  #select = /** @type {HTMLSelectElement} */ (find("cut-axis"));
  #depth = /** @type {HTMLInputElement} */ (find("cut-depth"));
  /** @type {Cut | null} */
  #chosen = null;

  /**
   * @param {readonly [Vector, Vector]} box corners of the heart, LPS mm
   * @param {readonly Cut[]} own cuts that follow the heart
   * @param {{facing: () => Vector, cut: (normal: Vector, at: number) => void, none: () => void, look: (axes: [Vector, Vector, Vector]) => void}} does
   */
  constructor(box, own, does) {
    this.box = box;
    this.does = does;
    const middle = /** @type {Vector} */ ([0, 1, 2].map((axis) => (box[0][axis] + box[1][axis]) / 2));
    /** @type {(Cut | null)[]} */
    this.cuts = [null, ...own, ...BODY.map((one) => ({ ...one, point: middle })), { key: "view", point: middle, normal: [0, -1, 0], up: null }];
    this.#select.addEventListener("change", () => this.#choose());
    this.#depth.addEventListener("input", () => this.#set());
  }

  /** Fill in its words. */
  build() {
    const before = this.#select.value;
    this.#select.replaceChildren(
      ...this.cuts.map((cut) => {
        const option = element("option", "", say(/** @type {Word} */ (`offline_plane_${cut?.key ?? "none"}`)));
        option.value = cut?.key ?? "";
        return option;
      }),
    );
    this.#select.value = before;
    this.#set();
  }

  #choose() {
    const found = this.cuts.find((cut) => (cut?.key ?? "") === this.#select.value) ?? null;
    this.#chosen = found?.key === "view" ? { ...found, normal: this.does.facing() } : found;
    this.#depth.value = "50";
    this.#set();
    if (this.#chosen?.up) this.does.look(axesFacing(this.#chosen.normal, this.#chosen.up));
  }

  #set() {
    find("cut-row").hidden = this.#chosen === null;
    if (this.#chosen === null) this.does.none();
    else this.does.cut(this.#chosen.normal, planeAt(this.#chosen.normal, this.#chosen.point, this.box, Number(this.#depth.value)));
  }
}
