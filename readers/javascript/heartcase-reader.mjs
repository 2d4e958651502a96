// Reader of heartcase case bundles, format 1.x, for node >= 18 and browsers; no dependency, files are ArrayBuffers.
//
//   const read = async (name) => (await fetch(`heart.case/${name}`)).arrayBuffer();
//   const bundle = await openCase(read, ["surface", "mapping"]);
//   bundle.files.grid.cells.values   // Int32Array (cell_count, 3), row by row
//
// Written from docs/bundle.md and docs/schemas/bundle-arrays.json. A file is judged before it is used: whatever is
// wrong is thrown as HeartcaseError, one line that holds no text of the file. Space is patient LPS in mm.

import { member, readManifest } from "./manifest.mjs";
import { fail, HeartcaseError, isCount, readSafetensors } from "./safetensors.mjs";

export { checkChirality, FRAMES, fromLps, reversedWinding, signedVolume } from "./coordinates.mjs";
export { HeartcaseError };

// docs/schemas/bundle-arrays.json: role, name, type of safetensors, shape (numbers, names of counts that arrays share)
const ARRAY_RULES = [
  ["grid", "cells", "I32", ["cell_count", 3]],
  ["grid", "cell_coverage", "F32", ["cell_count"]],
  ["grid", "cell_label", "U8", ["cell_count"]],
  ["grid", "cell_stiffness", "F32", ["cell_count"]],
  ["grid", "cell_density", "F32", ["cell_count"]],
  ["grid", "nodes", "I32", ["node_count", 3]],
  ["grid", "fixed", "U8", ["node_count"]],
  ["surface", "vertices", "F32", ["vertex_count", 3]],
  ["surface", "normals", "F32", ["vertex_count", 3]],
  ["surface", "triangles", "I32", ["triangle_count", 3]],
  ["surface", "triangle_label", "U8", ["triangle_count"]],
  ["surface", "triangle_tissue", "U8", ["triangle_count"]],
  ["surface", "triangle_is_cut", "U8", ["triangle_count"]],
  ["surface", "vertex_label", "U8", ["vertex_count"]],
  ["surface", "render_to_welded", "I32", ["render_vertex_count"]],
  ["mapping", "triangle_nodes", "I32", ["vertex_count", 3]],
  ["mapping", "weights", "F32", ["vertex_count", 3]],
  ["mapping", "offset", "F32", ["vertex_count", 3]],
  ["mapping", "normal", "F32", ["vertex_count", 3]],
  ["mapping", "curvature", "U8", ["vertex_count"]],
  ["mapping", "tangent", "F32", ["render_vertex_count", 4]],
  ["mapping", "nearest_node", "I32", ["vertex_count"]],
  ["picking", "nodes", "I32", ["picking_vertex_count"]],
  ["picking", "triangles", "I32", ["picking_triangle_count", 3]],
  ["picking", "triangle_label", "U8", ["picking_triangle_count"]],
  ["scan", "intensity", "I16", ["scan_k", "scan_j", "scan_i"]],
];
const ARRAY_ROLES = new Set(ARRAY_RULES.map((rule) => rule[0]));
const TABLE_TYPES = new Map([
  ["int32", "I32"],
  ["int16", "I16"],
  ["float32", "F32"],
  ["uint8", "U8"],
]);

// Type, shape and count of every array of the rules; `counts` is shared by all files of the case.
function checkShapes(role, arrays, counts) {
  for (const [ruleRole, name, dtype, wanted] of ARRAY_RULES) {
    if (ruleRole !== role) continue;
    const where = `the ${role} file: ${name}`;
    const array = arrays.get(name) ?? fail(`${where} is missing`);
    if (array.dtype !== dtype) fail(`${where} has the wrong type, ${dtype} is expected`);
    if (array.shape.length !== wanted.length) fail(`${where} has the wrong shape`);
    wanted.forEach((count, axis) => {
      if (typeof count === "string" && !counts.has(count)) counts.set(count, array.shape[axis]);
      if (array.shape[axis] === (counts.get(count) ?? count)) return;
      fail(
        typeof count === "string" ? `${where} has not as many rows as its ${count}` : `${where} has the wrong shape`,
      );
    });
  }
}

// The manifest's table of arrays (from format 1.1 on) must say what the file's header says.
function checkTable(entry, arrays, listsArrays) {
  const where = `case.json: the table of arrays of the ${entry.role} file`;
  if (!listsArrays) return;
  if (!Array.isArray(entry.arrays)) fail(`${where} is missing`);
  const listed = new Set();
  for (const row of entry.arrays) {
    const array = arrays.get(member(row, "name", "text", where)) ?? fail(`${where} names an array that the file lacks`);
    const shape = member(row, "shape", "list", where);
    listed.add(row.name);
    const same =
      TABLE_TYPES.get(member(row, "dtype", "text", where)) === array.dtype &&
      member(row, "offset", "count", where) === array.begin;
    if (!same || shape.length !== array.shape.length || !shape.every((axis, n) => axis === array.shape[n]))
      fail(`${where} does not agree with the file's header`);
    if (array.begin % 64 !== 0) fail(`${where} has an array that does not start at a multiple of 64 bytes`);
  }
  for (const [role, name] of ARRAY_RULES)
    if (role === entry.role && !listed.has(name)) fail(`${where} leaves out ${name}`);
}

// Opens a case. `readFile(name, what, size)` returns a promise of the ArrayBuffer of a file of its folder; `what` names
// it in messages. The grid and the files of `roles` (surface, mapping, picking, scan) are read, or all that it lists
// where no role is given; of files without arrays (render, labels) only size and hash are judged. With checkHashes each
// file that is read must have its SHA-256 (in a browser this needs a page served over https); without it only structure
// and ranges are checked.
// Returns {manifest, files: role -> name -> {dtype, shape, values}, counts: name of a count -> number}.
export async function openCase(readFile, roles = [], { checkHashes = true } = {}) {
  const manifest = readManifest(await readFile("case.json"));
  const [files, counts] = [{}, new Map()];
  for (const role of new Set(["grid", ...(roles.length > 0 ? roles : manifest.files.map((file) => file.role))])) {
    const known = ARRAY_ROLES.has(role) || role === "render" || role === "labels";
    const entry = manifest.files.find((file) => file.role === role);
    if (entry === undefined) fail(known ? `case.json lists no ${role} file` : "a role that was asked for is not known");
    const what = known ? `the ${role} file` : "a file of another role";
    const buffer = await readFile(entry.name, what, entry.size);
    if (buffer.byteLength !== entry.size) fail(`${what} has not the size that case.json states`);
    if (checkHashes && (await sha256(buffer)) !== entry.sha256)
      fail(`${what} has not the SHA-256 that case.json states`);
    if (!ARRAY_ROLES.has(role)) continue;
    const arrays = readSafetensors(buffer, what);
    checkShapes(role, arrays, counts);
    checkTable(entry, arrays, manifest.listsArrays);
    files[role] = Object.fromEntries(arrays);
  }
  const bundle = { manifest, files, counts };
  checkGrid(bundle);
  checkOtherFiles(bundle);
  return bundle;
}

async function sha256(buffer) {
  const subtle = (globalThis.crypto ?? (await import("node:crypto")).webcrypto).subtle;
  const digest = new Uint8Array(await subtle.digest("SHA-256", buffer));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

// Every value of an array must satisfy `ok`, or the message says which does not and what the rule is.
function checkValues(bundle, role, name, rule, ok) {
  const bad = bundle.files[role][name].values.findIndex((value) => !ok(value));
  if (bad >= 0) fail(`the ${role} file: ${name} must be ${rule}, value ${bad + 1} is not`);
}

function checkBelow(bundle, role, name, of) {
  const limit = bundle.counts.get(of);
  checkValues(bundle, role, name, `from 0 up to below the ${of}`, (value) => value >= 0 && value < limit);
}

// Rows of (i, j, k) lie in the box of `size` and ascend by k, then j, then i; returns one ascending key per row.
export function keysOf(rows, size, name) {
  const keys = new Float64Array(rows.length / 3);
  for (let n = 0; n < keys.length; n += 1) {
    const i = rows[3 * n];
    const j = rows[3 * n + 1];
    const k = rows[3 * n + 2];
    if (i < 0 || j < 0 || k < 0 || i >= size[0] || j >= size[1] || k >= size[2])
      fail(`the grid file: ${name} lie outside the grid in row ${n + 1}`);
    keys[n] = (k * size[1] + j) * size[0] + i;
    if (n > 0 && keys[n] <= keys[n - 1]) fail(`the grid file: ${name} do not ascend by k, j, i in row ${n + 1}`);
  }
  return keys;
}

// Node numbers of the eight corners of every cell (cell_count x 8, corner = di + 2 dj + 4 dk).
export function cornersOfCells(bundle) {
  const { cells, nodes } = bundle.files.grid;
  const size = bundle.manifest.grid.size.map((n) => n + 1);
  const numbers = new Map();
  keysOf(nodes.values, size, "nodes").forEach((key, n) => numbers.set(key, n));
  const rows = cells.values;
  const corners = new Int32Array((rows.length / 3) * 8);
  for (let n = 0; n < corners.length; n += 1) {
    const cell = n >> 3;
    const i = rows[3 * cell] + (n & 1);
    const j = rows[3 * cell + 1] + ((n >> 1) & 1);
    const k = rows[3 * cell + 2] + ((n >> 2) & 1);
    corners[n] =
      numbers.get((k * size[1] + j) * size[0] + i) ??
      fail(`the grid file: a corner of cell ${cell + 1} is not among the nodes`);
  }
  return corners;
}

// Where in its cell the tissue lies (from format 1.3 on): means of x, y, z, xx, yy, zz, yz, xz, xy from its centre. The
// springs do not ask for it, other force laws do.
function checkMoments(bundle) {
  const { dtype, shape, values } = bundle.files.grid.cell_moments;
  const where = "the grid file: cell_moments";
  if (dtype !== "F32") fail(`${where} has the wrong type, F32 is expected`);
  if (shape.length !== 2 || shape[0] !== bundle.counts.get("cell_count") || shape[1] !== 9)
    fail(`${where} has the wrong shape`);
  checkValues(bundle, "grid", "cell_moments", "from -1/2 to 1/2", (value) => Math.abs(value) <= 0.5);
  for (let n = 0; n < values.length; n += 9)
    for (let axis = n; axis < n + 3; axis += 1)
      if (values[axis + 3] < values[axis] * values[axis] - 1e-6)
        fail(`${where} has means of squares below the squares of the means in row ${n / 9 + 1}`);
}

function checkGrid(bundle) {
  const { manifest, counts, files } = bundle;
  if (
    counts.get("cell_count") !== manifest.cell_count ||
    counts.get("node_count") !== manifest.node_count ||
    manifest.cell_count === 0
  )
    fail("the grid file has not the cells and nodes that case.json counts");
  checkValues(bundle, "grid", "cell_coverage", "above 0 and at most 1", (value) => value > 0 && value <= 1);
  checkValues(bundle, "grid", "cell_stiffness", "above 0 and at most 1e6 kPa", (value) => value > 0 && value <= 1e6);
  checkValues(bundle, "grid", "cell_density", "above 0 and at most 2e4 kg/m3", (value) => value > 0 && value <= 2e4);
  checkValues(
    bundle,
    "grid",
    "cell_label",
    "a label that has a material",
    (value) => manifest.labels.has(value) && manifest.materialLabels.has(value),
  );
  if (files.grid.cell_moments !== undefined) checkMoments(bundle);
  checkValues(bundle, "grid", "fixed", "0 or 1", (value) => value <= 1);
  if (files.grid.fixed.values.reduce((sum, value) => sum + value, 0) !== manifest.fixed_node_count)
    fail("the grid file holds another number of nodes fixed than case.json counts");
  if (manifest.fixed_node_count === manifest.node_count) fail("the grid file holds no node that may move");
  keysOf(files.grid.cells.values, manifest.grid.size, "cells");
  const used = new Uint8Array(manifest.node_count);
  for (const node of cornersOfCells(bundle)) used[node] = 1;
  if (used.includes(0)) fail("the grid file: a node is the corner of no cell");
}

function checkOtherFiles(bundle) {
  const isLabel = (value) => bundle.manifest.labels.has(value);
  const isFlag = (value) => value <= 1;
  if (bundle.files.surface) {
    for (const name of ["vertices", "normals"]) checkValues(bundle, "surface", name, "finite", Number.isFinite);
    for (const name of ["triangle_label", "triangle_tissue", "vertex_label"])
      checkValues(bundle, "surface", name, "a label of case.json", isLabel);
    checkValues(bundle, "surface", "triangle_is_cut", "0 or 1", isFlag);
    checkBelow(bundle, "surface", "triangles", "vertex_count");
    checkBelow(bundle, "surface", "render_to_welded", "vertex_count");
  }
  if (bundle.files.mapping) {
    for (const name of ["weights", "offset", "normal", "tangent"])
      checkValues(bundle, "mapping", name, "finite", Number.isFinite);
    checkValues(bundle, "mapping", "curvature", "0 or 1", isFlag);
    checkBelow(bundle, "mapping", "triangle_nodes", "node_count");
    checkBelow(bundle, "mapping", "nearest_node", "node_count");
    const w = bundle.files.mapping.weights.values;
    for (let v = 0; v < w.length; v += 3)
      if (!(Math.abs(w[v] + w[v + 1] + w[v + 2] - 1) < 1e-4))
        fail(`the mapping file: weights of vertex ${v / 3 + 1} do not add up to one`);
  }
  if (bundle.files.picking) {
    checkBelow(bundle, "picking", "nodes", "node_count");
    checkBelow(bundle, "picking", "triangles", "picking_vertex_count");
    checkValues(bundle, "picking", "triangle_label", "a label of case.json", isLabel);
  }
  if (bundle.files.scan) {
    if (bundle.manifest.scanValues === null) fail("case.json lacks scan_values");
    const shape = ["scan_i", "scan_j", "scan_k"].map((name) => bundle.counts.get(name));
    if (!shape.every((n, axis) => n === bundle.manifest.scan.size[axis]))
      fail("the scan file: intensity has not the shape of scan_geometry");
  }
}
