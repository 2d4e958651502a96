// Where voxels, millimetres and pixels of the studio's page lie, against values that were worked out by hand.

import assert from "node:assert/strict";
import test from "node:test";
import * as geometry from "../../../heartcase/studio/page/shared/geometry.js";

const { Camera, Lattice, PATIENT_FRAMES, orientationLetters, scanFrames } = geometry;
const NEAR = 1e-9;

/** @param {number[]} found @param {number[]} wanted */
function near(found, wanted, within = NEAR) {
  assert.equal(found.length, wanted.length);
  found.forEach((value, n) => assert.ok(Math.abs(value - wanted[n]) <= within, `${found} is not ${wanted}`));
}

/** 10 x 20 x 30 voxels of 1 x 2 x 3 mm that begin at (100, 200, 300) mm. */
const straight = new Lattice([10, 20, 30], [[1, 0, 0, 100], [0, 2, 0, 200], [0, 0, 3, 300], [0, 0, 0, 1]]);

/** Turned by 30 degrees about z, then stored with i to the right of the patient. */
const [c, s] = [Math.cos(Math.PI / 6), Math.sin(Math.PI / 6)];
const turned = new Lattice([8, 9, 10], [[-2 * c, -s, 0, 5], [-2 * s, c, 0, 6], [0, 0, 4, 7], [0, 0, 0, 1]]);

test("voxels lie where the matrix says, and back", () => {
  near(straight.toWorld([1, 2, 3]), [101, 204, 309]);
  near(straight.toIndex([101, 204, 309]), [1, 2, 3]);
  near(turned.toWorld([1, 0, 0]), [5 - 2 * c, 6 - 2 * s, 7]);
  for (const index of [[0, 0, 0], [7, 8, 9], [2.5, 3.25, -1]]) near(turned.toIndex(turned.toWorld(index)), index);
  near(turned.spacing, [2, 1, 4]);
  near(straight.centre, [104.5, 219, 343.5]);
});

test("a matrix that flattens the scan is refused", () => {
  assert.throws(() => new Lattice([2, 2, 2], [[1, 1, 0, 0], [0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]));
});

test("the voxel at a position reaches half a spacing to each side", () => {
  assert.deepEqual(straight.voxelAt([99.6, 200, 300]), [0, 0, 0]);
  assert.equal(straight.voxelAt([99.4, 200, 300]), null);
  assert.deepEqual(straight.voxelAt([109.4, 200, 300]), [9, 0, 0]);
  assert.equal(straight.voxelAt([109.6, 200, 300]), null);
});

test("radiologists' sides: left at the right, front up, head up", () => {
  const { axial, coronal, sagittal } = PATIENT_FRAMES;
  const sides = [axial, coronal, sagittal].map(({ right, down }) => orientationLetters(right) + orientationLetters(down));
  assert.deepEqual(sides, ["LP", "LF", "PF"]);
});

test("letters of oblique directions, strongest first", () => {
  assert.equal(orientationLetters([0, 0, 1]), "H");
  assert.equal(orientationLetters([-1, 0.05, 0]), "R");
  assert.equal(orientationLetters([0.6, -0.8, 0]), "A·L");
  assert.equal(orientationLetters([-0.5, 0.5, -0.7]), "F·R·P");
});

test("a camera shows pixels where they are, on the plane through the crosshair", () => {
  const camera = new Camera(PATIENT_FRAMES.coronal);
  Object.assign(camera, { width: 200, height: 100, mmPerPixel: 0.5, centre: [10, 20, 30] });
  near(camera.toMm(100, 50, [0, 77, 0]), [10, 77, 30]);
  near(camera.toMm(120, 40, [0, 77, 0]), [20, 77, 35]);
  const seen = camera.toPixel([20, 70, 35], [0, 77, 0]);
  // forward, to the front, is positive
  near([seen.x, seen.y, seen.depth], [120, 40, 7]);
});

test("zooming keeps what is under the pointer", () => {
  const camera = new Camera(PATIENT_FRAMES.sagittal);
  Object.assign(camera, { width: 300, height: 200, mmPerPixel: 1, centre: [1, 2, 3] });
  const before = camera.toMm(40, 170, [9, 9, 9]);
  camera.zoom(3, 40, 170);
  near([camera.mmPerPixel], [1 / 3]);
  near(camera.toMm(40, 170, [9, 9, 9]), before);
  camera.pan(10, -4);
  near(camera.toMm(50, 166, [9, 9, 9]), before);
});

test("what fits is the whole scan, in the larger of both directions", () => {
  const camera = new Camera(PATIENT_FRAMES.axial);
  Object.assign(camera, { width: 100, height: 100 });
  camera.fit(straight);
  near([camera.mmPerPixel], [0.4]);
  near(camera.centre, straight.centre);
});

test("the shader's steps give the index of every pixel", () => {
  for (const name of ["axial", "coronal", "sagittal"]) {
    const camera = new Camera(PATIENT_FRAMES[name]);
    Object.assign(camera, { width: 64, height: 48, mmPerPixel: 0.7, centre: [1, 5, 20] });
    const through = [3, 4, 15];
    const { origin, across, along } = camera.toIndexSteps(through, turned);
    const index = origin.map((value, a) => value + 13 * across[a] + 31 * along[a]);
    near(index, turned.toIndex(camera.toMm(13, 31, through)));
  }
});

test("slices: steps and snapping where planes are those of the scan, spacing alone where they are not", () => {
  assert.equal(straight.sliceAxis([0, 0, 1]), 2);
  assert.equal(straight.sliceStep([0, -1, 0]), 2);
  near(straight.snapped([103.2, 204.7, 310], [0, 0, 1]), [103.2, 204.7, 309]);
  assert.equal(straight.isOblique, false);
  assert.equal(turned.isOblique, true);
  assert.equal(turned.sliceAxis([0, 0, 1]), 2);
  assert.equal(turned.sliceAxis([1, 0, 0]), null);
  assert.equal(turned.sliceStep([1, 0, 0]), 1);
  near(turned.snapped([1, 2, 30], [1, 0, 0]), [1, 2, 30]);
});

test("the scan's own planes are the nearest ones to the patient's, seen from the same side", () => {
  const { axial, coronal, sagittal } = scanFrames(turned);
  near(axial.right, [c, s, 0]);
  near(axial.down, [-s, c, 0]);
  near(axial.normal, [0, 0, 1]);
  near(coronal.normal, [s, -c, 0]);
  near(sagittal.normal, [c, s, 0]);
  near(sagittal.down, [0, 0, -1]);
  for (const frame of [axial, coronal, sagittal]) assert.notEqual(turned.sliceAxis(frame.normal), null);
});

test("scans stored in any order of axes give the patient's planes", () => {
  // i to the head, j to the right, k to the back
  const stored = new Lattice([5, 6, 7], [[0, -2, 0, 0], [0, 0, 3, 0], [1, 0, 0, 0], [0, 0, 0, 1]]);
  assert.equal(stored.isOblique, false);
  const { axial, coronal, sagittal } = scanFrames(stored);
  assert.deepEqual([axial, coronal, sagittal].map((f) => orientationLetters(f.right) + orientationLetters(f.down)), ["LP", "LF", "PF"]);
  assert.deepEqual([0, 1, 2].map((a) => stored.sliceAxis([axial, coronal, sagittal][a].normal)), [0, 2, 1]);
});

test("a position is kept within the scan", () => {
  near(straight.clamped([0, 219, 1000]), [100, 219, 387]);
});

test("a box meets a plane by the voxels' faces", () => {
  const meets = (/** @type {number} */ z) => geometry.boxMeetsPlane(straight, [0, 0, 4], [10, 20, 2], [0, 0, 1], [0, 0, z]);
  assert.deepEqual([310.4, 310.6, 315, 316.4, 316.6].map(meets), [false, true, true, true, false]);
});

test("lengths, angles, and the circle that a plane cuts from a sphere", () => {
  assert.equal(geometry.distance([1, 2, 3], [4, 6, 15]), 13);
  near([geometry.angleDegrees([1, 0, 0], [0, 0, 0], [0, 5, 0])], [90]);
  near([geometry.angleDegrees([2, 1, 1], [1, 1, 1], [1 - Math.sqrt(3), 2, 1])], [150], 1e-9);
  near([geometry.angleDegrees([1, 0, 0], [0, 0, 0], [1, 1e-9, 0])], [1e-9 * (180 / Math.PI)], 1e-15);
  assert.deepEqual([geometry.sectionRadius(5, 3), geometry.sectionRadius(5, -4), geometry.sectionRadius(5, 6)], [4, 3, 0]);
});

test("a scale bar is 1, 2 or 5 times a power of ten", () => {
  assert.deepEqual([7, 49.9, 50, 230, 0.3, 1].map(geometry.roundLength), [5, 20, 50, 200, 0.2, 1]);
});

test("window: to the right wider about the same level, down brighter", () => {
  const wider = geometry.draggedWindow({ low: 0, high: 100 }, 200 * Math.LN2, 0);
  near([wider.low, wider.high], [-50, 150]);
  const brighter = geometry.draggedWindow({ low: 0, high: 100 }, 0, 40);
  near([brighter.low, brighter.high], [-10, 90]);
});

test("seen from outside: letters and direction of every quarter turn, head up", () => {
  const letters = (/** @type {number} */ azimuth, /** @type {number} */ elevation) => {
    const { frame, look } = geometry.turntable(azimuth, elevation);
    const { right, down } = frame;
    // right, down and away from the viewer are right-handed, as on every screen
    near([right[1] * down[2] - right[2] * down[1], right[2] * down[0] - right[0] * down[2], right[0] * down[1] - right[1] * down[0]], look);
    return orientationLetters(right) + orientationLetters(down) + orientationLetters(look);
  };
  assert.deepEqual([0, 90, 180, 270].map((turn) => letters(turn, 0)), ["LFP", "PFR", "RFA", "AFL"]);
  assert.deepEqual([letters(0, 90), letters(0, -90)], ["LAF", "LPH"]);
});

test("the pixels around a box of voxels hold all of its corners", () => {
  const camera = new Camera(PATIENT_FRAMES.axial);
  Object.assign(camera, { width: 200, height: 100, mmPerPixel: 0.5, centre: [104.5, 219, 343.5] });
  // x from 101.5 to 104.5 mm and y from 203 to 213 mm, 0.5 mm a pixel, wherever the plane lies
  assert.deepEqual(camera.around(straight, [2, 2, 0], [3, 5, 30]), { left: 94, top: 18, right: 100, bottom: 38 });
});
