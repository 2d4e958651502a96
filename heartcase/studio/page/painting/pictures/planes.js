/**
 * Planes of the three slices: which they are, how they are turned about one another, and where each is seen in the others.
 * Pure maths; angles in a view go from its right to its lower side.
 */

import { dot, PATIENT_FRAMES, plus, scanFrames } from "../../shared/geometry.js";

/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("../../shared/geometry.js").Frame} Frame */
/** @typedef {import("../../shared/geometry.js").Frames} Frames */
/** @typedef {import("../../shared/geometry.js").Lattice} Lattice */
/** @typedef {"axial" | "coronal" | "sagittal"} ViewName */
/** @typedef {"short_axis" | "four_chamber" | "two_chamber" | "three_chamber"} HeartPlane */
/** @typedef {ViewName | HeartPlane} Title */
/** @typedef {"patient" | "scan" | "heart" | "heart3" | "turned"} PlanesName */
/** What the slices show: `turned` names the views that were turned by hand. @typedef {{name: PlanesName, frames: Frames, titles: Record<ViewName, Title>, turned: readonly ViewName[]}} Planes */
/** What the server says. @typedef {{planes: Partial<Record<HeartPlane, Frame>>, missing: Partial<Record<HeartPlane, string[]>>, centre_mm: Vector | null}} Found */

export const VIEWS = /** @type {const} */ (["axial", "coronal", "sagittal"]);
const OWN_TITLES = /** @type {Record<ViewName, Title>} */ ({ axial: "axial", coronal: "coronal", sagittal: "sagittal" });

export const PATIENT_PLANES = /** @type {Planes} */ ({ name: "patient", frames: PATIENT_FRAMES, titles: OWN_TITLES, turned: [] });

/** Which of the heart's planes each tile takes. @type {Record<"heart" | "heart3", Record<ViewName, HeartPlane>>} */
const HEART = {
  heart: { axial: "four_chamber", coronal: "short_axis", sagittal: "two_chamber" },
  heart3: { axial: "four_chamber", coronal: "short_axis", sagittal: "three_chamber" },
};

/** Planes that meet at less than this sine show no line in one another. */
const LEAST_SINE = 0.05;
/** Handles lie this far from the crosshair, as a share of the smaller side of the view. */
const HANDLE_AT = 0.36;
/** Nearer to the rim than this they are left out, pixels. */
const HANDLE_RIM = 12;
/** How far from a handle's middle it is taken: a target of 28 pixels. */
const HANDLE_REACH = 14;
/** Smaller views have no handles, pixels. */
const SMALLEST = 150;

/** @param {Lattice} lattice @returns {Planes} */
export function scanPlanes(lattice) {
  return { name: "scan", frames: scanFrames(lattice), titles: OWN_TITLES, turned: [] };
}

/**
 * The heart's planes; a tile keeps the patient's where its own is not known.
 * @param {"heart" | "heart3"} name
 * @param {Found} found
 * @returns {Planes | null} null where there is none at all.
 */
export function heartPlanes(name, found) {
  const frames = { ...PATIENT_FRAMES };
  const titles = { ...OWN_TITLES };
  for (const view of VIEWS) {
    const plane = HEART[name][view];
    const frame = found.planes[plane];
    if (!frame) continue;
    frames[view] = frame;
    titles[view] = plane;
  }
  return VIEWS.some((view) => titles[view] !== view) ? { name, frames, titles, turned: [] } : null;
}

/** The planes that are not there, and what they need. @param {"heart" | "heart3"} name @param {Found} found */
export function lacking(name, found) {
  const wanted = VIEWS.map((view) => HEART[name][view]).filter((plane) => !found.planes[plane]);
  return wanted.map((plane) => ({ plane, structures: found.missing[plane] ?? [] }));
}

/**
 * A direction turned about the normal of a frame, from its right to its lower side.
 * @param {Vector} direction
 * @param {Frame} about
 * @param {number} angle radians
 * @returns {Vector}
 */
export function turned(direction, about, angle) {
  const a = dot(direction, about.right);
  const b = dot(direction, about.down);
  const [c, s] = [Math.cos(angle) - 1, Math.sin(angle)];
  return plus(plus(direction, about.right, a * c - b * s), about.down, a * s + b * c);
}

/**
 * All other planes turned about the normal of one view.
 * @param {Planes} planes
 * @param {ViewName} view
 * @param {number} angle radians
 * @returns {Planes}
 */
export function turnedPlanes(planes, view, angle) {
  const about = planes.frames[view];
  const frames = { ...planes.frames };
  for (const other of VIEWS) {
    if (other === view) continue;
    const { right, down, normal } = frames[other];
    frames[other] = orthonormal(turned(right, about, angle), turned(down, about, angle), turned(normal, about, angle));
  }
  return { ...planes, name: "turned", frames, turned: VIEWS.filter((one) => one !== view || planes.turned.includes(one)) };
}

/** Rounding of many small turns must not skew a frame. @param {Vector} right @param {Vector} down @param {Vector} normal @returns {Frame} */
function orthonormal(right, down, normal) {
  const unit = (/** @type {Vector} */ v) => /** @type {Vector} */ (v.map((x) => x / Math.hypot(...v)));
  const x = unit(right);
  const y = unit(plus(down, x, -dot(down, x)));
  return { right: x, down: y, normal: unit(plus(plus(normal, x, -dot(normal, x)), y, -dot(normal, y))) };
}

/**
 * The direction in which another plane is seen in a view: unit vector, right and down; null where they are the same plane.
 * @param {Frame} frame
 * @param {Frame} other
 * @returns {[number, number] | null}
 */
export function lineOf(frame, other) {
  const [p, q] = [dot(other.normal, frame.right), dot(other.normal, frame.down)];
  const length = Math.hypot(p, q);
  return length < LEAST_SINE ? null : [-q / length, p / length];
}

/**
 * Where the handles of a view are, pixels: two on the line of each other plane.
 * @param {Planes} planes
 * @param {ViewName} view
 * @param {{width: number, height: number}} size
 * @param {{x: number, y: number}} cross
 */
export function handlesOf(planes, view, { width, height }, cross) {
  const far = HANDLE_AT * Math.min(width, height);
  /** @type {{x: number, y: number}[]} */
  const found = [];
  if (Math.min(width, height) < SMALLEST) return found;
  for (const other of VIEWS) {
    const line = other === view ? null : lineOf(planes.frames[view], planes.frames[other]);
    if (line === null) continue;
    for (const way of [far, -far]) {
      const at = { x: cross.x + way * line[0], y: cross.y + way * line[1] };
      const isInside = at.x > HANDLE_RIM && at.y > HANDLE_RIM && at.x < width - HANDLE_RIM && at.y < height - HANDLE_RIM;
      if (isInside) found.push(at);
    }
  }
  return found;
}

/** Whether a pixel lies on one of the handles. @param {readonly {x: number, y: number}[]} handles @param {{x: number, y: number}} at */
export function isOnHandle(handles, at) {
  return handles.some(({ x, y }) => Math.hypot(at.x - x, at.y - y) <= HANDLE_REACH);
}
