/** How wide a vessel is where a disc crosses it: from the labels in the disc's plane. Pure maths, mm. */

import { plus } from "../shared/geometry.js";
import { cross, unit } from "./discs.js";

/** @typedef {import("../shared/geometry.js").Vector} Vector */
/** @typedef {import("./discs.js").Disc} Disc */

/** Samples across a radius at most: bounds the work for a disc that is far too wide. */
const MOST = 60;

/**
 * Diameter of a circle as large as the vessel's section within a disc: of the piece that is nearest to its centre.
 * @param {Disc} disc
 * @param {(mm: Vector) => boolean} isInside whether a place lies in the vessel
 * @param {number} stepMm between samples
 * @returns {{mm: number, isCut: boolean} | null} whether the rim of the disc cuts it; null where the vessel is not
 */
export function lumenOf({ centre, axis, radius }, isInside, stepMm) {
  const count = Math.min(Math.max(Math.ceil(radius / stepMm), 1), MOST);
  const step = radius / count;
  const normal = unit(axis);
  const u = unit(cross(normal, Math.abs(normal[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0]));
  const v = cross(normal, u);
  const side = 2 * count + 1;
  /** 0 not in the vessel, 1 in it, 2 in it and counted */
  const cells = new Uint8Array(side * side);
  let first = -1;
  let nearest = Infinity;
  for (let row = 0; row < side; row++) {
    for (let column = 0; column < side; column++) {
      const [x, y] = [(column - count) * step, (row - count) * step];
      const away = Math.hypot(x, y);
      if (away > radius || !isInside(plus(plus(centre, u, x), v, y))) continue;
      const at = row * side + column;
      cells[at] = 1;
      if (away < nearest) [first, nearest] = [at, away];
    }
  }
  if (first < 0) return null;
  let area = 0;
  let isCut = false;
  const waiting = [first];
  cells[first] = 2;
  for (let at = waiting.pop(); at !== undefined; at = waiting.pop()) {
    const [row, column] = [Math.floor(at / side), at % side];
    area += 1;
    isCut ||= Math.hypot(row - count, column - count) * step > radius - 1.5 * step;
    for (const [y, x] of [[row - 1, column], [row + 1, column], [row, column - 1], [row, column + 1]]) {
      const next = y * side + x;
      if (y < 0 || x < 0 || y >= side || x >= side || cells[next] !== 1) continue;
      cells[next] = 2;
      waiting.push(next);
    }
  }
  return { mm: 2 * step * Math.sqrt(area / Math.PI), isCut };
}
