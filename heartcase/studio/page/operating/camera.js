/** Where one looks from: turning, moving, zooming, and the ray through a place of the picture. LPS mm; no browser. */

/** @typedef {[number, number, number]} Vector */
/** @typedef {{start_mm: Vector, direction: Vector, axes: [Vector, Vector, Vector]}} Look */

export const VIEW_ANGLE_DEG = 30;
const NEAREST_MM = 2;
const FARTHEST = 12;

/** @param {Vector} a @param {Vector} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Vector} a @param {Vector} b @param {number} [times] @returns {Vector} a + times b */
export const add = (a, b, times = 1) => [a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]];
/** @param {Vector} a @returns {Vector} */
export function unit(a) {
  const size = Math.hypot(...a);
  return [a[0] / size, a[1] / size, a[2] / size];
}

/** @param {Vector} a @param {Vector} axis of unit length @param {number} angle @returns {Vector} */
export function turned(a, axis, angle) {
  const along = dot(a, axis) * (1 - Math.cos(angle));
  const aside = cross(axis, a);
  return add(add([a[0] * Math.cos(angle), a[1] * Math.cos(angle), a[2] * Math.cos(angle)], aside, Math.sin(angle)), axis, along);
}

export class Camera {
  /** @type {Vector} */
  target = [0, 0, 0];
  distance = 100;
  size = 100;
  /** @type {Vector} */
  right = [1, 0, 0];
  /** @type {Vector} */
  up = [0, 0, 1];
  /** From what is seen to the eye. @type {Vector} */
  towards = [0, -1, 0];
  width = 1;
  height = 1;

  /** @param {Vector} low @param {Vector} high corners of what is to be seen */
  frame(low, high) {
    this.target = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2];
    this.size = Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
    // a picture that is higher than wide shows less aside
    this.distance = (1.6 * this.size) / Math.min(1, this.width / this.height);
    // from the front, somewhat left and above
    this.look([0.45, -1, 0.25]);
  }

  /** @param {Vector} from direction from what is seen to the eye; the head is up */
  look(from) {
    this.towards = unit(from);
    this.right = unit(cross([0, 0, 1], this.towards));
    this.up = cross(this.towards, this.right);
  }

  /** @param {Vector} right on the screen @param {Vector} up on the screen; both of unit length */
  stand(right, up) {
    [this.right, this.up] = [right, up];
    this.towards = unit(cross(right, up));
  }

  /** @returns {Vector} */
  get position() {
    return add(this.target, this.towards, this.distance);
  }

  /** Millimetres that a pixel is wide at the target. */
  get mmPerPixel() {
    return (2 * this.distance * Math.tan((VIEW_ANGLE_DEG * Math.PI) / 360)) / this.height;
  }

  /** @param {number} across @param {number} down pixels that the pointer went: what is seen goes with it */
  turn(across, down) {
    const angle = Math.PI / Math.min(this.width, this.height);
    const up = this.up;
    this.towards = turned(this.towards, up, -across * angle);
    this.right = turned(this.right, up, -across * angle);
    const right = this.right;
    this.towards = unit(turned(this.towards, right, -down * angle));
    // no drift: the axes are made perpendicular again
    this.up = unit(cross(this.towards, right));
    this.right = cross(this.up, this.towards);
  }

  /** @param {number} angle by which what is seen goes round, clockwise */
  roll(angle) {
    this.right = unit(turned(this.right, this.towards, angle));
    this.up = cross(this.towards, this.right);
  }

  /** @param {number} across @param {number} down pixels that the pointer went: what is seen goes with it */
  move(across, down) {
    this.target = add(add(this.target, this.right, -across * this.mmPerPixel), this.up, down * this.mmPerPixel);
  }

  /**
   * Nearer or farther, towards a place of the picture: what lies there, as deep as the target, stays there.
   * @param {number} times nearer, above 1
   * @param {{x: number, y: number}} [place] pixels from the picture's upper left corner; its middle when left out
   */
  zoom(times, place) {
    const before = this.mmPerPixel;
    this.distance = Math.min(Math.max(this.distance / times, NEAREST_MM), FARTHEST * this.size);
    if (place === undefined) return;
    const mm = before - this.mmPerPixel;
    const aside = add(this.target, this.right, (place.x - this.width / 2) * mm);
    this.target = add(aside, this.up, (this.height / 2 - place.y) * mm);
  }

  /** @param {number} x @param {number} y pixels from the picture's upper left corner @returns {Look} */
  at(x, y) {
    const half = Math.tan((VIEW_ANGLE_DEG * Math.PI) / 360);
    const across = (2 * x - this.width) / this.height;
    const above = (this.height - 2 * y) / this.height;
    const aside = add(add([0, 0, 0], this.right, half * across), this.up, half * above);
    const direction = unit(add(aside, this.towards, -1));
    return { start_mm: this.position, direction, axes: [this.right, this.up, this.towards] };
  }

  /** Where a place is seen, pixels from the upper left corner. @param {Vector} placeMm @returns {[number, number]} */
  pixel(placeMm) {
    const way = add(placeMm, this.position, -1);
    const half = Math.tan((VIEW_ANGLE_DEG * Math.PI) / 360);
    const depth = -dot(way, this.towards) * half;
    return [(this.width + (this.height * dot(way, this.right)) / depth) / 2, (this.height - (this.height * dot(way, this.up)) / depth) / 2];
  }
}
