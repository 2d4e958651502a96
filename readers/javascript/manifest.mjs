// The manifest of a case, case.json: where the grid lies, how large it is, which files there are.

import { cross, dot, FRAMES } from "./coordinates.mjs";
import { fail, isCount, isObject, parseJson } from "./safetensors.mjs";

export const MAX_MANIFEST_BYTES = 16 * 2 ** 20;
const MAX_SIZE = 100_000; // cells along one axis: node keys stay below 2^53

const IS = {
  text: (value) => typeof value === "string",
  number: (value) => typeof value === "number",
  positive: (value) => typeof value === "number" && value > 0,
  count: isCount,
  list: Array.isArray,
  object: isObject,
  point: (value) => Array.isArray(value) && value.length === 3 && value.every((x) => typeof x === "number"),
};

// The member `key` of an object, which must be what `kind` says.
export function member(object, key, kind, where) {
  if (!isObject(object) || !Object.hasOwn(object, key)) fail(`${where} lacks ${key}`);
  if (!IS[kind](object[key])) fail(`${where} has a ${key} that is no ${kind}`);
  return object[key];
}

function readGeometry(manifest, key) {
  const where = `case.json: ${key}`;
  const json = member(manifest, key, "object", "case.json");
  const origin = member(json, "origin_mm", "point", where);
  const spacing = member(json, "spacing_mm", "point", where);
  const size = member(json, "size", "point", where);
  const direction = member(json, "direction", "list", where);
  if (direction.length !== 3 || !direction.every(IS.point))
    fail(`${where} has a direction that is not three rows of three`);
  if (!size.every((n) => isCount(n) && n >= 1 && n <= MAX_SIZE)) fail(`${where} has a size out of range`);
  if (!spacing.every((s) => s > 0)) fail(`${where} has a spacing_mm that is not positive`);
  const columns = [0, 1, 2].map((c) => direction.map((row) => row[c]));
  for (let a = 0; a < 3; a += 1)
    for (let b = 0; b < 3; b += 1)
      if (!(Math.abs(dot(columns[a], columns[b]) - (a === b ? 1 : 0)) < 1e-4))
        fail(`${where} has a direction whose axes are not unit and square`);
  return { origin, spacing, direction, size };
}

// The grid's cells are cubes and its axes right-handed; a scan's need not be.
function readGridGeometry(manifest) {
  const grid = readGeometry(manifest, "grid_geometry");
  const { spacing, direction } = grid;
  if (!spacing.every((s) => Math.abs(s - spacing[0]) <= 1e-6 * spacing[0]))
    fail("case.json: grid_geometry has cells that are not cubes");
  if (!(dot(direction[0], cross(direction[1], direction[2])) > 0))
    fail("case.json: grid_geometry is left-handed: the case is mirrored");
  return grid;
}

// Place (mm, LPS) of index (i, j, k), which need not be whole.
export function pointAt({ origin, spacing, direction }, index) {
  const step = index.map((n, axis) => spacing[axis] * n);
  return direction.map((row, axis) => origin[axis] + dot(row, step));
}

// The axes are part of the format: a case that states others would be shown turned or mirrored.
function checkFrames(json, mustState) {
  const same = (rows, frame) => JSON.stringify(rows) === JSON.stringify(frame.fromLpsMm);
  const wrong = "has a matrix that the format does not allow: the case would be turned or mirrored";
  if (Object.hasOwn(json, "gltf_from_lps") && !same(json.gltf_from_lps, FRAMES.gltf)) fail(`case.json ${wrong}`);
  if (!mustState && !Object.hasOwn(json, "coordinates")) return;
  const coordinates = member(json, "coordinates", "object", "case.json");
  const fixed = {
    space: "patient LPS",
    unit: "mm",
    handedness: "right",
    winding: "counter-clockwise from outside the tissue",
  };
  for (const [key, value] of Object.entries(fixed))
    if (member(coordinates, key, "text", "case.json: coordinates") !== value)
      fail(`case.json: coordinates have a ${key} that the format does not allow`);
  if (JSON.stringify(coordinates.axes) !== '["left","back","head"]')
    fail("case.json: coordinates have axes that the format does not allow");
  for (const entry of member(coordinates, "frames", "list", "case.json: coordinates")) {
    const name = member(entry, "name", "text", "case.json: a frame of coordinates");
    const frame = Object.hasOwn(FRAMES, name) ? FRAMES[name] : null;
    if (frame === null) continue;
    if (!same(entry.from_lps_mm, frame)) fail(`case.json: a frame of coordinates ${wrong}`);
    const handedness = member(entry, "handedness", "text", "case.json: a frame of coordinates");
    if (handedness !== (frame.leftHanded ? "left" : "right"))
      fail("case.json: a frame of coordinates has the wrong handedness");
    if (entry.reverse_triangles !== frame.reverseTriangles)
      fail("case.json: a frame of coordinates turns its triangles the wrong way");
  }
}

function readFileEntries(manifest) {
  const [names, roles] = [new Set(), new Set()];
  return member(manifest, "files", "list", "case.json").map((json, n) => {
    const where = `case.json: entry ${n + 1} of files`;
    const entry = { arrays: null };
    for (const [key, kind] of [
      ["role", "text"],
      ["name", "text"],
      ["sha256", "text"],
      ["size", "count"],
    ])
      entry[key] = member(json, key, kind, where);
    if (!/^[a-z0-9][a-z0-9_.-]{0,127}$/.test(entry.name) || entry.name === "case.json")
      fail(`${where} has a name that is not a plain file name`);
    if (names.has(entry.name)) fail(`${where} has the name of an entry before it`);
    if (roles.has(entry.role)) fail(`${where} has the role of an entry before it`);
    if (!/^[0-9a-f]{64}$/.test(entry.sha256)) fail(`${where} has a sha256 that is not one`);
    if (Object.hasOwn(json, "arrays")) entry.arrays = json.arrays;
    names.add(entry.name);
    roles.add(entry.role);
    return entry;
  });
}

// case.json (ArrayBuffer) to its judged parts, and the whole of it as `json`.
export function readManifest(buffer) {
  if (buffer.byteLength > MAX_MANIFEST_BYTES) fail("case.json is larger than allowed");
  const json = parseJson(new Uint8Array(buffer), "case.json");
  if (member(json, "format", "text", "case.json") !== "heartcase-bundle") fail("case.json is not a heartcase bundle");
  const version = /^([0-9]{1,9})\.([0-9]{1,9})$/.exec(member(json, "format_version", "text", "case.json"));
  if (version === null) fail("case.json has a format_version that is not MAJOR.MINOR");
  if (version[1] !== "1") fail("case.json has a format_version that this reader does not know: it reads 1.x");
  const extensions = Object.hasOwn(json, "required_extensions") ? json.required_extensions : [];
  if (!Array.isArray(extensions) || extensions.length > 0)
    fail("case.json requires an extension that this reader does not know");
  const isFirst = Number(version[2]) === 0; // 1.0 has neither coordinates nor tables of arrays
  checkFrames(json, !isFirst);
  const grid = readGridGeometry(json);
  const scan = readGeometry(json, "scan_geometry"); // where the voxels of the scan file lie
  let scanValues = null; // intensity = slope * stored number + intercept
  if (Object.hasOwn(json, "scan_values") && json.scan_values !== null) {
    scanValues = member(json, "scan_values", "object", "case.json");
    member(scanValues, "slope", "positive", "case.json: scan_values");
    member(scanValues, "intercept", "number", "case.json: scan_values");
  }
  const simulation = member(json, "simulation", "object", "case.json");
  const figures = {};
  for (const key of ["cell_mm", "step_default_s", "step_limit_s"])
    figures[key] = member(simulation, key, "positive", "case.json: simulation");
  for (const key of ["node_count", "cell_count", "fixed_node_count"])
    figures[key] = member(simulation, key, "count", "case.json: simulation");
  if (Math.abs(figures.cell_mm - grid.spacing[0]) > 1e-6 * figures.cell_mm)
    fail("case.json: simulation has a cell_mm that is not the grid's spacing");
  if (figures.step_default_s > figures.step_limit_s)
    fail("case.json: simulation has a step_default_s beyond step_limit_s");
  const labels = new Set([0]); // the background is always among them
  for (const label of member(member(json, "labels", "object", "case.json"), "labels", "list", "case.json: labels"))
    labels.add(member(label, "value", "count", "case.json: a label"));
  const materialLabels = new Set(
    member(json, "materials", "list", "case.json").map((material) =>
      member(material, "label", "count", "case.json: a material"),
    ),
  );
  const landmarks = (Object.hasOwn(json, "landmarks") ? member(json, "landmarks", "list", "case.json") : []).map(
    (mark) => {
      const points = member(mark, "points_mm", "list", "case.json: a landmark");
      if (points.length === 0 || !points.every(IS.point)) fail("case.json: a landmark has no points");
      return {
        name: member(mark, "name", "text", "case.json: a landmark"),
        kind: member(mark, "kind", "text", "case.json: a landmark"),
        points_mm: points,
      };
    },
  );
  // listsArrays: from format 1.1 on every array stands in the table of its file.
  return {
    grid,
    scan,
    scanValues,
    ...figures,
    labels,
    materialLabels,
    listsArrays: !isFirst,
    files: readFileEntries(json),
    landmarks,
    json,
  };
}
