import assert from "node:assert/strict";
import { test } from "node:test";

import { marksOf } from "../../../heartcase/studio/page/offline/time_marks.js";

/** A moment of a recording as a page is told of it. */
const moment = (time_s, cut_count, patches, stitches) => [
  { header: { kind: "topology" } },
  { header: { kind: "frame", time_s, cut_count, patches: Array(patches).fill({}), stitches: Array(stitches).fill({}) } },
];

test("cuts, patches and stitches are marked where they were made", () => {
  const moments = [[0, 0, 0, 0], [1, 1, 0, 0], [2, 1, 1, 0], [3, 2, 1, 1]].map((one) => moment(...one));
  assert.deepEqual(marksOf(moments), [
    { at: 1, kind: "cut", time: 1 },
    { at: 2, kind: "patch", time: 2 },
    { at: 3, kind: "cut", time: 3 },
    { at: 3, kind: "stitch", time: 3 },
  ]);
});

test("a row of stitches has one mark, and what is taken back none", () => {
  const moments = [[0, 0, 0, 0], [2, 0, 0, 1], [2.6, 0, 0, 2], [3.2, 0, 0, 3], [4, 0, 0, 1], [9, 0, 0, 2]].map((one) => moment(...one));
  assert.deepEqual(marksOf(moments).map(({ at, kind }) => [at, kind]), [[1, "stitch"], [5, "stitch"]]);
});

test("a recording of nothing has no marks", () => {
  assert.deepEqual(marksOf([]), []);
  assert.deepEqual(marksOf([moment(0, 0, 0, 0), [{ header: { kind: "topology" } }]]), []);
});
