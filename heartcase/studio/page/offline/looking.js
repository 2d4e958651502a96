/** Where one looks from by buttons, and what is said of it: sides of the patient, turning, zooming. */

import * as three from "../vendor/three/three.module.min.js";
import { cross } from "../operating/camera.js";
import { SIDES as DIRECTIONS } from "../section/plane.js";

/** @typedef {import("../operating/camera.js").Camera} Camera */
/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {[Vector, Vector, Vector]} Axes the picture's right, its top, the way to the eye */
/** @typedef {import("../operating/orientation.js").Side} Side */

/** What is up, seen from a side. @param {Vector} towards @returns {Vector} */
const upOf = ([, , along]) => (along === 0 ? [0, 0, 1] : [0, -1, 0]);
/** @type {Record<Side, Axes>} */
export const SIDES = /** @type {any} */ (
  Object.fromEntries(Object.entries(DIRECTIONS).map(([side, towards]) => [side, [cross(upOf(towards), towards), upOf(towards), towards]]))
);
const MOVE_MS = 320;
const TURNS = 12;
const ZOOM = 1.2;

/** @param {Axes} axes */
function turnOf([right, up, towards]) {
  const basis = new three.Matrix4().makeBasis(new three.Vector3(...right), new three.Vector3(...up), new three.Vector3(...towards));
  return new three.Quaternion().setFromRotationMatrix(basis);
}

export class Looking {
  #moving = 0;

  /** @param {Camera} camera @param {{changed: () => void, ended: () => void}} does */
  constructor(camera, does) {
    this.camera = camera;
    this.does = does;
  }

  /** Turn to a view, at once where movement is not wanted. @param {Axes} axes */
  moveTo(axes) {
    cancelAnimationFrame(this.#moving);
    const { camera } = this;
    const from = turnOf([camera.right, camera.up, camera.towards]);
    const to = turnOf(axes);
    const began = performance.now();
    const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const step = () => {
      const part = isStill ? 1 : Math.min(1, (performance.now() - began) / MOVE_MS);
      if (part < 1) this.#set(new three.Quaternion().slerpQuaternions(from, to, part * part * (3 - 2 * part)));
      else [camera.right, camera.up, camera.towards] = axes.map((axis) => /** @type {Vector} */ ([...axis]));
      this.does.changed();
      if (part < 1) this.#moving = requestAnimationFrame(step);
      else this.does.ended();
    };
    step();
  }

  /** @param {any} turn */
  #set(turn) {
    const axes = [new three.Vector3(1, 0, 0), new three.Vector3(0, 1, 0), new three.Vector3(0, 0, 1)];
    const [right, up, towards] = axes.map((axis) => /** @type {Vector} */ (axis.applyQuaternion(turn).toArray()));
    Object.assign(this.camera, { right, up, towards });
  }

  /** @param {number} across @param {number} down steps: what is seen goes with them */
  turn(across, down) {
    cancelAnimationFrame(this.#moving);
    const pixels = Math.min(this.camera.width, this.camera.height) / TURNS;
    this.camera.turn(across * pixels, down * pixels);
    this.does.changed();
    this.does.ended();
  }

  /** @param {number} steps nearer, above 0 */
  zoom(steps) {
    this.camera.zoom(ZOOM ** steps);
    this.does.changed();
  }
}
