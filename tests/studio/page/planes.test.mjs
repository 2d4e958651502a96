/** Planes of the slices: turned about one another, the lines and handles that show them, and the heart's own. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { dot, PATIENT_FRAMES } from "../../../heartcase/studio/page/shared/geometry.js";
import {
  handlesOf, heartPlanes, isOnHandle, lacking, lineOf, PATIENT_PLANES, turned, turnedPlanes, VIEWS,
} from "../../../heartcase/studio/page/painting/pictures/planes.js";

const RIGHT_ANGLE = Math.PI / 2;

/** @param {readonly number[]} found @param {readonly number[]} wanted */
function near(found, wanted, tolerance = 1e-9) {
  found.forEach((value, n) => assert.ok(Math.abs(value - wanted[n]) <= tolerance, `${found} is not ${wanted}`));
}

test("other planes are seen as lines: level and upright in the patient's", () => {
  for (const view of VIEWS) {
    const lines = VIEWS.filter((other) => other !== view).map((other) => lineOf(PATIENT_FRAMES[view], PATIENT_FRAMES[other]));
    assert.deepEqual(lines.map(([x, y]) => [Math.abs(x), Math.abs(y)]).sort(), [[0, 1], [1, 0]]);
    assert.equal(lineOf(PATIENT_FRAMES[view], PATIENT_FRAMES[view]), null);
  }
});

test("a turn goes from right to below, and leaves what lies across alone", () => {
  const { right, down, normal } = PATIENT_FRAMES.coronal;
  near(turned(right, PATIENT_FRAMES.coronal, RIGHT_ANGLE), down);
  near(turned(down, PATIENT_FRAMES.coronal, RIGHT_ANGLE), right.map((x) => -x));
  near(turned(normal, PATIENT_FRAMES.coronal, 0.3), normal);
});

test("the other planes turn, and their lines follow the pointer's angle", () => {
  const angle = 0.4;
  for (const view of VIEWS) {
    const after = turnedPlanes(PATIENT_PLANES, view, angle);
    assert.equal(after.name, "turned");
    assert.deepEqual(after.frames[view], PATIENT_FRAMES[view]);
    assert.deepEqual([...after.turned].sort(), VIEWS.filter((one) => one !== view).sort());
    for (const other of VIEWS.filter((one) => one !== view)) {
      const [x, y] = lineOf(PATIENT_FRAMES[view], PATIENT_FRAMES[other]);
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      near(lineOf(after.frames[view], after.frames[other]), [c * x - s * y, s * x + c * y]);
    }
  }
});

test("a thousand turns leave right angles and unit lengths", () => {
  let planes = PATIENT_PLANES;
  for (let n = 0; n < 1000; n++) planes = turnedPlanes(planes, VIEWS[n % 3], 0.37 * ((n % 7) - 3));
  for (const view of VIEWS) {
    const { right, down, normal } = planes.frames[view];
    near([dot(right, right), dot(down, down), dot(normal, normal)], [1, 1, 1], 1e-12);
    near([dot(right, down), dot(right, normal), dot(down, normal)], [0, 0, 0], 1e-12);
    // and the three stay at right angles to one another
    for (const other of VIEWS) if (other !== view) near([dot(normal, planes.frames[other].normal)], [0], 1e-9);
  }
  // back by the same turns in the opposite order
  for (let n = 999; n >= 0; n--) planes = turnedPlanes(planes, VIEWS[n % 3], -0.37 * ((n % 7) - 3));
  for (const view of VIEWS) near(planes.frames[view].normal, PATIENT_FRAMES[view].normal, 1e-9);
});

test("handles lie on the lines, inside the picture, and small pictures have none", () => {
  const cross = { x: 100, y: 150 };
  const handles = handlesOf(PATIENT_PLANES, "axial", { width: 400, height: 300 }, cross);
  assert.equal(handles.length, 3);
  for (const { x, y } of handles) assert.ok(x === cross.x || y === cross.y);
  assert.ok(isOnHandle(handles, { x: handles[0].x + 9, y: handles[0].y - 9 }));
  assert.ok(!isOnHandle(handles, cross));
  assert.deepEqual(handlesOf(PATIENT_PLANES, "axial", { width: 149, height: 300 }, cross), []);
});

test("the heart's planes are taken as far as they are known, and what lacks is named", () => {
  const frame = PATIENT_FRAMES.sagittal;
  const found = { planes: { short_axis: frame }, missing: { four_chamber: ["right atrium"], two_chamber: ["right atrium"] }, centre_mm: null };
  const planes = heartPlanes("heart", found);
  assert.deepEqual(planes.titles, { axial: "axial", coronal: "short_axis", sagittal: "sagittal" });
  assert.deepEqual(planes.frames, { ...PATIENT_FRAMES, coronal: frame });
  assert.deepEqual(lacking("heart", found), [
    { plane: "four_chamber", structures: ["right atrium"] }, { plane: "two_chamber", structures: ["right atrium"] },
  ]);
  assert.equal(heartPlanes("heart", { planes: {}, missing: {}, centre_mm: null }), null);
});
