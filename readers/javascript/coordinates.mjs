// From patient LPS in mm (x to the patient's left, y to the back, z to the head; right-handed) to the axes of other
// programs, and the check that nothing was mirrored on the way.

import { fail } from "./safetensors.mjs";

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

// Axes of other programs: point there = fromLpsMm (rows) * (x, y, z). reverseTriangles: the program takes triangles
// that are clockwise on the screen for front faces. `coordinates` of case.json says the same from 1.1 on.
export const FRAMES = {
  lps: {
    fromLpsMm: [
      [1, 0, 0],
      [0, 1, 0],
      [0, 0, 1],
    ],
    millimetresPerUnit: 1,
    leftHanded: false,
    reverseTriangles: false,
  },
  gltf: {
    fromLpsMm: [
      [0.001, 0, 0],
      [0, 0, 0.001],
      [0, -0.001, 0],
    ],
    millimetresPerUnit: 1000,
    leftHanded: false,
    reverseTriangles: false,
  },
  unity: {
    fromLpsMm: [
      [0.001, 0, 0],
      [0, 0, 0.001],
      [0, 0.001, 0],
    ],
    millimetresPerUnit: 1000,
    leftHanded: true,
    reverseTriangles: true,
  },
  unreal: {
    fromLpsMm: [
      [0, 0.1, 0],
      [0.1, 0, 0],
      [0, 0, 0.1],
    ],
    millimetresPerUnit: 10,
    leftHanded: true,
    reverseTriangles: false,
  },
};

export const fromLps = (frame, point) => frame.fromLpsMm.map((row) => dot(row, point));

// The w of a tangent in `frame`: a shader works out B = cross(N, T) * w, and in left-handed axes the cross product has
// the other sign, so that without this a normal map would be lit from the wrong side.
export const tangentW = (frame, w) => (frame.leftHanded ? -w : w);

// Triangles (three vertex numbers each) that face the other way.
export function reversedWinding(triangles) {
  return triangles.map((vertex, n) => (n % 3 === 0 ? vertex : triangles[n % 3 === 1 ? n + 1 : n - 1]));
}

// Signed volume (b - a) . ((c - a) x (d - a)) / 6 of a tetrahedron, in the cube of the points' unit.
export function signedVolume([a, b, c, d]) {
  return dot(minus(b, a), cross(minus(c, a), minus(d, a))) / 6;
}

// Throws unless four points, as your program holds them in `frame`, span the volume that the case states (mm3, in LPS).
// In left-handed axes the volume has the other sign, and only there.
export function checkChirality(volumeLpsMm3, points, frame) {
  const found = signedVolume(points) * frame.millimetresPerUnit ** 3 * (frame.leftHanded ? -1 : 1);
  if (!(Math.abs(volumeLpsMm3) > 0)) fail("four landmarks in one plane cannot tell left from right");
  if (found * volumeLpsMm3 < 0) fail("the case is mirrored: four landmarks span the volume with the wrong sign");
  if (!(Math.abs(found - volumeLpsMm3) <= 1e-3 * Math.abs(volumeLpsMm3)))
    fail("the case is scaled or bent: four landmarks span the wrong volume");
}
