// Sides of the patient.

import assert from "node:assert/strict";
import test from "node:test";
import { cross } from "../../../heartcase/studio/page/operating/camera.js";
import { SIDES } from "../../../heartcase/studio/page/offline/looking.js";
import { lettersOf, sidesOf } from "../../../heartcase/studio/page/operating/orientation.js";

const near = (a, b) => a.every((one, n) => Math.abs(one - b[n]) < 1e-9);

test("sides are right-handed views from where they say", () => {
  for (const [side, [right, up, towards]] of Object.entries(SIDES)) {
    assert.ok(near(cross(up, towards), right), side);
    assert.deepEqual(sidesOf(towards), [side]);
  }
});

test("a direction is told by the sides that it leads to, the strongest first", () => {
  assert.equal(lettersOf([0, -1, 0]), "A");
  assert.equal(lettersOf([0, 0, 5]), "H");
  assert.deepEqual(sidesOf([1, -2, 0]), ["front", "left"]);
  assert.deepEqual(sidesOf([0.1, -2, 0]), ["front"]);
});
