/** The second view: the same heart from another place, beside the first. */

import { element } from "../shared/elements.js";
import { SIDES } from "../section/plane.js";
import { isWord, language, say } from "../shared/words.js";

/** @typedef {import("../shared/words.js").Word} Word */
/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {import("./picture.js").Picture} Picture */
/** @typedef {{right: Vector, down: Vector, towards: Vector}} HeartPlane */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class SecondView {
  #look = /** @type {HTMLSelectElement} */ (find("second-look"));
  #surface = find("scene-2");
  /** @type {Record<string, HeartPlane>} */
  #planes = {};
  /** @type {[Vector, Vector]} */
  #box = [[0, 0, 0], [1, 1, 1]];
  #wasPut = false;

  /** @param {Picture} picture */
  constructor(picture) {
    this.picture = picture;
    this.camera = picture.addView(this.#surface);
    find("two-views").addEventListener("click", () => this.toggle());
    this.#look.addEventListener("change", () => this.#put(this.#look.value));
    language.follow(() => this.#fill());
  }

  get isShown() {
    return !this.#surface.hidden;
  }

  toggle() {
    this.#surface.hidden = this.#look.hidden = this.isShown;
    find("two-views").setAttribute("aria-pressed", String(this.isShown));
    const { camera } = this.picture;
    const before = Math.min(1, camera.width / camera.height);
    this.picture.resize();
    // as much of the heart is seen aside as before
    camera.zoom(Math.min(1, camera.width / camera.height) / before);
    if (this.isShown && !this.#wasPut) this.#put("four_chamber" in this.#planes ? "four_chamber" : "left");
  }

  /** As it was chosen in the list. */
  reset() {
    this.#put(this.#look.value);
  }

  /** @param {Record<string, HeartPlane>} planes @param {[Vector, Vector]} box */
  setCase(planes, box) {
    this.#planes = planes;
    this.#box = box;
    this.#fill();
    if (this.#wasPut) return;
    this.camera.frame(...box);
  }

  #fill() {
    const chosen = this.#look.value;
    const named = Object.keys(this.#planes).filter((name) => isWord(`scene_plane_${name}`));
    /** @type {[string, Word][]} */
    const rows = [["surgeon", "scene_look_surgeon"]];
    for (const name of named) rows.push([name, /** @type {Word} */ (`scene_plane_${name}`)]);
    for (const side of Object.keys(SIDES)) rows.push([side, /** @type {Word} */ (`offline_plane_${side}`)]);
    this.#look.replaceChildren(
      ...rows.map(([value, word]) => {
        const option = /** @type {HTMLOptionElement} */ (element("option", "", say(word)));
        option.value = value;
        return option;
      }),
    );
    if (rows.some(([value]) => value === chosen)) this.#look.value = chosen;
  }

  /** Look from one of the places in the list, at the middle of the heart. @param {string} name */
  #put(name) {
    this.#wasPut = true;
    this.#look.value = name;
    this.camera.frame(...this.#box);
    lookFrom(this.camera, name, this.#planes);
    this.picture.redraw();
  }
}

/**
 * Turn a camera to a named direction.
 * @param {Camera} camera @param {string} name a side of the body, `surgeon`, or a plane of the heart @param {Record<string, HeartPlane>} planes
 */
export function lookFrom(camera, name, planes) {
  const own = planes[name];
  if (own) camera.stand(own.right, [-own.down[0], -own.down[1], -own.down[2]]);
  // from the patient's right side of the table: the head is to the left
  else if (name === "surgeon") camera.stand([0, 0, -1], [1, 0, 0]);
  // the face is up where one looks along the body
  else if (name === "head") camera.stand([-1, 0, 0], [0, -1, 0]);
  else if (name === "feet") camera.stand([1, 0, 0], [0, -1, 0]);
  else if (name in SIDES) camera.look(SIDES[name]);
}
