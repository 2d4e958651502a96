/** What the parts of the page share: what is open, what is in hand, and where one looks. */

import { PATIENT_PLANES } from "./pictures/planes.js";
import { keep, keptNumber } from "../shared/settings.js";
import { Signal } from "../shared/signal.js";

/** @typedef {import("../shared/geometry.js").Vector} Vector */
/** @typedef {import("../shared/geometry.js").Lattice} Lattice */
/** @typedef {"pointer" | "brush" | "eraser" | "ruler" | "angle" | "shape"} Tool */
/** @typedef {"axial" | "coronal" | "sagittal"} ViewName */
/** @typedef {{value: number, name: string, colour: string, role: string}} Label */
/** @typedef {{low: number, high: number}} Range */

export const TOOLS = /** @type {const} */ (["pointer", "brush", "eraser", "ruler", "angle"]);
export const SMALLEST_RADIUS_MM = 0.3;
export const LARGEST_RADIUS_MM = 30;

export class Studio {
  /** Where the voxels lie; null until a scan is there. */
  lattice = new Signal(/** @type {Lattice | null} */ (null));
  labels = new Signal(/** @type {readonly Label[]} */ ([]));
  modality = new Signal(/** @type {string | null} */ (null));
  /** What the recipe proposes, and the scan's own lowest and highest intensity. */
  firstWindow = new Signal(/** @type {Range} */ ({ low: 0, high: 1 }));
  range = new Signal(/** @type {Range} */ ({ low: 0, high: 1 }));

  /** Whether strokes can be painted now: connected, and everything has arrived. */
  ready = new Signal(false);
  undoCount = new Signal(0);
  redoCount = new Signal(0);
  /** What undo takes back, and redo does again, in the recipe's words: "strokes", "ends[2]". */
  undoKind = new Signal("strokes");
  redoKind = new Signal("strokes");
  /** Whether the recipe's file holds all that was painted. */
  saved = new Signal(true);
  /** Names of what is marked; null while the server has not said. */
  marked = new Signal(/** @type {readonly string[] | null} */ (null));
  /** Whether labels still spread: those far from the last stroke are of before. */
  spreads = new Signal(false);

  tool = new Signal(/** @type {Tool} */ ("brush"));
  /** The tool before this one: what the space bar goes back to. @type {Tool} */
  toolBefore = "pointer";
  /** A key is held that makes the brush erase. */
  erasing = new Signal(false);
  /** The space bar is held: dragging pans. */
  panning = new Signal(false);
  /** Value of the structure in hand. */
  picked = new Signal(/** @type {number | null} */ (null));
  radiusMm = new Signal(keptNumber("radius_mm", SMALLEST_RADIUS_MM, LARGEST_RADIUS_MM, 3));

  /** Where the pointer is, in the patient and in the view's picture; null where it is over no view. */
  hover = new Signal(/** @type {{view: ViewName, mm: Vector, x: number, y: number} | null} */ (null));
  /** The stroke under way: its positions and whether it erases; null where none is. */
  stroke = new Signal(/** @type {{points: readonly Vector[], erases: boolean} | null} */ (null));

  crosshair = new Signal(/** @type {Vector} */ ([0, 0, 0]));
  window = new Signal(/** @type {Range} */ ({ low: 0, high: 1 }));
  opacity = new Signal(keptNumber("opacity", 0, 1, 0.4));
  outline = new Signal(keptNumber("outline", 0, 1, 1) === 1);
  /** Values of structures that are not drawn. */
  hidden = new Signal(/** @type {ReadonlySet<number>} */ (new Set()));
  labelsShown = new Signal(true);
  /** Which planes the slices show. */
  planes = new Signal(PATIENT_PLANES);
  activeView = new Signal(/** @type {ViewName} */ ("axial"));
  /** The tile that is large; null for two by two. */
  large = new Signal(/** @type {ViewName | "solid" | null} */ (null));

  /** Places that are marked in the slices, with what is said of them. */
  marks = new Signal(/** @type {readonly {mm: Vector, text: string, isOdd: boolean}[]} */ ([]));

  constructor() {
    this.radiusMm.listen((value) => keep("radius_mm", value));
    this.opacity.listen((value) => keep("opacity", value));
    this.outline.listen((value) => keep("outline", Number(value)));
  }

  /** @param {Tool} tool */
  take(tool) {
    if (tool === this.tool.value) return;
    this.toolBefore = this.tool.value;
    this.tool.value = tool;
  }

  swapTools() {
    this.take(this.toolBefore);
  }

  /** Whether what is painted now erases. */
  get erases() {
    return this.tool.value === "eraser" || this.erasing.value;
  }

  /** Whether a label still has nothing to stop at: the first one that is marked takes the whole scan. */
  get isUnbounded() {
    return this.marked.value !== null && this.marked.value.length < 2;
  }

  get pickedLabel() {
    return this.labels.value.find((label) => label.value === this.picked.value) ?? null;
  }

  /** @param {number} value */
  pick(value) {
    this.picked.value = value;
    // with the tool of the tab Shape one picks what is sculpted
    if (this.tool.value !== "brush" && this.tool.value !== "shape") this.take("brush");
  }

  /** @param {number} steps larger, or smaller where negative */
  resizeBrush(steps) {
    const radius = this.radiusMm.value * 1.15 ** steps;
    const rounded = Math.round(radius * 10) / 10 || SMALLEST_RADIUS_MM;
    // A step that rounding would swallow still is one.
    const moved = rounded === this.radiusMm.value ? rounded + 0.1 * Math.sign(steps) : rounded;
    this.radiusMm.value = Math.min(Math.max(Math.round(moved * 10) / 10, SMALLEST_RADIUS_MM), LARGEST_RADIUS_MM);
  }

  /** @param {number} value */
  toggleShown(value) {
    const hidden = new Set(this.hidden.value);
    if (!hidden.delete(value)) hidden.add(value);
    this.hidden.value = hidden;
  }
}
