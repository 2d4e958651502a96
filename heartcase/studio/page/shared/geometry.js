/**
 * Where things are: voxels, patient millimetres (LPS: x to the patient's left, y to the back, z to the head) and pixels
 * of a view. Pure maths; lengths in mm, pixels are those of CSS, measured from a view's upper left corner.
 */

/** @typedef {[number, number, number]} Vector */
/** Pixels of a view. @typedef {{left: number, top: number, right: number, bottom: number}} Rectangle */
/** Directions of a view in the patient, unit vectors. @typedef {{right: Vector, down: Vector, normal: Vector}} Frame */
/** @typedef {{axial: Frame, coronal: Frame, sagittal: Frame}} Frames */

/** As radiologists see it: patient's left at the right, front and head up; forward steps go to head, front and left. */
export const PATIENT_FRAMES = /** @type {Frames} */ ({
  axial: { right: [1, 0, 0], down: [0, 1, 0], normal: [0, 0, 1] },
  coronal: { right: [1, 0, 0], down: [0, 0, -1], normal: [0, -1, 0] },
  sagittal: { right: [0, 1, 0], down: [0, 0, -1], normal: [1, 0, 0] },
});

/** Above this cosine two directions count as the same: 0.25 degrees, 1 mm at the rim of a 450 mm field. */
const ALIGNED = 0.99999;
/** Right, left; anterior, posterior; foot, head: as DICOM names directions in the patient. */
export const SIDES = "RLAPFH";
/** A letter is shown for each direction that a rim faces to more than 17 degrees. */
const LETTER_FROM = 0.3;

/** @param {Vector} a @param {Vector} b */
export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** a + factor * b @param {Vector} a @param {Vector} b @param {number} factor @returns {Vector} */
export function plus(a, b, factor = 1) {
  return [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
}

/** @param {Vector} a @param {Vector} b */
export function distance(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

/** @param {Vector} a @param {number} factor @returns {Vector} */
function times(a, factor) {
  return [a[0] * factor, a[1] * factor, a[2] * factor];
}

/** Angle at `corner` between the lines to `a` and `b`, degrees. @param {Vector} a @param {Vector} corner @param {Vector} b */
export function angleDegrees(a, corner, b) {
  const u = plus(a, corner, -1);
  const v = plus(b, corner, -1);
  const cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  return (Math.atan2(Math.hypot(...cross), dot(u, v)) * 180) / Math.PI;
}

/** The voxels of a scan, and where they lie in the patient. */
export class Lattice {
  /**
   * @param {Vector} size voxels along i, j, k
   * @param {number[][]} indexToWorld 4 x 4, rows
   */
  constructor(size, indexToWorld) {
    this.size = size;
    /** Steps of one voxel along i, j, k, mm. @type {Vector[]} */
    this.steps = [0, 1, 2].map((a) => /** @type {Vector} */ ([0, 1, 2].map((row) => indexToWorld[row][a])));
    this.origin = /** @type {Vector} */ ([0, 1, 2].map((row) => indexToWorld[row][3]));
    this.spacing = /** @type {Vector} */ (this.steps.map((step) => Math.hypot(...step)));
    /** Unit vectors along i, j, k. */
    this.axes = this.steps.map((step, a) => times(step, 1 / this.spacing[a]));
    this.inverse = inverted(this.steps);
  }

  /** @param {Vector} index @returns {Vector} mm */
  toWorld(index) {
    let mm = this.origin;
    for (let a = 0; a < 3; a++) mm = plus(mm, this.steps[a], index[a]);
    return mm;
  }

  /** @param {Vector} mm @returns {Vector} index */
  toIndex(mm) {
    return this.turnedToIndex(plus(mm, this.origin, -1));
  }

  /** A difference in mm as one of indices. @param {Vector} mm @returns {Vector} */
  turnedToIndex(mm) {
    return /** @type {Vector} */ (this.inverse.map((row) => dot(row, mm)));
  }

  /** The voxel that holds a position; null outside. @param {Vector} mm @returns {Vector | null} */
  voxelAt(mm) {
    const voxel = /** @type {Vector} */ (this.toIndex(mm).map((value) => Math.floor(value + 0.5)));
    return voxel.every((value, a) => value >= 0 && value < this.size[a]) ? voxel : null;
  }

  get centre() {
    return this.toWorld(/** @type {Vector} */ (this.size.map((count) => (count - 1) / 2)));
  }

  /** The nearest position inside. @param {Vector} mm @returns {Vector} */
  clamped(mm) {
    const index = this.toIndex(mm);
    return this.toWorld(/** @type {Vector} */ (index.map((v, a) => Math.min(Math.max(v, 0), this.size[a] - 1))));
  }

  /** Whether no axis of the scan runs along one of the patient's. */
  get isOblique() {
    return this.axes.some((axis) => Math.max(...axis.map(Math.abs)) < ALIGNED);
  }

  /** The axis whose slices a view along `normal` shows; null where it cuts through them. @param {Vector} normal */
  sliceAxis(normal) {
    const axis = this.axes.findIndex((direction) => Math.abs(dot(direction, normal)) >= ALIGNED);
    return axis < 0 ? null : axis;
  }

  /** How far one step along `normal` goes, mm: to the next slice, or by the smallest spacing where planes cut through. @param {Vector} normal */
  sliceStep(normal) {
    const axis = this.sliceAxis(normal);
    return axis === null ? Math.min(...this.spacing) : this.spacing[axis];
  }

  /** The position with its slice along `normal` in the middle of a layer of voxels. @param {Vector} mm @param {Vector} normal @returns {Vector} */
  snapped(mm, normal) {
    const axis = this.sliceAxis(normal);
    if (axis === null) return mm;
    const at = this.toIndex(mm)[axis];
    return plus(mm, this.steps[axis], Math.floor(at + 0.5) - at);
  }
}

/** Rows of the inverse of a matrix whose columns are given. @param {Vector[]} columns @returns {Vector[]} */
function inverted(columns) {
  const [a, b, c] = columns;
  /** @param {Vector} u @param {Vector} v @returns {Vector} */
  const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const rows = [cross(b, c), cross(c, a), cross(a, b)];
  const determinant = dot(a, rows[0]);
  if (!(Math.abs(determinant) > 0)) throw new Error("the scan's axes lie in one plane");
  return rows.map((row) => times(row, 1 / determinant));
}

/**
 * The patient's views turned to the scan's own axes, each to the one nearest to it.
 * @param {Lattice} lattice
 * @returns {Frames}
 */
export function scanFrames(lattice) {
  const orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
  const fit = (/** @type {number[]} */ order) =>
    order.reduce((sum, axis, direction) => sum + Math.abs(lattice.axes[axis][direction]), 0);
  const best = orders.reduce((kept, order) => (fit(order) > fit(kept) + 1e-9 ? order : kept));
  const turned = best.map((axis, direction) => times(lattice.axes[axis], Math.sign(lattice.axes[axis][direction]) || 1));
  const turn = (/** @type {Vector} */ v) => plus(plus(times(turned[0], v[0]), turned[1], v[1]), turned[2], v[2]);
  const frame = (/** @type {Frame} */ f) => ({ right: turn(f.right), down: turn(f.down), normal: turn(f.normal) });
  const { axial, coronal, sagittal } = PATIENT_FRAMES;
  return { axial: frame(axial), coronal: frame(coronal), sagittal: frame(sagittal) };
}

/** What a direction faces, strongest first: "L", or "L·A" where it is oblique (LA is an atrium). @param {Vector} direction */
export function orientationLetters(direction) {
  const letters = direction.map((value, axis) => ({ size: Math.abs(value), letter: SIDES[2 * axis + (value > 0 ? 1 : 0)] }));
  letters.sort((a, b) => b.size - a.size);
  return letters.filter((one) => one.size > LETTER_FROM).map((one) => one.letter).join("·");
}

/** Where a view looks: which plane, how large, and what lies in its middle. */
export class Camera {
  /** @param {Frame} frame */
  constructor(frame) {
    this.frame = frame;
    this.width = 1;
    this.height = 1;
    this.mmPerPixel = 1;
    /** What lies in the middle, as far as the plane goes. @type {Vector} */
    this.centre = [0, 0, 0];
  }

  /** Show the whole scan. @param {Lattice} lattice */
  fit(lattice) {
    const [across, along] = [this.frame.right, this.frame.down].map((direction) =>
      lattice.steps.reduce((sum, step, a) => sum + Math.abs(dot(step, direction)) * lattice.size[a], 0),
    );
    this.centre = lattice.centre;
    this.mmPerPixel = Math.max(across / this.width, along / this.height) || 1;
  }

  /** The patient position of a pixel on the plane through `through`. @param {number} x @param {number} y @param {Vector} through @returns {Vector} */
  toMm(x, y, through) {
    const { right, down, normal } = this.frame;
    const inPlane = plus(
      plus(this.centre, right, (x - this.width / 2) * this.mmPerPixel),
      down,
      (y - this.height / 2) * this.mmPerPixel,
    );
    return plus(inPlane, normal, dot(plus(through, inPlane, -1), normal));
  }

  /** Where a position is seen: pixels across and down, and how far in front of the plane through `through` it lies, mm. @param {Vector} mm @param {Vector} through */
  toPixel(mm, through) {
    const offset = plus(mm, this.centre, -1);
    return {
      x: this.width / 2 + dot(offset, this.frame.right) / this.mmPerPixel,
      y: this.height / 2 + dot(offset, this.frame.down) / this.mmPerPixel,
      depth: dot(plus(mm, through, -1), this.frame.normal),
    };
  }

  /** The pixels around a box of voxels, wherever the plane lies. @param {Lattice} lattice @param {Vector} low @param {Vector} size @returns {Rectangle} */
  around(lattice, low, size) {
    const found = { left: Infinity, top: Infinity, right: -Infinity, bottom: -Infinity };
    for (const corner of cornersOf(lattice, low, size)) {
      const { x, y } = this.toPixel(corner, corner);
      found.left = Math.min(found.left, x);
      found.right = Math.max(found.right, x);
      found.top = Math.min(found.top, y);
      found.bottom = Math.max(found.bottom, y);
    }
    return found;
  }

  /** @param {number} dx @param {number} dy pixels by which the picture moves */
  pan(dx, dy) {
    const moved = plus(this.centre, this.frame.right, -dx * this.mmPerPixel);
    this.centre = plus(moved, this.frame.down, -dy * this.mmPerPixel);
  }

  /** Enlarge by `factor` while what lies at (x, y) stays there. @param {number} factor @param {number} x @param {number} y */
  zoom(factor, x, y) {
    const scale = Math.min(Math.max(this.mmPerPixel / factor, 0.005), 20);
    const change = this.mmPerPixel - scale;
    const { right, down } = this.frame;
    this.centre = plus(plus(this.centre, right, (x - this.width / 2) * change), down, (y - this.height / 2) * change);
    this.mmPerPixel = scale;
  }

  /** What a shader needs: the index at pixel (0, 0), and the steps of index per pixel. @param {Vector} through @param {Lattice} lattice */
  toIndexSteps(through, lattice) {
    return {
      origin: lattice.toIndex(this.toMm(0, 0, through)),
      across: times(lattice.turnedToIndex(this.frame.right), this.mmPerPixel),
      along: times(lattice.turnedToIndex(this.frame.down), this.mmPerPixel),
    };
  }
}

/**
 * A view from outside, its vertical along the patient's.
 * @param {number} azimuth degrees; 0 from the front, 90 from the patient's left
 * @param {number} elevation degrees above the horizontal
 * @returns {{frame: Frame, look: Vector}} the frame, and the direction away from the viewer.
 */
export function turntable(azimuth, elevation) {
  const [a, e] = [(azimuth * Math.PI) / 180, (elevation * Math.PI) / 180];
  /** @type {Vector} */
  const right = [Math.cos(a), Math.sin(a), 0];
  /** @type {Vector} */
  const level = [-Math.sin(a), Math.cos(a), 0];
  const look = plus(times(level, Math.cos(e)), [0, 0, 1], -Math.sin(e));
  const down = plus(times(level, -Math.sin(e)), [0, 0, 1], -Math.cos(e));
  return { frame: { right, down, normal: times(look, -1) }, look };
}

/** Where the eight corners of a box of voxels lie. @param {Lattice} lattice @param {Vector} low @param {Vector} size */
function cornersOf(lattice, low, size) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map((corner) => {
    const index = low.map((first, a) => first - 0.5 + ((corner >> a) & 1) * size[a]);
    return lattice.toWorld(/** @type {Vector} */ (index));
  });
}

/** Whether a box of voxels meets the plane through a position. @param {Lattice} lattice @param {Vector} low @param {Vector} size @param {Vector} normal @param {Vector} through */
export function boxMeetsPlane(lattice, low, size, normal, through) {
  const depths = cornersOf(lattice, low, size).map((corner) => dot(plus(corner, through, -1), normal));
  return Math.min(...depths) <= 1e-6 && Math.max(...depths) >= -1e-6;
}

/** Radius of what a plane at a distance cuts from a sphere; 0 where it passes by. @param {number} radius @param {number} depth */
export function sectionRadius(radius, depth) {
  return Math.sqrt(Math.max(radius * radius - depth * depth, 0));
}

/** The longest of 1, 2, 5, 10, 20, ... that is not above `most`. @param {number} most */
export function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  const first = most / power;
  return power * (first >= 5 ? 5 : first >= 2 ? 2 : 1);
}

/** The window after a drag: to the right wider, down brighter. @param {{low: number, high: number}} window @param {number} dx @param {number} dy pixels */
export function draggedWindow({ low, high }, dx, dy) {
  const width = Math.max((high - low) * Math.exp(dx / 200), 1e-3);
  const level = (low + high) / 2 - (dy * width) / 400;
  return { low: level - width / 2, high: level + width / 2 };
}
