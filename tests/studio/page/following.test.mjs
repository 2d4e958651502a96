// Points that go with the tissue: with a displacement that is linear in place they go exactly there.
import assert from "node:assert/strict";
import { test } from "node:test";

import { Following } from "../../../heartcase/studio/page/offline/following.js";

const PLACE = { origin_mm: [0, 0, 0], direction: [[0, -1, 0], [1, 0, 0], [0, 0, 1]], cell_mm: 2 };

test("a point goes where the tissue of its cell goes", () => {
  // two cells side by side along i, their nodes at half numbers
  const node = (i, j, k) => (k * 2 + j) * 3 + i;
  const corners = [];
  for (const first of [0, 1]) for (let c = 0; c < 8; c++) corners.push(node(first + (c & 1), (c >> 1) & 1, c >> 2));
  const displacement = new Float32Array(4 * 12);
  const moved = ([i, j, k]) => [0.1 * i - 0.2 * k, 0.3 * j, 0.05 * i + 0.1];
  for (let k = 0; k < 2; k++) for (let j = 0; j < 2; j++) for (let i = 0; i < 3; i++) displacement.set([...moved([i - 0.5, j - 0.5, k - 0.5]), 9], 4 * node(i, j, k));
  const local = [[0.25, 0.5, 1], [0.75, 0, 0.125]];
  const following = new Following(Float32Array.from([1, 2, 3, 4, 5, 6]), Uint32Array.from([0, 1]), Float32Array.from(local.flat()));
  following.follow(displacement, Uint32Array.from(corners), PLACE);
  local.forEach(([i, j, k], n) => {
    const [a, b, c] = moved([n + i - 0.5, j - 0.5, k - 0.5]);
    const wanted = [1 + 3 * n - 2 * b, 2 + 3 * n + 2 * a, 3 + 3 * n + 2 * c];
    wanted.forEach((one, axis) => assert.ok(Math.abs(following.places[3 * n + axis] - one) < 1e-5));
  });
});

test("at rest they are where they were", () => {
  const following = new Following(Float32Array.from([1, 2, 3]), Uint32Array.from([0]), Float32Array.from([0.5, 0.5, 0.5]));
  following.follow(new Float32Array(4 * 8), Uint32Array.from([0, 1, 2, 3, 4, 5, 6, 7]), PLACE);
  assert.deepEqual([...following.places], [1, 2, 3]);
});
