/** A tour's scene in the picture: the camera goes to where one shall look from. LPS mm. */

import { add, cross, dot, turned, unit, VIEW_ANGLE_DEG } from "../operating/camera.js";

/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {import("../operating/picture.js").Picture} Picture */
/** @typedef {{target_mm: Vector, towards: Vector, up: Vector, width_mm: number}} View */
/** @typedef {{view: View | null, hidden: number[], plane: {normal: Vector, point_mm: Vector} | null, stretch: boolean}} Scene */

const TURN_MS = 700;

/**
 * The turn that takes three perpendicular axes to three others.
 * @param {readonly Vector[]} from
 * @param {readonly Vector[]} to
 * @returns {{axis: Vector, angle: number}}
 */
export function turnBetween(from, to) {
  /** @param {number} row @param {number} column */
  const at = (row, column) => from.reduce((sum, axis, n) => sum + to[n][row] * axis[column], 0);
  const cosine = Math.min(Math.max((at(0, 0) + at(1, 1) + at(2, 2) - 1) / 2, -1), 1);
  const angle = Math.acos(cosine);
  /** @type {Vector} */
  const aside = [at(2, 1) - at(1, 2), at(0, 2) - at(2, 0), at(1, 0) - at(0, 1)];
  if (Math.hypot(...aside) > 1e-6) return { axis: unit(aside), angle };
  if (cosine > 0) return { axis: [0, 0, 1], angle: 0 };
  // half a turn: the axis is what stays
  const columns = [0, 1, 2].map((column) => /** @type {Vector} */ ([0, 1, 2].map((row) => at(row, column) + (row === column ? 1 : 0))));
  const longest = columns.reduce((best, one) => (dot(one, one) > dot(best, best) ? one : best));
  return { axis: unit(longest), angle: Math.PI };
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
    if (plane) this.picture.plane.put(plane.normal, plane.point_mm);
    this.picture.plane.show(plane !== null);
  }

  /** Go to a view, at once where the user wants no motion. @param {View} view */
  goTo(view) {
    const { camera } = this.picture;
    const towards = unit(view.towards);
    const right = unit(cross(view.up, towards));
    const up = cross(towards, right);
    const narrow = Math.max(1, camera.height / camera.width);
    const distance = (narrow * view.width_mm) / (2 * Math.tan((VIEW_ANGLE_DEG * Math.PI) / 360));
    const from = { target: camera.target, distance: camera.distance, axes: [camera.right, camera.up, camera.towards] };
    const turn = turnBetween(from.axes, [right, up, towards]);
    /** @param {number} part */
    const put = (part) => {
      const axes = part < 1 ? from.axes.map((one) => unit(turned(one, turn.axis, part * turn.angle))) : [right, up, towards];
      [camera.right, camera.up, camera.towards] = axes;
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
