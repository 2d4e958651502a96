/** A plane that cuts the heart open: where it lies, and how it is moved and turned. LPS mm; no browser. */

import { add, cross, dot, turned, unit } from "../operating/camera.js";

/** @typedef {import("../operating/camera.js").Vector} Vector */

/** Sides of the body from which the heart is opened, and where that side lies. @type {Readonly<Record<string, Vector>>} */
export const SIDES = { front: [0, -1, 0], back: [0, 1, 0], left: [1, 0, 0], right: [-1, 0, 0], head: [0, 0, 1], feet: [0, 0, -1] };

export class CutPlane {
  isOn = false;
  /** To what is taken away, of unit length. @type {Vector} */
  normal = [0, -1, 0];
  /** Where it is led and turned by. @type {Vector} */
  point = [0, 0, 0];
  /** Box of what is cut. @type {[Vector, Vector]} */
  #box = [[-1, -1, -1], [1, 1, 1]];
  /** @type {Set<() => void>} */
  #listeners = new Set();

  /** Call `listener` whenever the plane is another one. @param {() => void} listener */
  listen(listener) {
    this.#listeners.add(listener);
  }

  #tell() {
    for (const listener of this.#listeners) listener();
  }

  /** Corners of the box around what is cut: the plane does not leave it. @param {Vector} low @param {Vector} high */
  setBox(low, high) {
    this.#box = [low, high];
    if (!this.isOn) this.point = this.middle;
    else this.#keep();
    this.#tell();
  }

  /** @returns {Vector} */
  get middle() {
    const [low, high] = this.#box;
    return [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2];
  }

  /** Half the diagonal of the box, mm: a square of twice that size around the point holds all that is cut. */
  get reach() {
    const [low, high] = this.#box;
    return Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]) / 2;
  }

  /** Smallest and largest place along the normal, from the box's middle, mm. @returns {[number, number]} */
  get range() {
    const [low, high] = this.#box;
    const half = [0, 1, 2].reduce((sum, axis) => sum + (Math.abs(this.normal[axis]) * (high[axis] - low[axis])) / 2, 0);
    return [-half, half];
  }

  /** Place along the normal, from the box's middle, mm. */
  get depth() {
    return dot(this.normal, add(this.point, this.middle, -1));
  }

  /** For a shader's `cutPlane`: what has dot(normal, place) above the fourth is not drawn. @returns {[number, number, number, number]} */
  get equation() {
    return this.isOn ? [...this.normal, dot(this.normal, this.point)] : [0, 0, 0, 1];
  }

  /** Two unit vectors in the plane, the second upwards as far as that goes. @returns {[Vector, Vector]} */
  get axes() {
    /** @type {Vector} */
    const up = Math.abs(this.normal[2]) > 0.9 ? [0, -1, 0] : [0, 0, 1];
    const right = unit(cross(up, this.normal));
    return [right, cross(this.normal, right)];
  }

  /** @param {boolean} isOn */
  show(isOn) {
    if (isOn === this.isOn) return;
    this.isOn = isOn;
    this.#tell();
  }

  /** Put it somewhere. @param {Vector} normal of any length, to what is taken away @param {Vector} [point] the box's middle where left out */
  put(normal, point = this.middle) {
    this.normal = unit(normal);
    this.point = point;
    this.#keep();
    this.#tell();
  }

  /** Lead it along its normal. @param {number} mm into the heart where negative */
  move(mm) {
    this.point = add(this.point, this.normal, mm);
    this.#keep();
    this.#tell();
  }

  /** @param {Vector} axis of unit length, through its point @param {number} angle */
  turn(axis, angle) {
    this.normal = unit(turned(this.normal, axis, angle));
    this.#tell();
  }

  /** Take the other side away. */
  flip() {
    this.normal = [-this.normal[0], -this.normal[1], -this.normal[2]];
    this.#tell();
  }

  /** Back into the box, along the normal. */
  #keep() {
    const [least, most] = this.range;
    const depth = this.depth;
    const wanted = Math.min(Math.max(depth, least), most);
    if (wanted !== depth) this.point = add(this.point, this.normal, wanted - depth);
  }
}
