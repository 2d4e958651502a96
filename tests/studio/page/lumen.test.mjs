// The width of a vessel in a disc's plane, against circles and ellipses.

import assert from "node:assert/strict";
import test from "node:test";
import { lumenOf } from "../../../heartcase/studio/page/shaping/lumen.js";

/** A straight tube along z with an elliptic section. @param {number} a @param {number} b @param {number} x */
const tube = (a, b = a, x = 0) => (/** @type {readonly number[]} */ mm) => ((mm[0] - x) / a) ** 2 + (mm[1] / b) ** 2 <= 1;

test("the width of a round lumen is its own, however wide the disc", () => {
  for (const radius of [7, 10, 20]) {
    const found = lumenOf({ centre: [0.4, -0.3, 5], axis: [0, 0, -3], radius }, tube(6), 0.25);
    assert.ok(Math.abs(found.mm - 12) < 0.25, `${found.mm}`);
    assert.equal(found.isCut, false);
  }
});

test("an oblique disc sees the section that it crosses, as a circle of the same area", () => {
  const tilt = Math.PI / 6;
  const found = lumenOf({ centre: [0, 0, 0], axis: [Math.sin(tilt), 0, Math.cos(tilt)], radius: 9 }, tube(5), 0.2);
  assert.ok(Math.abs(found.mm - 10 / Math.sqrt(Math.cos(tilt))) < 0.2, `${found.mm}`);
  const oval = lumenOf({ centre: [0, 0, 0], axis: [0, 0, 1], radius: 9 }, tube(8, 2), 0.2);
  assert.ok(Math.abs(oval.mm - 8) < 0.2, `${oval.mm}`);
});

test("only the piece at its centre counts, a disc that is too narrow says so, and one beside the vessel nothing", () => {
  const two = (/** @type {readonly number[]} */ mm) => tube(3)(mm) || tube(3, 3, 8)(mm);
  const found = lumenOf({ centre: [0.5, 0, 0], axis: [0, 0, 1], radius: 12 }, two, 0.2);
  assert.ok(Math.abs(found.mm - 6) < 0.2, `${found.mm}`);
  assert.equal(lumenOf({ centre: [0, 0, 0], axis: [0, 0, 1], radius: 4 }, tube(6), 0.2).isCut, true);
  assert.equal(lumenOf({ centre: [30, 0, 0], axis: [0, 0, 1], radius: 4 }, tube(6), 0.2), null);
});
