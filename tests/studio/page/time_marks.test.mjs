import assert from "node:assert/strict";
import { test } from "node:test";

import { marksOf } from "../../../heartcase/studio/page/offline/time_marks.js";

/** A moment of a recording as a page is told of it. */
const moment = (step, marks) => [
  { header: { kind: "topology" } },
  { header: { kind: "frame", step, time_s: step / 1000, ...(marks ? { marks } : {}) } },
];

test("cuts, patches and stitches are marked at the first moment that has them", () => {
  const marks = [[0, "cut"], [1500, "patch"], [2000, "cut"], [2001, "stitch"]];
  const moments = [moment(0, marks), moment(1000), moment(2000), moment(3000)];
  assert.deepEqual(marksOf(moments), [
    { at: 0, kind: "cut", time: 0 },
    { at: 2, kind: "patch", time: 2 },
    { at: 2, kind: "cut", time: 2 },
    { at: 3, kind: "stitch", time: 3 },
  ]);
});

test("what is done after the last moment is marked there, and what was told last holds", () => {
  const moments = [moment(0, [[5, "cut"]]), moment(1000, [[5, "cut"], [4000, "stitch"]])];
  assert.deepEqual(marksOf(moments).map(({ at, kind }) => [at, kind]), [[1, "cut"], [1, "stitch"]]);
});

test("a recording of nothing has no marks", () => {
  assert.deepEqual(marksOf([]), []);
  assert.deepEqual(marksOf([moment(0), [{ header: { kind: "topology" } }]]), []);
});
