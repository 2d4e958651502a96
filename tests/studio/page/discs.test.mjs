// Discs in slices, against what was worked out by hand.

import assert from "node:assert/strict";
import test from "node:test";
import { PATIENT_FRAMES } from "../../../heartcase/studio/page/shared/geometry.js";
import * as discs from "../../../heartcase/studio/page/shaping/discs.js";

const { axial, coronal, sagittal } = PATIENT_FRAMES;
const NEAR = 1e-9;

/** @param {readonly number[]} found @param {readonly number[]} wanted */
function near(found, wanted) {
  assert.equal(found.length, wanted.length);
  found.forEach((value, n) => assert.ok(Math.abs(value - wanted[n]) <= NEAR, `${found} is not ${wanted}`));
}

test("a slice cuts a disc in a line, shorter away from its middle, and passes by beyond its rim", () => {
  const disc = { centre: /** @type {const} */ ([10, 20, 30]), axis: /** @type {const} */ ([2, 0, 0]), radius: 5 };
  const cut = discs.cutOf(disc, axial, [0, 0, 33], 1);
  assert.equal(cut.kind, "line");
  const ends = cut.ends.toSorted((a, b) => a[1] - b[1]);
  near(ends[0], [10, 16, 33]);
  near(ends[1], [10, 24, 33]);
  assert.equal(discs.cutOf(disc, axial, [0, 0, 35.1], 1), null);
  // in the sagittal slice it lies flat, and is seen there alone
  assert.deepEqual(discs.cutOf(disc, sagittal, [10.4, 0, 0], 1), { kind: "circle" });
  assert.equal(discs.cutOf(disc, sagittal, [10.6, 0, 0], 1), null);
});

test("a slice that is oblique to a disc cuts it where both planes meet", () => {
  const disc = { centre: [0, 0, 0], axis: discs.unit([1, 0, 1]), radius: 2 };
  const { ends } = discs.cutOf(disc, axial, [0, 0, 1], 1);
  for (const end of ends) {
    assert.ok(Math.abs(end[2] - 1) < NEAR);
    assert.ok(Math.abs(end[0] + end[2]) < NEAR);
    assert.ok(Math.abs(Math.hypot(...end) - 2) < NEAR);
  }
});

test("a drag across a vessel makes the disc that is seen as this line", () => {
  const disc = discs.discAcross([1, 2, 3], [1, 6, 3], axial);
  assert.equal(disc.radius, 4);
  near(disc.axis.map(Math.abs), [1, 0, 0]);
  const { ends } = discs.cutOf(disc, axial, [0, 0, 3], 1);
  assert.ok(ends.some((end) => Math.hypot(end[0] - 1, end[1] - 6, end[2] - 3) < NEAR));
});

test("a rim that is pulled turns the disc about the slice alone, and sizes it", () => {
  const disc = { centre: [0, 0, 0], axis: discs.unit([1, 0, 0.5]), radius: 5 };
  const pulled = discs.pulled(disc, [0, 5, 0], [-5, 5, 0], axial);
  assert.ok(Math.abs(pulled.radius - Math.hypot(5, 5)) < NEAR);
  // by 45 degrees about z; what it leans towards the head stays
  near(pulled.axis, discs.unit([Math.SQRT1_2, Math.SQRT1_2, 0.5]));
  // one that lies in the slice is sized only
  const flat = { centre: [0, 0, 0], axis: [0, 1, 0], radius: 5 };
  assert.deepEqual(discs.pulled(flat, [5, 0, 0], [0, 0, 7], coronal), { ...flat, radius: 7 });
});

test("the rim lies around the centre, at right angles to the axis", () => {
  const disc = { centre: [1, 2, 3], axis: [1, -2, 0.5], radius: 3 };
  for (const point of discs.rimOf(disc, 7)) {
    const from = point.map((value, n) => value - disc.centre[n]);
    assert.ok(Math.abs(Math.hypot(...from) - 3) < NEAR);
    assert.ok(Math.abs(from.reduce((sum, value, n) => sum + value * disc.axis[n], 0)) < NEAR);
  }
});

test("numbers are written as a person would, and lines keep their ends", () => {
  assert.deepEqual(discs.rounded([1.26, -0.04, 7], 1), [1.3, 0, 7]);
  assert.ok(Object.is(discs.rounded([-0.04, 0, 0], 1)[0], 0));
  const line = Array.from({ length: 11 }, (_, n) => [n / 2, 0, 0]);
  assert.deepEqual(discs.thinned(line, 2), [[0, 0, 0], [2, 0, 0], [4, 0, 0], [5, 0, 0]]);
  assert.deepEqual(discs.thinned([[1, 1, 1]], 2), [[1, 1, 1]]);
});
