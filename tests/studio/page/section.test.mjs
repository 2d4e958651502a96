// A cut plane: where it goes, and the cells that it cuts.
import assert from "node:assert/strict";
import { test } from "node:test";

import { CutPlane } from "../../../heartcase/studio/page/section/plane.js";
import { STRIDE, Tissue } from "../../../heartcase/studio/page/section/tissue.js";

const PLACE = { origin_mm: [10, -20, 30], direction: [[0, -1, 0], [1, 0, 0], [0, 0, 1]], cell_mm: 3 };

/** A block of cells with nodes of its own, each cell a label by its i. */
function block(ni, nj, nk) {
  const cells = [];
  const corners = [];
  const labels = [];
  const number = (i, j, k) => (k * (nj + 1) + j) * (ni + 1) + i;
  for (let k = 0; k < nk; k++) {
    for (let j = 0; j < nj; j++) {
      for (let i = 0; i < ni; i++) {
        cells.push(i, j, k);
        labels.push(i + 1);
        for (let c = 0; c < 8; c++) corners.push(number(i + (c & 1), j + ((c >> 1) & 1), k + (c >> 2)));
      }
    }
  }
  const count = (ni + 1) * (nj + 1) * (nk + 1);
  return { tissue: new Tissue(Int16Array.from(cells), Uint32Array.from(corners), Uint8Array.from(labels), count, PLACE), count };
}

const corner = (tissue, n) => [...tissue.corners.subarray(STRIDE * n, STRIDE * n + STRIDE)];

function area(tissue) {
  let sum = 0;
  for (let n = 0; n < tissue.count; n += 3) {
    const [a, b, c] = [corner(tissue, n), corner(tissue, n + 1), corner(tissue, n + 2)];
    const [u, v] = [b, c].map((one) => [0, 1, 2].map((axis) => one[axis] - a[axis]));
    sum += Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]) / 2;
  }
  return sum;
}

const equation = (normal, point) => [...normal, normal.reduce((sum, one, axis) => sum + one * point[axis], 0)];

test("cells are cut where the plane is, whole and without overlap", () => {
  const { tissue, count } = block(4, 3, 2);
  // the grid's i goes along y, its j against x: the block is 12 mm along y, 9 along x, 6 along z, around this middle
  const middle = [10 - 3, -20 + 4.5, 30 + 1.5];
  for (const [normal, expected] of [[[1, 0, 0], 12 * 6], [[0, 1, 0], 9 * 6], [[0, 0, 1], 12 * 9], [[0, Math.SQRT1_2, Math.SQRT1_2], 9 * 6 * Math.SQRT2]]) {
    tissue.cut(new Float32Array(4 * count), equation(normal, middle.map((one) => one + 0.3)));
    assert.ok(Math.abs(area(tissue) - expected) < 1e-3 * expected, `${normal}: ${area(tissue)}`);
    for (let n = 0; n < tissue.count; n++) {
      const [x, y, z, i, j, k] = corner(tissue, n);
      assert.ok(Math.abs(equation(normal, [x, y, z])[3] - equation(normal, middle.map((one) => one + 0.3))[3]) < 1e-4);
      // at rest a place is where the grid's geometry has it
      assert.ok(Math.hypot(x - (10 - 3 * j), y - (-20 + 3 * i), z - (30 + 3 * k)) < 1e-4);
    }
  }
});

test("tissue that moved is cut where it is, and keeps the place that it has at rest", () => {
  const { tissue, count } = block(4, 3, 2);
  const moved = new Float32Array(4 * count);
  for (let node = 0; node < count; node++) moved.set([0, 0, 2, 0.25], 4 * node);
  tissue.cut(moved, equation([0, 0, 1], [0, 0, 30 + 1.5 + 6]));
  assert.ok(Math.abs(area(tissue) - 12 * 9) < 0.1);
  for (let n = 0; n < tissue.count; n++) {
    assert.ok(Math.abs(corner(tissue, n)[5] - 0.5) < 1e-5);
    assert.ok(Math.abs(corner(tissue, n)[6] - 0.25) < 1e-6);
  }
  tissue.cut(moved, equation([0, 0, 1], [0, 0, 30]));
  assert.equal(tissue.count, 0);
});

test("labels lie in a box of the cells", () => {
  const { tissue } = block(4, 3, 2);
  assert.deepEqual(tissue.size, [4, 3, 2]);
  assert.deepEqual([...tissue.labels.subarray(0, 8)], [1, 2, 3, 4, 1, 2, 3, 4]);
  assert.deepEqual(tissue.there, [1, 2, 3, 4]);
});

test("a plane stays in its box, and tells", () => {
  const plane = new CutPlane();
  let told = 0;
  plane.listen(() => (told += 1));
  plane.setBox([0, 0, 0], [10, 20, 30]);
  plane.put([0, 0, 2]);
  plane.show(true);
  assert.deepEqual(plane.equation, [0, 0, 1, 15]);
  plane.move(100);
  assert.deepEqual(plane.equation, [0, 0, 1, 30]);
  plane.move(-7);
  assert.equal(plane.depth, 8);
  plane.flip();
  assert.deepEqual(plane.equation.map(Math.abs), [0, 0, 1, 23]);
  plane.turn([1, 0, 0], Math.PI / 2);
  assert.ok(Math.abs(plane.normal[1] - 1) < 1e-12);
  plane.show(false);
  assert.deepEqual(plane.equation, [0, 0, 0, 1]);
  assert.equal(told, 8);
});
