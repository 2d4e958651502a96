/**
 * The cells of the tissue where a plane cuts them: triangles of the plane with the place at rest of each corner.
 *
 * Each cell is taken as the six tetrahedra around its diagonal from corner 0 to corner 7, as it stands now. No browser.
 */

/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {{origin_mm: readonly number[], direction: readonly (readonly number[])[], cell_mm: number}} Place of the grid: middle of cell 0, axes as columns */

/** Corners of the tetrahedra; corner n of a cell lies at the bits of n along i, j, k. */
const TETRAHEDRA = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];
/** Numbers of each corner of a triangle: place LPS mm, place at rest [cells], stretch from 0 to 1. */
export const STRIDE = 7;

export class Tissue {
  /** Corners of the triangles, STRIDE numbers each; `count` of them are of use. */
  corners = new Float32Array(3 * STRIDE * 256);
  /** Corners that are of use: three for each triangle. */
  count = 0;
  /** Labels of the cells in their box, i fastest; 0 where there is no cell. @type {Uint8Array} */
  labels;
  /** Cells of that box along i, j, k. @type {[number, number, number]} */
  size = [1, 1, 1];
  /** First cell of that box. @type {[number, number, number]} */
  low = [0, 0, 0];

  /**
   * @param {Int16Array} cells (i, j, k) of each cell
   * @param {Uint32Array} cellCorners eight nodes of each cell
   * @param {Uint8Array} cellLabels label of each cell
   * @param {number} nodeCount
   * @param {Place} place
   */
  constructor(cells, cellCorners, cellLabels, nodeCount, place) {
    this.cellCorners = cellCorners;
    this.place = place;
    /** Place of each node at rest [cells]: cell (i, j, k) lies between i - 1/2 and i + 1/2. */
    this.rest = new Float32Array(3 * nodeCount);
    this.side = new Float32Array(nodeCount);
    const cellCount = cellLabels.length;
    const high = [-Infinity, -Infinity, -Infinity];
    this.low = cellCount > 0 ? [Infinity, Infinity, Infinity] : [0, 0, 0];
    for (let n = 0; n < 3 * cellCount; n++) {
      this.low[n % 3] = Math.min(this.low[n % 3], cells[n]);
      high[n % 3] = Math.max(high[n % 3], cells[n]);
    }
    if (cellCount > 0) this.size = /** @type {[number, number, number]} */ (high.map((one, axis) => one - this.low[axis] + 1));
    /** Labels that there are. */
    this.there = [...new Set(cellLabels)];
    this.labels = new Uint8Array(this.size[0] * this.size[1] * this.size[2]);
    for (let cell = 0; cell < cellCount; cell++) {
      const [i, j, k] = [cells[3 * cell], cells[3 * cell + 1], cells[3 * cell + 2]];
      this.labels[((k - this.low[2]) * this.size[1] + j - this.low[1]) * this.size[0] + i - this.low[0]] = cellLabels[cell];
      for (let corner = 0; corner < 8; corner++) {
        const node = 3 * cellCorners[8 * cell + corner];
        this.rest[node] = i + (corner & 1) - 0.5;
        this.rest[node + 1] = j + ((corner >> 1) & 1) - 0.5;
        this.rest[node + 2] = k + (corner >> 2) - 0.5;
      }
    }
  }

  /**
   * Work out `corners` and `count` for a plane.
   * @param {Float32Array} displacement of each node [cells, grid axes], and its stretch: four numbers each
   * @param {readonly [number, number, number, number]} equation of the plane: unit normal, place along it, LPS mm
   */
  cut(displacement, equation) {
    const { rest, side, cellCorners } = this;
    const { origin_mm: origin, direction, cell_mm: cell } = this.place;
    const [nx, ny, nz, at] = equation;
    // the plane along the grid's axes
    const a = cell * (nx * direction[0][0] + ny * direction[1][0] + nz * direction[2][0]);
    const b = cell * (nx * direction[0][1] + ny * direction[1][1] + nz * direction[2][1]);
    const c = cell * (nx * direction[0][2] + ny * direction[1][2] + nz * direction[2][2]);
    const start = nx * origin[0] + ny * origin[1] + nz * origin[2] - at;
    for (let node = 0, three = 0, four = 0; node < side.length; node++, three += 3, four += 4) {
      side[node] = start + a * (rest[three] + displacement[four]) + b * (rest[three + 1] + displacement[four + 1])
        + c * (rest[three + 2] + displacement[four + 2]);
    }
    this.count = 0;
    for (let first = 0; first < cellCorners.length; first += 8) {
      let beyond = 0;
      for (let corner = 0; corner < 8; corner++) beyond += side[cellCorners[first + corner]] > 0 ? 1 : 0;
      if (beyond === 0 || beyond === 8) continue;
      for (const tetrahedron of TETRAHEDRA) this.#cutOne(displacement, first, tetrahedron);
    }
  }

  /** @param {Float32Array} displacement @param {number} first of the cell's corners @param {readonly number[]} tetrahedron */
  #cutOne(displacement, first, tetrahedron) {
    const { side, cellCorners } = this;
    /** @type {number[]} */
    const beyond = [];
    /** @type {number[]} */
    const before = [];
    for (const corner of tetrahedron) {
      const node = cellCorners[first + corner];
      (side[node] > 0 ? beyond : before).push(node);
    }
    if (beyond.length === 0 || before.length === 0) return;
    if (3 * STRIDE * 2 + STRIDE * this.count > this.corners.length) {
      const more = new Float32Array(2 * this.corners.length);
      more.set(this.corners);
      this.corners = more;
    }
    if (beyond.length === 2) {
      // a quadrilateral, around: two triangles
      const [[p, q], [r, s]] = [beyond, before];
      for (const [one, other] of [[p, r], [p, s], [q, s], [p, r], [q, s], [q, r]]) this.#corner(displacement, one, other);
      return;
    }
    const [alone, others] = beyond.length === 1 ? [beyond[0], before] : [before[0], beyond];
    for (const other of others) this.#corner(displacement, alone, other);
  }

  /** Where the plane cuts the way between two nodes. @param {Float32Array} displacement @param {number} one @param {number} other */
  #corner(displacement, one, other) {
    const { rest, side, corners } = this;
    const { origin_mm: origin, direction, cell_mm: cell } = this.place;
    const t = side[one] / (side[one] - side[other]);
    const to = STRIDE * this.count;
    const moved = [0, 0, 0];
    for (let axis = 0; axis < 3; axis++) {
      const resting = rest[3 * one + axis] + t * (rest[3 * other + axis] - rest[3 * one + axis]);
      const way = displacement[4 * one + axis] + t * (displacement[4 * other + axis] - displacement[4 * one + axis]);
      corners[to + 3 + axis] = resting;
      moved[axis] = resting + way;
    }
    for (let axis = 0; axis < 3; axis++) {
      const row = direction[axis];
      corners[to + axis] = origin[axis] + cell * (row[0] * moved[0] + row[1] * moved[1] + row[2] * moved[2]);
    }
    corners[to + 6] = displacement[4 * one + 3] + t * (displacement[4 * other + 3] - displacement[4 * one + 3]);
    this.count += 1;
  }
}
