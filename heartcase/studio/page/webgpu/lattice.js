/** A case's lattice of springs as the page has it: what `heartcase export --web` writes, and what follows from it. */

/** Vectors of a spring from its lower to its higher node, in the order of the rows. */
export const DIRECTIONS = /** @type {const} */ ([
  [1, 0, 0], [-1, 1, 0], [0, 1, 0], [1, 1, 0], [0, -1, 1], [-1, 0, 1], [0, 0, 1], [1, 0, 1], [0, 1, 1],
]);
const NONE = 0xffffffff;
/** Longest way along springs over the straight way, in an uncut lattice. */
const DETOUR = Math.sqrt(1.5);

/**
 * Arrays of a lattice, in grid units: cells, the mass of a full cell, k of the stiffest tissue.
 * @typedef {object} LatticeArrays
 * @property {Int16Array} nodeIndex rest position of each node [cells], 3 a node
 * @property {Float32Array} inverseMass zero where a node is fixed
 * @property {Int32Array} higher node at the higher end of each node's spring, 9 rows of node count; -1 for none
 * @property {Float32Array} weight its stiffness, as `higher`
 * @property {Int32Array} cellCorners 8 nodes a cell
 * @property {Float32Array} guardScale stiffness with which each cell's corners push back
 * @property {{stepS: number, timeS: number, dampingPerS: number, shear: number, cornerFloor: number, cellMm: number, forceN: number}} facts
 */

export class Lattice {
  /** @param {LatticeArrays} arrays */
  constructor(arrays) {
    this.arrays = arrays;
    this.nodeCount = arrays.inverseMass.length;
    this.cellCount = arrays.guardScale.length;
  }

  /** Rest positions [cells] and inverse mass, 4 a node. */
  restPlaces() {
    const { nodeIndex, inverseMass } = this.arrays;
    const places = new Float32Array(4 * this.nodeCount);
    for (let node = 0; node < this.nodeCount; node++) {
      for (let axis = 0; axis < 3; axis++) places[4 * node + axis] = nodeIndex[3 * node + axis];
      places[4 * node + 3] = inverseMass[node];
    }
    return places;
  }

  /** For each node 18 rows: the node at the other end, and the stiffness's bits; all ones where there is no spring. */
  springRows() {
    const { higher, weight } = this.arrays;
    const count = this.nodeCount;
    const rows = new Uint32Array(2 * 18 * count).fill(NONE);
    const bits = new Uint32Array(weight.buffer, weight.byteOffset, weight.length);
    for (let row = 0; row < 9; row++) {
      for (let node = 0; node < count; node++) {
        const other = higher[row * count + node];
        if (other < 0) continue;
        const up = 2 * (row * count + node);
        const down = 2 * ((9 + row) * count + other);
        rows[up] = other;
        rows[down] = node;
        rows[up + 1] = rows[down + 1] = bits[row * count + node];
      }
    }
    return rows;
  }

  /** The cells' corners, 8 a cell; then 8 a node: where among these it is, all ones for none. */
  cornerTable() {
    const { cellCorners } = this.arrays;
    const first = 8 * this.cellCount;
    const table = new Uint32Array(first + 8 * this.nodeCount).fill(NONE);
    const filled = new Uint8Array(this.nodeCount);
    for (let corner = 0; corner < first; corner++) {
      const node = cellCorners[corner];
      table[corner] = node;
      table[first + 8 * node + filled[node]++] = corner;
    }
    return table;
  }

  /**
   * Free nodes in a ball that are reached along springs in it from the one nearest its centre, as a hand holds them.
   * @param {Float32Array} displacement 4 a node [cells]
   * @param {readonly number[]} centre [cells]
   * @param {number} radius [cells]
   * @returns {number[]} none where there is no tissue in the ball
   */
  inReach(displacement, centre, radius) {
    const { nodeIndex, inverseMass, higher } = this.arrays;
    /** @type {Map<number, number>} */
    const inside = new Map();
    let nearest = -1;
    for (let node = 0; node < this.nodeCount; node++) {
      let square = 0;
      for (let axis = 0; axis < 3; axis++) square += (nodeIndex[3 * node + axis] + displacement[4 * node + axis] - centre[axis]) ** 2;
      if (square > radius * radius) continue;
      inside.set(node, Math.sqrt(square));
      if (nearest < 0 || square < /** @type {number} */ (inside.get(nearest)) ** 2) nearest = node;
    }
    if (nearest < 0) return [];
    const reach = DETOUR * (radius + /** @type {number} */ (inside.get(nearest))) + 1;
    /** @type {Map<number, [number, number][]>} */
    const beside = new Map([...inside.keys()].map((node) => [node, []]));
    for (const node of inside.keys()) {
      for (let row = 0; row < 9; row++) {
        const other = higher[row * this.nodeCount + node];
        if (other < 0 || !inside.has(other)) continue;
        const length = Math.hypot(...DIRECTIONS[row]);
        beside.get(node)?.push([other, length]);
        beside.get(other)?.push([node, length]);
      }
    }
    const way = new Map([[nearest, 0]]);
    const open = new Set([nearest]);
    // Few nodes, so a list is searched instead of a heap kept.
    while (open.size > 0) {
      const node = [...open].reduce((best, one) => (/** @type {number} */ (way.get(one)) < /** @type {number} */ (way.get(best)) ? one : best));
      open.delete(node);
      for (const [other, length] of beside.get(node) ?? []) {
        const there = /** @type {number} */ (way.get(node)) + length;
        if (there <= reach && there < (way.get(other) ?? Infinity)) {
          way.set(other, there);
          open.add(other);
        }
      }
    }
    return [...way.keys()].filter((node) => inverseMass[node] > 0).sort((a, b) => a - b);
  }

  /**
   * Force of the springs on some nodes together [grid units], in double precision.
   * @param {Float32Array} displacement 4 a node [cells]
   * @param {readonly number[]} nodes
   * @returns {[number, number, number]}
   */
  forceOn(displacement, nodes) {
    const { higher, weight, facts } = this.arrays;
    const isHeld = new Uint8Array(this.nodeCount);
    for (const node of nodes) isHeld[node] = 1;
    /** @type {[number, number, number]} */
    const force = [0, 0, 0];
    for (let row = 0; row < 9; row++) {
      const rest = DIRECTIONS[row];
      const restLength = Math.hypot(...rest);
      for (let node = 0; node < this.nodeCount; node++) {
        const other = higher[row * this.nodeCount + node];
        if (other < 0 || isHeld[node] === isHeld[other]) continue;
        const d = rest.map((value, axis) => value + displacement[4 * other + axis] - displacement[4 * node + axis]);
        const length = Math.hypot(...d);
        if (length === 0) continue;
        const pull = ((isHeld[node] ? 1 : -1) * facts.shear * weight[row * this.nodeCount + node] * (length - restLength)) / length;
        for (let axis = 0; axis < 3; axis++) force[axis] += pull * d[axis];
      }
    }
    return force;
  }
}
