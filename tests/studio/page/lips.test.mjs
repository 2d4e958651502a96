import assert from "node:assert/strict";
import { test } from "node:test";

import { lipEdges } from "../../../heartcase/studio/page/operating/heart.js";

const FACES = 256;
/** A square of skin of two triangles, and a cut face that hangs from one of its sides. */
const arrays = {
  rest_mm: Float32Array.from([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, /* the face's own */ 1, 0, 0, 1, 1, 0, 1, 0.5, -1]),
  structure: Uint16Array.from([3, 3, 3, 3, FACES, FACES, FACES]),
  triangles: Uint32Array.from([0, 1, 2, 0, 2, 3, 4, 6, 5]),
};

test("the edge at which a cut face begins is found on the skin", () => {
  assert.deepEqual(lipEdges(arrays, FACES), [1, 2]);
});

test("where nothing is cut there is none", () => {
  assert.deepEqual(lipEdges({ ...arrays, structure: new Uint16Array(7).fill(3) }, FACES), []);
});
