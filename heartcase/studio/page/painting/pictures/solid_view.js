/** The structures as solids, seen from outside: which way one looks, and how finely it is drawn. */

import { Camera, dot, plus, turntable } from "../../shared/geometry.js";

/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("../../shared/geometry.js").Lattice} Lattice */
/** @typedef {import("./volume.js").Volume} Volume */

const FRAME_MS = 40;
const COARSEST = 0.2;
/** From the front, a little from the left and above. */
const FIRST = { azimuth: 20, elevation: 15 };

export class SolidView {
  isStale = true;
  overlayIsStale = true;
  /** It is being turned: drawn as finely as is quick. */
  isTurning = false;
  /** Time of a picture in full, ms: guessed from the last one. */
  fullMs = 0;
  ratio = 1;

  /** @param {HTMLElement} tile */
  constructor(tile) {
    this.tile = tile;
    this.surface = /** @type {HTMLElement} */ (tile.querySelector(".surface"));
    this.overlay = /** @type {HTMLCanvasElement} */ (tile.querySelector("canvas"));
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.overlay.getContext("2d"));
    this.azimuth = FIRST.azimuth;
    this.elevation = FIRST.elevation;
    const { frame, look } = turntable(this.azimuth, this.elevation);
    this.camera = new Camera(frame);
    this.look = look;
  }

  /** @param {number} azimuth @param {number} elevation degrees more */
  turn(azimuth, elevation) {
    this.azimuth = (this.azimuth + azimuth) % 360;
    this.elevation = Math.min(Math.max(this.elevation + elevation, -90), 90);
    const { frame, look } = turntable(this.azimuth, this.elevation);
    this.camera.frame = frame;
    this.look = look;
  }

  /** Share of the pixels across and down that are worked out, so that turning stays quick. */
  get share() {
    if (!this.isTurning || this.fullMs <= FRAME_MS) return 1;
    return Math.max(Math.sqrt(FRAME_MS / this.fullMs), COARSEST);
  }

  /** Whether it is quick enough to follow a stroke while it is drawn. */
  get isQuick() {
    return this.fullMs > 0 && this.fullMs < 8;
  }

  /**
   * The position on a solid's surface that a pixel shows; null where it shows none.
   * @param {number} x
   * @param {number} y
   * @param {Lattice} lattice
   * @param {Volume} volume
   * @param {Vector | null} through what lies in front of this position is cut away
   */
  surfaceAt(x, y, lattice, volume, through = null) {
    const extent = lattice.spacing.reduce((sum, one, a) => sum + one * lattice.size[a], 0);
    const seen = this.camera.toMm(x, y, lattice.centre);
    const from = plus(seen, this.look, through ? dot(plus(through, seen, -1), this.look) : -extent);
    const voxel = volume.firstSolid(lattice.toIndex(from), lattice.turnedToIndex(this.look), 2 * extent);
    return voxel && lattice.toWorld(voxel);
  }
}
