/** What mouse, pen and keys do to the lines of the recipe: place, select, move, turn and size them in the slices. */

import { distance, plus } from "../shared/geometry.js";
import { discAcross, pulled, rounded, thinned } from "./discs.js";
import { handleAt } from "./drawing.js";
import { discOf, isSame, placeOf, withDisc } from "./shaping.js";

/** @typedef {import("../shared/geometry.js").Vector} Vector */
/** @typedef {import("../painting/pictures/slice_view.js").SliceView} SliceView */
/** @typedef {import("../painting/studio.js").Studio} Studio */
/** @typedef {import("./drawing.js").Handle} Handle */
/** @typedef {import("./shaping.js").Entry} Entry */
/** @typedef {import("./shaping.js").Kind} Kind */
/** @typedef {import("./shaping.js").Shaping} Shaping */
/** @typedef {{x: number, y: number}} Point */
/** @typedef {{view: SliceView, from: Vector, at: Point, points: Vector[], moved: boolean, handle: Handle | null, entry: Entry | null, kind: Kind | null}} Grip */

const REACH = 11;
const MOVED = 4;
const FIRST_DIAMETER_MM = 8;
const PATHS = new Set(["add", "remove", "smooth", "fill", "polyline"]);

export class Hands {
  /** @type {Grip | null} */
  #grip = null;

  /** @param {Studio} studio @param {Shaping} shaping */
  constructor(studio, shaping) {
    this.studio = studio;
    this.shaping = shaping;
  }

  /** @param {SliceView} view @param {Point} at @returns {boolean} whether something is in hand now; else the crosshair is moved. */
  down(view, at) {
    const { shaping, studio } = this;
    const kind = shaping.placing.value;
    const from = view.toMm(at.x, at.y);
    const handle = kind ? null : handleAt(shaping, view.camera, studio.crosshair.value, this.#thickness(view), at, REACH);
    if (!studio.ready.value || (!kind && !handle)) return false;
    const isNew = handle !== null && !isSame(handle.line, shaping.selected.value);
    if (handle) shaping.selected.value = handle.line;
    this.#grip = { view, from, at, points: [from], moved: false, handle: isNew ? null : handle, entry: handle ? shaping.entryOf(handle.line) : null, kind };
    return true;
  }

  /** @param {Point} at */
  move(at) {
    const grip = this.#grip;
    if (grip === null) return;
    grip.moved ||= Math.hypot(at.x - grip.at.x, at.y - grip.at.y) > MOVED;
    if (!grip.moved) return;
    const mm = grip.view.toMm(at.x, at.y);
    grip.points.push(mm);
    const { shaping } = this;
    if (grip.kind) {
      const entry = this.#placed(grip.kind, grip, mm);
      if (entry) shaping.draft.value = { line: { list: grip.kind.list, number: 0 }, entry };
    } else if (grip.handle && grip.entry) {
      const entry = dragged(grip.handle, grip.entry, grip.from, mm, grip.view);
      if (entry) shaping.draft.value = { line: grip.handle.line, entry };
    }
  }

  /** What was in hand is let go where it is. */
  up() {
    const grip = this.#grip;
    this.#grip = null;
    const { shaping } = this;
    const draft = shaping.draft.value;
    if (grip === null) return;
    if (grip.kind) void this.#finish(grip.kind, grip.from, grip.moved ? (draft?.entry ?? null) : null);
    else if (draft && grip.entry) void shaping.change(draft.line, grip.entry, draft.entry);
  }

  /** Nothing is in hand any more, and nothing has changed. */
  drop() {
    const isHeld = this.#grip !== null || this.shaping.placing.value !== null;
    this.#grip = this.shaping.draft.value = this.shaping.placing.value = null;
    return isHeld;
  }

  /** A key: place at the crosshair what a click would place. @returns {boolean} whether there was something to place. */
  placeAtCrosshair() {
    const kind = this.shaping.placing.value;
    if (kind === null || !this.studio.ready.value) return false;
    void this.#finish(kind, this.studio.crosshair.value, null);
    return true;
  }

  /** The line that is selected goes to the crosshair. */
  moveToCrosshair() {
    const line = this.shaping.selected.value;
    const entry = this.shaping.entryOf(line);
    if (line === null || entry === null) return;
    const points = /** @type {Vector[] | undefined} */ (entry.points_mm);
    const to = this.studio.crosshair.value;
    if (!points) void this.shaping.change(line, entry, { ...entry, position_mm: rounded(to, 1) });
    else {
      const way = plus(to, points[Math.floor(points.length / 2)], -1);
      void this.shaping.change(line, entry, { ...entry, points_mm: points.map((mm) => rounded(plus(mm, way), 1)) });
    }
  }

  /** The disc that is selected faces the other way. */
  flip() {
    const line = this.shaping.selected.value;
    const entry = this.shaping.entryOf(line);
    if (line && entry?.axis) void this.shaping.change(line, entry, { ...entry, axis: entry.axis.map((/** @type {number} */ one) => -one + 0) });
  }

  /** @param {SliceView} view */
  #thickness(view) {
    return this.studio.lattice.value?.sliceStep(view.camera.frame.normal) ?? 1;
  }

  /** What a drag of this kind makes. @param {Kind} kind @param {Grip} grip @param {Vector} mm @returns {Entry | null} */
  #placed(kind, grip, mm) {
    if (PATHS.has(kind.kind)) return this.#path(kind, grip.points);
    const disc = discAcross(grip.from, mm, grip.view.camera.frame);
    return this.#disc(kind, rounded(grip.from, 1), rounded(disc.axis, 3), disc.radius);
  }

  /** @param {Kind} kind @param {readonly Vector[]} points @returns {Entry | null} */
  #path(kind, points) {
    const radius = this.studio.radiusMm.value;
    const line = thinned(points, Math.max(radius / 3, 1)).map((mm) => rounded(mm, 1));
    if (kind.kind === "polyline") return line.length < 2 ? null : { kind: "polyline", name: this.#newName("line"), points_mm: line };
    const label = this.studio.pickedLabel;
    return { kind: kind.kind, label: label?.name ?? "", radius_mm: Number(radius.toFixed(1)), points_mm: line };
  }

  /** @param {Kind} kind @param {Vector} centre @param {Vector | null} axis @param {number} radius @returns {Entry | null} */
  #disc(kind, centre, axis, radius) {
    const radius_mm = Number(Math.max(radius, 0.1).toFixed(1));
    if (kind.list === "ends") return { label: this.#labelAt(centre), position_mm: centre, axis, radius_mm };
    if (kind.list === "pins") return { position_mm: centre, radius_mm };
    if (kind.kind === "ring") return { kind: "ring", name: this.#newName("ring"), points_mm: [centre], axis, radius_mm };
    if (kind.kind === "point") return { kind: "point", name: this.#newName("point"), points_mm: [centre] };
    return { kind: kind.kind, position_mm: centre, diameter_mm: Number((2 * radius).toFixed(1)), axis };
  }

  /**
   * Write what was placed; a click alone asks how it best lies there.
   * @param {Kind} kind
   * @param {Vector} mm
   * @param {Entry | null} drawn
   */
  async #finish(kind, mm, drawn) {
    const { shaping } = this;
    try {
      const entry = drawn ? await this.#turnedOut(kind, drawn, mm) : await this.#proposed(kind, mm);
      shaping.draft.value = null;
      if (entry === null || !(await shaping.add(kind.list, [entry]))) return;
      shaping.placing.value = null;
      // what was proposed may lie beside the click
      const place = placeOf(entry);
      if (!drawn && place) this.lookAt?.(place);
    } catch (error) {
      shaping.draft.value = null;
      shaping.onFault(error);
    }
  }

  /** An end that was drawn, with its axis out of the heart. @param {Kind} kind @param {Entry} entry @param {Vector} mm @returns {Promise<Entry>} */
  async #turnedOut(kind, entry, mm) {
    if (kind.list !== "ends") return entry;
    try {
      const { axis, label } = await this.shaping.propose("vessel", mm);
      const isIn = entry.axis.reduce((/** @type {number} */ sum, /** @type {number} */ one, /** @type {number} */ n) => sum + one * axis[n], 0) < 0;
      return { ...entry, label, axis: isIn ? entry.axis.map((/** @type {number} */ one) => -one + 0) : entry.axis };
    } catch {
      // no tube there: it stays as it was drawn, and can be flipped
      return entry;
    }
  }

  /** @param {Kind} kind @param {Vector} mm @returns {Promise<Entry | null>} */
  async #proposed(kind, mm) {
    if (PATHS.has(kind.kind)) return this.#path(kind, [mm]);
    const at = rounded(mm, 1);
    if (kind.kind === "point" || kind.list === "pins") return this.#disc(kind, at, null, this.studio.radiusMm.value);
    if (kind.list === "ends" || kind.kind === "ring") {
      const { label, position_mm, axis, radius_mm } = await this.shaping.propose("vessel", mm);
      return kind.list === "ends" ? { label, position_mm, axis, radius_mm } : this.#disc(kind, position_mm, axis, radius_mm);
    }
    const { position_mm, axis } = await this.shaping.propose("septum", mm);
    return this.#disc(kind, position_mm, axis, FIRST_DIAMETER_MM / 2);
  }

  /** Name of the structure at a position. @param {Vector} mm */
  #labelAt(mm) {
    const { studio } = this;
    const voxel = studio.lattice.value?.voxelAt(mm);
    const value = voxel ? this.labelValueAt?.(voxel) : null;
    const found = studio.labels.value.find((one) => one.value === value && one.role !== "background");
    return found?.name ?? studio.pickedLabel?.name ?? "";
  }

  /** What takes the slices to a position. @type {((mm: Vector) => void) | null} */
  lookAt = null;
  /** Label value of a voxel: what the pictures show. @type {((voxel: Vector) => number | null) | null} */
  labelValueAt = null;

  /** A name that no landmark has. @param {string} word */
  #newName(word) {
    const names = new Set((this.shaping.shape.value?.lines.landmarks ?? []).map(({ name }) => name.toLowerCase()));
    let number = 1;
    while (names.has(`${word} ${number}`)) number += 1;
    return `${word} ${number}`;
  }
}

/**
 * A line whose handle was taken at one position and drawn to another.
 * @param {Handle} handle
 * @param {Entry} entry
 * @param {Vector} from
 * @param {Vector} to
 * @param {SliceView} view
 * @returns {Entry | null}
 */
export function dragged({ line, at, mm }, entry, from, to, view) {
  const way = plus(to, from, -1);
  const disc = discOf(line.list, entry);
  if (disc && at === "rim") return withDisc(line.list, entry, pulled(disc, mm, plus(mm, way), view.camera.frame));
  if (disc) return withDisc(line.list, entry, { ...disc, centre: plus(disc.centre, way) });
  if (entry.position_mm) return { ...entry, position_mm: rounded(plus(entry.position_mm, way), 1) };
  const points = /** @type {Vector[]} */ (entry.points_mm);
  const isOne = line.list === "landmarks" && points.length > 1;
  // of a landmark one point is moved, of a brush's path all of them
  return { ...entry, points_mm: points.map((point) => (isOne && distance(point, mm) > 1e-6 ? point : rounded(plus(point, way), 1))) };
}
