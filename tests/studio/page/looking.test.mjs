// Sides of the patient, and planes that open the heart.

import assert from "node:assert/strict";
import test from "node:test";
import { cross, dot } from "../../../heartcase/studio/page/operating/camera.js";
import { axesFacing, planeAt } from "../../../heartcase/studio/page/offline/cutting.js";
import { lettersOf, SIDES, sidesOf } from "../../../heartcase/studio/page/offline/looking.js";

const near = (a, b) => a.every((one, n) => Math.abs(one - b[n]) < 1e-9);

test("sides are right-handed views from where they say", () => {
  for (const [side, [right, up, towards]] of Object.entries(SIDES)) {
    assert.ok(near(cross(up, towards), right), side);
    assert.deepEqual(sidesOf(towards), [side]);
    assert.ok(axesFacing(towards, up).every((axis, n) => near(axis, [right, up, towards][n])), side);
  }
});

test("a direction is told by the sides that it leads to, the strongest first", () => {
  assert.equal(lettersOf([0, -1, 0]), "A");
  assert.equal(lettersOf([0, 0, 5]), "S");
  assert.deepEqual(sidesOf([1, -2, 0]), ["front", "left"]);
  assert.deepEqual(sidesOf([0.1, -2, 0]), ["front"]);
});

test("a plane takes nothing, goes through its point, takes all", () => {
  const box = /** @type {const} */ ([[-10, 0, 0], [10, 20, 40]]);
  for (const normal of [[1, 0, 0], [0, -1, 0], [0.6, 0, 0.8], [-0.36, 0.48, -0.8]]) {
    const corners = [0, 1].flatMap((x) => [0, 1].flatMap((y) => [0, 1].map((z) => dot(normal, [box[x][0], box[y][1], box[z][2]]))));
    const point = [1, 7, 12];
    const at = (depth) => planeAt(normal, point, box, depth);
    assert.ok(Math.abs(at(0) - Math.max(...corners)) < 1e-9);
    assert.ok(Math.abs(at(50) - dot(normal, point)) < 1e-9);
    assert.ok(Math.abs(at(100) - Math.min(...corners)) < 1e-9);
    const all = [0, 10, 25, 49, 50, 51, 80, 100].map(at);
    assert.deepEqual(all, [...all].sort((a, b) => b - a));
  }
});
