/** Flat discs in space: where a slice cuts them, and how a drag within a slice turns and sizes them. Pure maths, mm. */

import { distance, dot, plus } from "../shared/geometry.js";

/** @typedef {import("../shared/geometry.js").Vector} Vector */
/** @typedef {import("../shared/geometry.js").Frame} Frame */
/** @typedef {{centre: Vector, axis: Vector, radius: number}} Disc its axis is of any length but zero */
/** What a slice shows of a disc: the whole where it lies in the slice, or a line.
 * @typedef {{kind: "circle"} | {kind: "line", ends: [Vector, Vector]}} Cut */

/** A disc that leans less than this against a slice, as a sine, lies in it: six degrees. */
const FLAT = 0.1;
const SMALLEST_MM = 0.2;

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** @param {Vector} a @returns {Vector} a vector of length one; [0, 0, 1] for one of length zero. */
export function unit(a) {
  const length = Math.hypot(...a);
  return length > 0 ? [a[0] / length, a[1] / length, a[2] / length] : [0, 0, 1];
}

/** The part of a vector within a slice. @param {Vector} a @param {Frame} frame @returns {Vector} */
export function within(a, { normal }) {
  return plus(a, normal, -dot(a, normal));
}

/** A vector turned about a unit vector (Rodrigues). @param {Vector} a @param {Vector} about @param {number} angle radians @returns {Vector} */
export function turned(a, about, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const across = cross(about, a);
  const along = dot(about, a) * (1 - c);
  return /** @type {Vector} */ (a.map((value, n) => value * c + across[n] * s + about[n] * along));
}

/**
 * What the slice through a position shows of a disc; null where it passes by.
 * @param {Disc} disc
 * @param {Frame} frame
 * @param {Vector} through
 * @param {number} thickness of a slice
 * @returns {Cut | null}
 */
export function cutOf({ centre, axis, radius }, { normal }, through, thickness) {
  const a = unit(axis);
  const depth = dot(plus(centre, through, -1), normal);
  const line = cross(a, normal);
  const sine = Math.hypot(...line);
  if (sine < FLAT) return Math.abs(depth) <= thickness / 2 + 1e-6 ? { kind: "circle" } : null;
  // from the centre within the disc to where the slice is
  const way = -depth / sine;
  if (Math.abs(way) >= radius) return null;
  const middle = plus(centre, unit(plus(normal, a, -dot(a, normal))), way);
  const half = Math.sqrt(radius * radius - way * way) / sine;
  return { kind: "line", ends: [plus(middle, line, -half), plus(middle, line, half)] };
}

/** Points around a disc's rim. @param {Disc} disc @param {number} count @returns {Vector[]} */
export function rimOf({ centre, axis, radius }, count) {
  const a = unit(axis);
  const smallest = a.map(Math.abs).indexOf(Math.min(...a.map(Math.abs)));
  const side = unit(cross(a, /** @type {Vector} */ ([0, 1, 2].map((n) => (n === smallest ? 1 : 0)))));
  const other = cross(a, side);
  return Array.from({ length: count }, (_, n) => {
    const angle = (2 * Math.PI * n) / count;
    return plus(plus(centre, side, radius * Math.cos(angle)), other, radius * Math.sin(angle));
  });
}

/**
 * The disc that is seen as the line from its centre to a position of the slice.
 * @param {Vector} centre
 * @param {Vector} rim
 * @param {Frame} frame
 * @returns {Disc}
 */
export function discAcross(centre, rim, frame) {
  const line = within(plus(rim, centre, -1), frame);
  return { centre, axis: unit(cross(frame.normal, line)), radius: Math.max(Math.hypot(...line), SMALLEST_MM) };
}

/**
 * A disc whose rim was taken at one position of the slice and drawn to another: turned about the slice's normal, and sized.
 * @param {Disc} disc
 * @param {Vector} from
 * @param {Vector} to
 * @param {Frame} frame
 * @returns {Disc}
 */
export function pulled(disc, from, to, frame) {
  const radius = Math.max(distance(disc.centre, to), SMALLEST_MM);
  const before = within(plus(from, disc.centre, -1), frame);
  const now = within(plus(to, disc.centre, -1), frame);
  const isFlat = Math.hypot(...cross(unit(disc.axis), frame.normal)) < FLAT;
  if (isFlat || Math.hypot(...before) < 1e-6 || Math.hypot(...now) < 1e-6) return { ...disc, radius };
  const angle = Math.atan2(dot(cross(before, now), frame.normal), dot(before, now));
  return { ...disc, axis: turned(disc.axis, frame.normal, angle), radius };
}

/** Numbers as a person would write them. @param {Vector} a @param {number} digits @returns {Vector} */
export function rounded(a, digits) {
  return /** @type {Vector} */ (a.map((value) => Number(value.toFixed(digits)) + 0));
}

/**
 * A line with points no nearer to each other than `least`; its ends stay.
 * @param {readonly Vector[]} points
 * @param {number} least
 * @returns {Vector[]}
 */
export function thinned(points, least) {
  const kept = [points[0]];
  for (const point of points.slice(1, -1)) if (distance(point, kept[kept.length - 1]) >= least) kept.push(point);
  if (points.length > 1 && distance(points[points.length - 1], points[0]) > 1e-6) kept.push(points[points.length - 1]);
  return kept;
}
