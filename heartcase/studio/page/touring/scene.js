/** A tour's scene in the picture: the camera goes to where one shall look from. LPS mm. */

import * as three from "../vendor/three/three.module.min.js";
import { add, cross, unit, VIEW_ANGLE_DEG } from "../operating/camera.js";

/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {import("../operating/picture.js").Picture} Picture */
/** @typedef {{target_mm: Vector, towards: Vector, up: Vector, width_mm: number}} View */
/** @typedef {{view: View | null, hidden: number[], plane: [number, number, number, number] | null, stretch: boolean}} Scene */

const TURN_MS = 700;
/** A plane that removes nothing. */
const NO_PLANE = /** @type {const} */ ([0, 0, 0, 1]);

/** @param {Vector} right @param {Vector} up @param {Vector} towards */
function turnOf(right, up, towards) {
  const basis = new three.Matrix4().makeBasis(new three.Vector3(...right), new three.Vector3(...up), new three.Vector3(...towards));
  return new three.Quaternion().setFromRotationMatrix(basis);
}

/** Leads a picture's camera; a new way takes the place of one that is under way. */
export class SceneShower {
  #way = 0;

  /** @param {Picture} picture */
  constructor(picture) {
    this.picture = picture;
  }

  /** A user turns the heart: the camera is left to them. */
  stop() {
    this.#way += 1;
  }

  /** @param {Scene["plane"]} plane */
  setPlane(plane) {
    this.picture.heart.uniforms.cutPlane.value.set(...(plane ?? NO_PLANE));
    this.picture.redraw();
  }

  /** Go to a view, at once where the user wants no motion. @param {View} view */
  goTo(view) {
    const { camera } = this.picture;
    const towards = unit(view.towards);
    const right = unit(cross(view.up, towards));
    const up = cross(towards, right);
    const narrow = Math.max(1, camera.height / camera.width);
    const distance = (narrow * view.width_mm) / (2 * Math.tan((VIEW_ANGLE_DEG * Math.PI) / 360));
    const from = { target: camera.target, distance: camera.distance, turn: turnOf(camera.right, camera.up, camera.towards) };
    const goal = turnOf(right, up, towards);
    const turn = new three.Quaternion();
    /** @param {number} part */
    const put = (part) => {
      turn.slerpQuaternions(from.turn, goal, part);
      const axis = (/** @type {number} */ x, /** @type {number} */ y, /** @type {number} */ z) => {
        const found = new three.Vector3(x, y, z).applyQuaternion(turn);
        return unit([found.x, found.y, found.z]);
      };
      camera.right = axis(1, 0, 0);
      camera.up = axis(0, 1, 0);
      camera.towards = axis(0, 0, 1);
      camera.target = add(from.target, add(view.target_mm, from.target, -1), part);
      camera.distance = from.distance * (distance / from.distance) ** part;
      this.picture.redraw();
    };
    const way = (this.#way += 1);
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
      put(1);
      return;
    }
    const began = performance.now();
    const step = () => {
      if (way !== this.#way) return;
      const time = Math.min((performance.now() - began) / TURN_MS, 1);
      put(time * time * (3 - 2 * time));
      if (time < 1) requestAnimationFrame(step);
    };
    step();
  }
}
