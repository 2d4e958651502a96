/** Buttons and lists for the cut plane of the page that operates; the server is told, so that what is cut away cannot be pointed at. */

import { element } from "../shared/elements.js";
import { PlaneHandles } from "../section/handles.js";
import { SIDES } from "../section/plane.js";
import { isWord, language, say } from "../shared/words.js";
import { dot } from "./camera.js";
import { lookFrom } from "./second_view.js";

/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {import("./picture.js").Picture} Picture */
/** Its place is the middle of the long axis where it has none of its own. @typedef {{right: Vector, down: Vector, towards: Vector, point_mm?: Vector}} HeartPlane */

const STEP_MM = 1;

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

export class PlaneControls {
  #axis = /** @type {HTMLSelectElement} */ (find("cut-axis"));
  #depth = /** @type {HTMLInputElement} */ (find("cut-depth"));
  /** The heart's own planes. @type {Record<string, HeartPlane>} */
  #planes = {};
  /** Middle of the heart's long axis. @type {Vector | null} */
  #centre = null;
  #wasPut = false;
  #isPutting = false;
  #isTelling = false;

  /**
   * @param {Picture} picture
   * @param {(plane: {normal: Vector, point_mm: Vector} | null) => void} tell the server
   */
  constructor(picture, tell) {
    this.picture = picture;
    this.tell = tell;
    const { plane } = picture;
    this.handles = new PlaneHandles(find("scene"), picture.camera, plane);
    picture.drawn.push(() => this.handles.place());
    find("cut-open").addEventListener("click", () => this.toggle());
    find("cut-flip").addEventListener("click", () => plane.flip());
    find("cut-face").addEventListener("click", () => this.#face());
    this.#axis.addEventListener("change", () => {
      this.#put(this.#axis.value);
      // of what is chosen by its name one wants to see the cut
      if (this.#axis.value !== "" && this.#axis.value !== "look") this.#face();
    });
    this.#depth.addEventListener("input", () => plane.move(Number(this.#depth.value) - plane.depth));
    find("scene").addEventListener("wheel", (event) => this.#wheel(event), { capture: true, passive: false });
    plane.listen(() => this.#changed());
    language.follow(() => this.#fill());
  }

  /** @param {{planes: Record<string, HeartPlane>, centre_mm: Vector | null}} axes @param {[Vector, Vector]} box */
  setCase(axes, box) {
    this.#planes = axes.planes;
    this.#centre = axes.centre_mm;
    this.#fill();
    this.picture.plane.setBox(...box);
    this.#report();
  }

  /** Open the heart, or close it. */
  toggle() {
    const { plane } = this.picture;
    if (!plane.isOn && !this.#wasPut) this.#put("look");
    else plane.show(!plane.isOn);
  }

  /** @param {number} steps into the heart where negative */
  step(steps) {
    if (this.picture.plane.isOn) this.picture.plane.move(STEP_MM * steps);
  }

  #fill() {
    const chosen = this.#axis.value;
    const named = Object.keys(this.#planes).filter((name) => isWord(`scene_plane_${name}`));
    /** @type {[string, string][]} */
    const rows = [["", say("scene_plane_free")], ["look", say("scene_plane_look")]];
    for (const name of named) rows.push([name, say(/** @type {import("../shared/words.js").Word} */ (`scene_plane_${name}`))]);
    for (const side of Object.keys(SIDES)) rows.push([side, say(/** @type {import("../shared/words.js").Word} */ (`offline_plane_${side}`))]);
    this.#axis.replaceChildren(
      ...rows.map(([value, text]) => {
        const option = /** @type {HTMLOptionElement} */ (element("option", "", text));
        option.value = value;
        return option;
      }),
    );
    this.#axis.value = rows.some(([value]) => value === chosen) ? chosen : "";
  }

  /** @param {string} name of a direction in the list */
  #put(name) {
    const { plane, camera } = this.picture;
    this.#wasPut = true;
    this.#isPutting = true;
    const own = this.#planes[name];
    if (own) plane.put(own.towards, own.point_mm ?? this.#centre ?? plane.middle);
    else if (name === "look") plane.put(camera.towards);
    else if (name in SIDES) plane.put(SIDES[name]);
    this.#axis.value = name;
    this.#isPutting = false;
    if (name !== "") plane.show(true);
  }

  /** Look straight at the plane, from the side that was taken away. */
  #face() {
    const { plane, camera } = this.picture;
    const name = this.#axis.value;
    camera.target = plane.point;
    if (name === "" || name === "look") camera.stand(...plane.axes);
    else lookFrom(camera, name, this.#planes);
    this.picture.redraw();
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    const { plane } = this.picture;
    if (!event.shiftKey || !plane.isOn) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    plane.move(-Math.sign(event.deltaY || event.deltaX) * STEP_MM);
  }

  #changed() {
    const { plane } = this.picture;
    const [least, most] = plane.range;
    Object.assign(this.#depth, { min: least.toFixed(1), max: most.toFixed(1), disabled: !plane.isOn });
    this.#depth.value = plane.depth.toFixed(1);
    for (const id of ["cut-flip", "cut-face"]) /** @type {HTMLButtonElement} */ (find(id)).disabled = !plane.isOn;
    find("cut-open").setAttribute("aria-pressed", String(plane.isOn));
    const named = this.#planes[this.#axis.value]?.towards ?? SIDES[this.#axis.value];
    const isThat = named !== undefined && dot(named, plane.normal) > 0.9999;
    if (!this.#isPutting && !isThat && this.#axis.value !== "look") this.#axis.value = "";
    this.#report();
  }

  /** Tell the server, once for many changes in a picture. */
  #report() {
    if (this.#isTelling) return;
    this.#isTelling = true;
    queueMicrotask(() => {
      this.#isTelling = false;
      const { plane } = this.picture;
      this.tell(plane.isOn ? { normal: plane.normal, point_mm: plane.point } : null);
    });
  }
}
