/** One slice on the page: its tile, its camera, and where its plane lies. */

import { boxMeetsPlane, Camera, PATIENT_FRAMES, plus, dot } from "../../shared/geometry.js";

/** @typedef {import("../../shared/geometry.js").Lattice} Lattice */
/** @typedef {import("../../shared/geometry.js").Rectangle} Rectangle */
/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {{x: number, y: number, width: number, height: number}} Part of the canvas, device pixels from below */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../studio.js").ViewName} ViewName */

/** Device pixels around what changed that are drawn anew with it, beside the width of an outline. */
const RIM = 2;

export class SliceView {
  /** The picture must be drawn anew; only what lies over it must. */
  isStale = true;
  overlayIsStale = true;
  /** Otherwise: the pixels that show labels which changed. @type {Rectangle | null} */
  changed = null;

  /**
   * @param {ViewName} name
   * @param {HTMLElement} tile
   * @param {Studio} studio
   */
  constructor(name, tile, studio) {
    this.name = name;
    this.tile = tile;
    this.studio = studio;
    this.surface = /** @type {HTMLElement} */ (tile.querySelector(".surface"));
    this.overlay = /** @type {HTMLCanvasElement} */ (tile.querySelector("canvas"));
    this.slider = /** @type {HTMLInputElement} */ (tile.querySelector(".slice-slider"));
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.overlay.getContext("2d"));
    this.camera = new Camera(PATIENT_FRAMES[name]);
    this.ratio = 1;
  }

  /** The patient position of a pixel. @param {number} x @param {number} y */
  toMm(x, y) {
    return this.camera.toMm(x, y, this.studio.crosshair.value);
  }

  /** Position of the plane along its normal from the scan's first slice, steps; and how many there are. @param {Lattice} lattice */
  slices(lattice) {
    const { normal } = this.camera.frame;
    const step = lattice.sliceStep(normal);
    const extent = lattice.steps.reduce((sum, one, a) => sum + Math.abs(dot(one, normal)) * (lattice.size[a] - 1), 0);
    const depth = dot(plus(this.studio.crosshair.value, lattice.centre, -1), normal);
    return { at: Math.round((depth + extent / 2) / step), count: Math.floor(extent / step + 1e-6) + 1 };
  }

  /** @param {number} steps forward, or back where negative */
  scroll(steps) {
    const lattice = this.studio.lattice.value;
    if (lattice === null || steps === 0) return;
    const { normal } = this.camera.frame;
    const moved = plus(this.studio.crosshair.value, normal, steps * lattice.sliceStep(normal));
    this.studio.crosshair.value = lattice.snapped(lattice.clamped(moved), normal);
  }

  /** Labels of a box of voxels are others now. @param {Lattice} lattice @param {Vector} low @param {Vector} size */
  noteLabels(lattice, low, size) {
    if (!boxMeetsPlane(lattice, low, size, this.camera.frame.normal, this.studio.crosshair.value)) return;
    const one = this.camera.around(lattice, low, size);
    const other = this.changed ?? one;
    this.changed = {
      left: Math.min(one.left, other.left),
      top: Math.min(one.top, other.top),
      right: Math.max(one.right, other.right),
      bottom: Math.max(one.bottom, other.bottom),
    };
  }

  /** What of the view's part of the canvas must be drawn anew; null for nothing. @param {Part} part @returns {Part | null} */
  stalePart(part) {
    if (this.isStale) return part;
    if (this.changed === null) return null;
    const { left, top, right, bottom } = this.changed;
    // the rim of what changed is drawn on what lies beside it
    const rim = Math.ceil(this.ratio) + RIM;
    const [x0, x1] = [Math.floor(left * this.ratio) - rim, Math.ceil(right * this.ratio) + rim];
    const [y0, y1] = [Math.floor(top * this.ratio) - rim, Math.ceil(bottom * this.ratio) + rim];
    const within = (/** @type {number} */ value, /** @type {number} */ most) => Math.min(Math.max(value, 0), most);
    const [x, y] = [within(x0, part.width), within(part.height - y1, part.height)];
    const width = within(x1, part.width) - x;
    const height = within(part.height - y0, part.height) - y;
    return width > 0 && height > 0 ? { x: part.x + x, y: part.y + y, width, height } : null;
  }

  /** Move the crosshair within the plane, by voxels. @param {number} across @param {number} along */
  nudge(across, along) {
    const lattice = this.studio.lattice.value;
    if (lattice === null) return;
    const { right, down } = this.camera.frame;
    const moved = plus(this.studio.crosshair.value, right, across * lattice.sliceStep(right));
    this.studio.crosshair.value = lattice.clamped(plus(moved, down, along * lattice.sliceStep(down)));
  }

  /** The picture follows where a position has left it. @param {Vector} mm */
  bringIntoSight(mm) {
    const { x, y } = this.camera.toPixel(mm, mm);
    const { width, height } = this.camera;
    if (x < 0 || y < 0 || x > width || y > height) this.camera.pan(width / 2 - x, height / 2 - y);
  }
}

/**
 * Take the size of a view's surface over.
 * @param {{surface: HTMLElement, overlay: HTMLCanvasElement, pen: CanvasRenderingContext2D, camera: Camera, ratio: number}} view
 */
export function fitToSurface(view) {
  const { surface, camera, overlay } = view;
  const ratio = globalThis.devicePixelRatio || 1;
  const width = Math.max(surface.clientWidth, 1);
  const height = Math.max(surface.clientHeight, 1);
  if (width === camera.width && height === camera.height && ratio === view.ratio) return;
  const before = Math.min(camera.width, camera.height);
  // What was seen stays seen, also where the tile has become smaller.
  if (before > 1) camera.mmPerPixel *= before / Math.min(width, height);
  camera.width = width;
  camera.height = height;
  view.ratio = ratio;
  overlay.width = Math.round(width * ratio);
  overlay.height = Math.round(height * ratio);
  view.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
}
