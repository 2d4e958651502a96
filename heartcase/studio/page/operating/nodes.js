/**
 * The nodes of the lattice as the page knows them: how far each has moved, and the approximate normals that curved parts of
 * the surface need. What the server sends are blocks of nodes that moved.
 */

/** Texels in a row of the textures that hold one node each. */
export const ROW = 256;
/** Shortest sum of unit vectors that gives a normal, as in the server's formula. */
const SUM_MIN = 0.1;

/** @typedef {{nodes: Int32Array, first: Int32Array, neighbours: Int32Array, offset: Float32Array}} Springs */

/** @param {number} count */
const rowsOf = (count) => Math.max(1, Math.ceil(count / ROW));

/** Approximate normals of nodes, as the curved parts of one surface need them. */
export class NodeNormals {
  /** Four numbers each. @type {Float32Array} */
  normals;

  /** @param {Springs} springs from which they are made */
  constructor(springs) {
    this.springs = springs;
    this.normals = new Float32Array(4 * ROW * rowsOf(springs.nodes.length));
  }

  /**
   * Work out those of which a node has moved: the sum of the unit vectors from the neighbours (eq. 9.3).
   * @param {Float32Array} u displacements of all nodes
   * @param {Uint8Array} moved whether each has moved
   */
  turn(u, moved) {
    const { nodes, first, neighbours, offset } = this.springs;
    const { normals } = this;
    for (let number = 0; number < nodes.length; number++) {
      const node = nodes[number];
      let isNear = moved[node];
      for (let spring = first[number]; spring < first[number + 1] && !isNear; spring++) isNear = moved[neighbours[spring]];
      if (!isNear) continue;
      let x = 0;
      let y = 0;
      let z = 0;
      for (let spring = first[number]; spring < first[number + 1]; spring++) {
        const other = 4 * neighbours[spring];
        const dx = offset[3 * spring] + u[4 * node] - u[other];
        const dy = offset[3 * spring + 1] + u[4 * node + 1] - u[other + 1];
        const dz = offset[3 * spring + 2] + u[4 * node + 2] - u[other + 2];
        const squared = dx * dx + dy * dy + dz * dz;
        const unit = squared > 0 ? 1 / Math.sqrt(squared) : 0;
        x += dx * unit;
        y += dy * unit;
        z += dz * unit;
      }
      const size = Math.sqrt(x * x + y * y + z * z);
      const unit = size >= SUM_MIN ? 1 / size : 0;
      normals[4 * number] = x * unit;
      normals[4 * number + 1] = y * unit;
      normals[4 * number + 2] = z * unit;
    }
  }
}

export class Nodes {
  /** Displacement of each node [cells, grid axes], and behind it its stretch from 0 to 1: four numbers each. @type {Float32Array} */
  displacement;
  /** Normal of each node of which the finest surface needs one, four numbers each. @type {Float32Array} */
  normals;
  /** Normals of all surfaces that are there. @type {NodeNormals[]} */
  #followers;

  /**
   * @param {number} count of nodes
   * @param {Springs} springs from which the finest surface's normals are made
   * @param {Nodes | null} [before] where the nodes were: they stay there until the server says otherwise
   */
  constructor(count, springs, before = null) {
    this.count = count;
    this.displacement = new Float32Array(4 * ROW * rowsOf(count));
    this.#followers = [new NodeNormals(springs)];
    this.normals = this.#followers[0].normals;
    this.moved = new Uint8Array(count);
    if (before !== null && before.count === count) this.displacement.set(before.displacement);
    this.moved.fill(1);
    this.turn();
  }

  /**
   * Take over blocks of nodes.
   * @param {Uint32Array} blocks numbers of the blocks
   * @param {Int16Array} steps displacement of their nodes, whole multiples of the scale, three numbers each
   * @param {number} scale [cells]
   * @param {number} size nodes in a block
   */
  take(blocks, steps, scale, size) {
    for (let n = 0; n < blocks.length; n++) {
      const start = blocks[n] * size;
      const end = Math.min(start + size, this.count);
      for (let node = start; node < end; node++) {
        const from = 3 * (n * size + node - start);
        for (let axis = 0; axis < 3; axis++) this.displacement[4 * node + axis] = steps[from + axis] * scale;
        this.moved[node] = 1;
      }
    }
    if (blocks.length > 0) this.turn();
  }

  /**
   * Take over where all nodes are.
   * @param {Float32Array} displacement [cells], four numbers each
   * @returns {number} largest way that a node went along an axis since the last time [cells]
   */
  takeAll(displacement) {
    let most = 0;
    for (let node = 0; node < this.count; node++) {
      for (let axis = 0; axis < 3; axis++) {
        const way = Math.abs(displacement[4 * node + axis] - this.displacement[4 * node + axis]);
        if (way === 0) continue;
        this.displacement[4 * node + axis] = displacement[4 * node + axis];
        this.moved[node] = 1;
        if (way > most) most = way;
      }
    }
    if (most > 0) this.turn();
    return most;
  }

  /** @param {Uint8Array} stretch of each node, 0 to 255 */
  takeStretch(stretch) {
    for (let node = 0; node < this.count; node++) this.displacement[4 * node + 3] = stretch[node] / 255;
  }

  /** Work out the normals of which a node has moved. */
  turn() {
    for (const one of this.#followers) one.turn(this.displacement, this.moved);
    this.moved.fill(0);
  }

  /**
   * Keep the normals of a further surface, too.
   * @param {Springs} springs from which they are made
   * @returns {NodeNormals}
   */
  follow(springs) {
    const one = new NodeNormals(springs);
    one.turn(this.displacement, new Uint8Array(this.count).fill(1));
    this.#followers.push(one);
    return one;
  }
}
