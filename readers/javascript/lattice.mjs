// How a case moves: springs and masses from its cells, steps in time, the surface over moved nodes (docs/bundle.md).
// Inside in metres, kilograms, seconds and double precision; nodes and vertices are handed out in patient LPS mm.
// Points are rows of three in a Float64Array.

import { cross, dot, minus } from "./coordinates.mjs";
import { cornersOfCells } from "./heartcase-reader.mjs";
import { pointAt } from "./manifest.mjs";
import { fail } from "./safetensors.mjs";

const SHORTEST = 0.1; // sum of unit vectors that still has a direction

const row = (points, n) => [points[3 * n], points[3 * n + 1], points[3 * n + 2]];
const unit = (a) => {
  const length = Math.sqrt(dot(a, a));
  return length > 0 ? a.map((x) => x / length) : [0, 0, 0]; // a vector of no length has no direction
};

// Every cell gives c k/4 to each of its 12 edges, c k/2 to each of its 12 face diagonals, k = 0.4 E h, and an eighth of
// its mass c rho h^3 to each corner. Returns rest (m), mass (kg), fixed (0 or 1) per node; first, second (node number),
// stiffness (N/m), length (m) per spring.
export function buildLattice(bundle) {
  const { cell_mm: cellMm, node_count: nodeCount, grid } = bundle.manifest;
  const { cell_coverage: coverage, cell_stiffness: modulus, cell_density: density, nodes, fixed } = bundle.files.grid;
  const h = cellMm * 1e-3;
  const rest = new Float64Array(3 * nodeCount);
  for (let n = 0; n < nodeCount; n += 1) {
    const corner = row(nodes.values, n).map((x) => x - 0.5);
    rest.set(
      pointAt(grid, corner).map((x) => 1e-3 * x),
      3 * n,
    );
  }
  const mass = new Float64Array(nodeCount);
  const corners = cornersOfCells(bundle);
  const pairs = new Map(); // lower node * node count + higher node -> stiffness
  const diagonal = new Set();
  for (let c = 0; c < coverage.values.length; c += 1) {
    const k = 0.4 * modulus.values[c] * 1e3 * h;
    const cell = corners.subarray(8 * c, 8 * c + 8);
    for (const node of cell) mass[node] += (coverage.values[c] * density.values[c] * h ** 3) / 8;
    for (let p = 0; p < 8; p += 1)
      for (let q = p + 1; q < 8; q += 1) {
        const bits = p ^ q;
        const axes = (bits & 1) + ((bits >> 1) & 1) + (bits >> 2);
        if (axes === 3) continue;
        const key = Math.min(cell[p], cell[q]) * nodeCount + Math.max(cell[p], cell[q]);
        pairs.set(key, (pairs.get(key) ?? 0) + (coverage.values[c] * k) / (axes === 1 ? 4 : 2));
        if (axes === 2) diagonal.add(key);
      }
  }
  const keys = Float64Array.from(pairs.keys()).sort();
  return {
    rest,
    mass,
    fixed: fixed.values,
    first: Int32Array.from(keys, (key) => Math.floor(key / nodeCount)),
    second: Int32Array.from(keys, (key) => key % nodeCount),
    stiffness: Float64Array.from(keys, (key) => pairs.get(key)),
    length: Float64Array.from(keys, (key) => (diagonal.has(key) ? Math.SQRT2 * h : h)),
  };
}

// displacement (m) and velocity (m/s, half a step behind it) per node.
export function atRest(lattice) {
  return { displacement: new Float64Array(lattice.rest.length), velocity: new Float64Array(lattice.rest.length) };
}

// One step of `stepS` seconds; damping in 1/s, gravity in m/s2 along LPS.
export function step(lattice, state, stepS, dampingPerS, gravity) {
  const { rest, mass, fixed, first, second, stiffness, length } = lattice;
  const { displacement: u, velocity: v } = state;
  const force = new Float64Array(rest.length);
  for (let s = 0; s < first.length; s += 1) {
    const [a, b] = [3 * first[s], 3 * second[s]];
    const x = rest[b] - rest[a] + (u[b] - u[a]);
    const y = rest[b + 1] - rest[a + 1] + (u[b + 1] - u[a + 1]);
    const z = rest[b + 2] - rest[a + 2] + (u[b + 2] - u[a + 2]);
    const distance = Math.sqrt(x * x + y * y + z * z);
    if (!(distance > 0)) continue; // no direction to pull in
    const pull = (stiffness[s] * (distance - length[s])) / distance;
    force[a] += pull * x;
    force[a + 1] += pull * y;
    force[a + 2] += pull * z;
    force[b] -= pull * x;
    force[b + 1] -= pull * y;
    force[b + 2] -= pull * z;
  }
  const q = (dampingPerS * stepS) / 2;
  for (let n = 0; n < u.length; n += 1) {
    const node = Math.floor(n / 3);
    if (fixed[node] !== 0) continue;
    v[n] = ((1 - q) * v[n] + stepS * (force[n] / mass[node] + gravity[n % 3])) / (1 + q);
    u[n] += stepS * v[n];
  }
}

// Present positions of the nodes, patient LPS mm.
export function nodePositionsMm(lattice, state) {
  return lattice.rest.map((x, n) => 1e3 * (x + state.displacement[n]));
}

// A function from node positions (mm) to the visible surface {vertices (mm), normals} that they carry (thesis 9.3.3).
export function surfaceCarrier(bundle, lattice) {
  const {
    triangle_nodes: nodes,
    weights,
    curvature,
    offset,
    normal,
  } = bundle.files.mapping ?? fail("the mapping file was not read");
  const parts = { offset: Float64Array.from(offset.values), normal: Float64Array.from(normal.values) };
  const count = curvature.values.length;
  const isCurved = curvature.values.slice();
  const anyCurved = isCurved.includes(1);

  const along = (basis, c) =>
    [0, 1, 2].map((axis) => c[0] * basis.t[axis] + c[1] * basis.n[axis] + c[2] * basis.b[axis]);
  function triangleBasis(v, p) {
    const [p1, p2, p3] = [0, 1, 2].map((n) => row(p, nodes.values[3 * v + n]));
    const t = unit(minus(p2, p1));
    const n = unit(cross(minus(p2, p1), minus(p3, p1)));
    return { t, n, b: cross(n, t) };
  }
  function sumOfNormals(v, nodeNormals) {
    const sum = [0, 0, 0];
    for (let n = 0; n < 3; n += 1)
      for (let axis = 0; axis < 3; axis += 1)
        sum[axis] += weights.values[3 * v + n] * nodeNormals[3 * nodes.values[3 * v + n] + axis];
    return sum;
  }
  function isBasis(v, triangle, nodeNormals) {
    const sum = sumOfNormals(v, nodeNormals);
    const across = cross(unit(sum), triangle.t);
    return dot(sum, sum) > SHORTEST ** 2 && dot(across, across) > SHORTEST ** 2;
  }
  function interpolatedBasis(v, triangle, nodeNormals) {
    const n = unit(sumOfNormals(v, nodeNormals));
    const b = unit(cross(n, triangle.t));
    return { t: cross(b, n), n, b };
  }
  function normalsOfNodes(p) {
    const sums = new Float64Array(p.length);
    if (!anyCurved) return sums;
    for (let s = 0; s < lattice.first.length; s += 1) {
      const [a, b] = [lattice.first[s], lattice.second[s]];
      unit(minus(row(p, a), row(p, b))).forEach((x, axis) => {
        sums[3 * a + axis] += x;
        sums[3 * b + axis] -= x;
      });
    }
    for (let n = 0; n < sums.length; n += 3) {
      const sum = row(sums, n / 3);
      sums.set(dot(sum, sum) < SHORTEST ** 2 ? [0, 0, 0] : unit(sum), n);
    }
    return sums;
  }

  // The interpolated basis has components of its own: those that give the same vertex and normal at rest.
  const rest = nodePositionsMm(lattice, atRest(lattice));
  const restNormals = normalsOfNodes(rest);
  for (let v = 0; v < count; v += 1) {
    if (isCurved[v] === 0) continue;
    const plain = triangleBasis(v, rest);
    if (!isBasis(v, plain, restNormals)) {
      isCurved[v] = 0; // the nodes have tissue on both sides and no normal of their own
      continue;
    }
    const bent = interpolatedBasis(v, plain, restNormals);
    for (const components of Object.values(parts)) {
      const world = along(plain, row(components, v));
      components.set([dot(world, bent.t), dot(world, bent.n), dot(world, bent.b)], 3 * v);
    }
  }

  return (positions) => {
    const surface = { vertices: new Float64Array(3 * count), normals: new Float64Array(3 * count) };
    const nodeNormals = normalsOfNodes(positions);
    for (let v = 0; v < count; v += 1) {
      let basis = triangleBasis(v, positions);
      if (isCurved[v] !== 0) basis = interpolatedBasis(v, basis, nodeNormals);
      const vertex = along(basis, row(parts.offset, v));
      for (let n = 0; n < 3; n += 1)
        for (let axis = 0; axis < 3; axis += 1)
          vertex[axis] += weights.values[3 * v + n] * positions[3 * nodes.values[3 * v + n] + axis];
      surface.vertices.set(vertex, 3 * v);
      surface.normals.set(along(basis, row(parts.normal, v)), 3 * v);
    }
    return surface;
  };
}

// Signed volume inside closed triangles that are counter-clockwise from outside.
export function enclosedVolumeMm3(triangles, vertices) {
  let sixVolumes = 0;
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [0, 1, 2].map((n) => minus(row(vertices, triangles[t + n]), row(vertices, 0)));
    sixVolumes += dot(a, cross(b, c));
  }
  return sixVolumes / 6;
}

// Throws where the mapping at rest does not give back the surface, or the surface is inside out: a mirrored case.
export function checkSurfaceAtRest(bundle, lattice, carry) {
  const { vertices, triangles } = bundle.files.surface ?? fail("the surface file was not read");
  const rest = carry(nodePositionsMm(lattice, atRest(lattice))).vertices;
  for (let v = 0; v < rest.length / 3; v += 1) {
    const gap = minus(row(rest, v), row(vertices.values, v));
    if (!(dot(gap, gap) <= 3e-4)) fail(`the mapping does not give back the surface at rest: vertex ${v + 1}`);
  }
  if (triangles.values.length > 0 && !(enclosedVolumeMm3(triangles.values, rest) > 0))
    fail("the surface is inside out: the case is mirrored or its triangles are turned");
}
