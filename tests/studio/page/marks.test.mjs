import assert from "node:assert/strict";
import { test } from "node:test";

import { tornBefore } from "../../../heartcase/studio/page/offline/marks.js";

const rest = [0, 4, 8, 12, 16].map((x) => [x, 0, 0]);

test("a line that moves and is stretched a little is whole", () => {
  assert.deepEqual(tornBefore(rest, rest, false), new Set());
  assert.deepEqual(tornBefore(rest, rest.map(([x]) => [1.2 * x, 30, 0]), false), new Set());
});

test("pieces between points that went with different lips are left out", () => {
  const side = [0, 6, 6, -6, 0];
  assert.deepEqual(tornBefore(rest, rest.map(([x], n) => [x, side[n], 0]), false), new Set([1, 3, 4]));
});

test("the piece that closes a line is one of its pieces", () => {
  const square = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]];
  assert.deepEqual(tornBefore(square, square, true), new Set());
  assert.deepEqual(tornBefore(square, [[-6, 0, 0], ...square.slice(1)], true), new Set([0, 1]));
  assert.deepEqual(tornBefore(square, [[-6, 0, 0], ...square.slice(1)], false), new Set([1]));
});
