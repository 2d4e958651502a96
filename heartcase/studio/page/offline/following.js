/** Points that go with the tissue: each hangs on the corners of a cell. No browser. */

/** @typedef {{origin_mm: readonly number[], direction: readonly (readonly number[])[], cell_mm: number}} Place of the grid */

export class Following {
  /** Where the points are, LPS mm, three numbers each. @type {Float32Array} */
  places;

  /**
   * @param {Float32Array} at where they are at rest, LPS mm
   * @param {Uint32Array} cell of each
   * @param {Float32Array} local where in the cell, from its lowest corner [edges]
   */
  constructor(at, cell, local) {
    this.at = at;
    this.cell = cell;
    this.local = local;
    this.places = new Float32Array(at);
  }

  /**
   * Bring them to where the tissue is.
   * @param {Float32Array} displacement of each node [cells, grid axes], four numbers each
   * @param {Uint32Array} corners eight nodes of each cell: corner n lies at the bits of n along i, j, k
   * @param {Place} place
   */
  follow(displacement, corners, { direction, cell_mm: edge }) {
    const { at, cell, local, places } = this;
    for (let n = 0, three = 0; n < cell.length; n++, three += 3) {
      const moved = [0, 0, 0];
      for (let corner = 0; corner < 8; corner++) {
        let share = 1;
        for (let axis = 0; axis < 3; axis++) share *= (corner >> axis) & 1 ? local[three + axis] : 1 - local[three + axis];
        const node = 4 * corners[8 * cell[n] + corner];
        for (let axis = 0; axis < 3; axis++) moved[axis] += share * displacement[node + axis];
      }
      for (let axis = 0; axis < 3; axis++) {
        const row = direction[axis];
        places[three + axis] = at[three + axis] + edge * (row[0] * moved[0] + row[1] * moved[1] + row[2] * moved[2]);
      }
    }
  }
}

/** @param {Record<string, any>} arrays of a message */
export const followingOf = (arrays) => new Following(arrays.at_mm, arrays.cell, arrays.local);
