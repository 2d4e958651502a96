// What step.mjs does: steps a case, and compares it with a golden file.

import path from "node:path";
import { performance } from "node:perf_hooks";

import { checkChirality, FRAMES, fromLps, HeartcaseError, openCase, signedVolume } from "./heartcase-reader.mjs";
import {
  atRest,
  buildLattice,
  checkSurfaceAtRest,
  enclosedVolumeMm3,
  nodePositionsMm,
  step,
  surfaceCarrier,
} from "./lattice.mjs";
import { member, pointAt } from "./manifest.mjs";
import { folderReader } from "./node-folder.mjs";
import { fail, parseJson } from "./safetensors.mjs";

const GOLDEN = "the golden file";
const seconds = (start) => ((performance.now() - start) / 1000).toFixed(4);

// Prints the greatest distance, and throws where it is above the tolerance.
function compare(what, found, expected, tolerance, print) {
  if (found.length !== 3 * expected.length) fail(`${what}: the golden file has another number of points`);
  let worst = 0;
  expected.forEach((point, n) => {
    const distance = Math.hypot(found[3 * n] - point[0], found[3 * n + 1] - point[1], found[3 * n + 2] - point[2]);
    if (!(distance <= worst)) worst = distance;
  });
  print(`${what}: ${expected.length} rows, at most ${worst.toPrecision(3)} from the golden file`);
  if (!(worst <= tolerance)) fail(`${what}: further from the golden file than its tolerance`);
}

function checkNumber(what, found, expected, relative) {
  if (!(Math.abs(found - expected) <= relative * Math.abs(expected))) fail(`${what}: not what the golden file says`);
}

function checkLandmarks(bundle, checks) {
  const points = member(checks, "landmarks", "list", GOLDEN).map((name) => {
    const found = bundle.manifest.landmarks.find((mark) => mark.name === name);
    if (found === undefined) fail("case.json lacks a landmark that the golden file names");
    return found.points_mm[0];
  });
  if (points.length !== 4) fail("the golden file does not name four landmarks");
  const volumes = member(checks, "chirality_frames", "object", GOLDEN);
  for (const [name, frame] of Object.entries(FRAMES)) {
    const marks = points.map((point) => fromLps(frame, point));
    checkChirality(member(checks, "chirality_lps_mm3", "number", GOLDEN), marks, frame);
    if (Object.hasOwn(volumes, name)) checkNumber("volume of the landmarks", signedVolume(marks), volumes[name], 1e-6);
  }
}

function checkNumbers(bundle, lattice, checks) {
  for (const [name, count] of Object.entries(member(checks, "counts", "object", GOLDEN)))
    checkNumber("counts", bundle.counts.get(name), count, 0);
  const massKg = lattice.mass.reduce((sum, mass) => sum + mass, 0);
  checkNumber("mass of all nodes", 1e3 * massKg, member(checks, "mass_g", "number", GOLDEN), 1e-6);
  const { triangles, vertices } = bundle.files.surface;
  const volume = enclosedVolumeMm3(triangles.values, vertices.values);
  checkNumber("volume inside the surface", volume, member(checks, "enclosed_mm3", "number", GOLDEN), 1e-5);
  if (!bundle.files.scan) return;
  const { scan, scanValues } = bundle.manifest;
  for (const voxel of member(checks, "scan", "list", GOLDEN)) {
    const index = member(voxel, "index", "point", GOLDEN);
    const place = pointAt(scan, index);
    if (!member(voxel, "lps_mm", "point", GOLDEN).every((x, axis) => Math.abs(x - place[axis]) <= 1e-5))
      fail("a voxel of the golden file lies elsewhere");
    const stored = bundle.files.scan.intensity.values[(index[2] * scan.size[1] + index[1]) * scan.size[0] + index[0]];
    const intensity = scanValues.slope * stored + scanValues.intercept;
    if (!(Math.abs(intensity - member(voxel, "intensity", "number", GOLDEN)) <= 1e-6))
      fail("a voxel of the golden file has another intensity");
  }
}

async function runGolden(bundle, file, print) {
  const buffer = await folderReader(path.dirname(file))(path.basename(file), GOLDEN);
  const golden = parseJson(new Uint8Array(buffer), GOLDEN);
  if (member(golden, "format", "text", GOLDEN) !== "heartcase-golden") fail("the golden file is not one");
  checkLandmarks(bundle, member(golden, "checks", "object", GOLDEN));
  const tolerance = member(member(golden, "tolerance_mm", "object", GOLDEN), "float64", "positive", GOLDEN);
  const [stepS, damping] = ["step_s", "damping_per_s"].map((key) => member(golden, key, "number", GOLDEN));
  const gravity = member(golden, "gravity_m_s2", "point", GOLDEN);
  const [steps, surface] = ["steps", "surface"].map((key) => member(golden, key, "object", GOLDEN));
  const lattice = buildLattice(bundle);
  const carry = surfaceCarrier(bundle, lattice);
  checkSurfaceAtRest(bundle, lattice, carry);
  checkNumbers(bundle, lattice, member(golden, "checks", "object", GOLDEN));
  const state = atRest(lattice);
  for (const [node, offset] of member(member(golden, "start", "object", GOLDEN), "displacement_mm", "list", GOLDEN)) {
    if (!(node >= 0 && node < bundle.manifest.node_count)) fail("the golden file moves a node that is not there");
    state.displacement.set(
      offset.map((x) => 1e-3 * x),
      3 * node,
    );
  }
  const counts = [...Object.keys(steps), ...Object.keys(surface)].map(Number);
  if (counts.length === 0 || !counts.every((n) => Number.isInteger(n) && n >= 0 && n <= 100_000))
    fail("the golden file holds steps that cannot be compared");
  for (let count = 0; count <= Math.max(...counts); count += 1) {
    if (count > 0) step(lattice, state, stepS, damping, gravity);
    if (Object.hasOwn(steps, count))
      compare(`nodes after ${count} steps`, nodePositionsMm(lattice, state), steps[count].nodes_mm, tolerance, print);
    if (Object.hasOwn(surface, count)) {
      // A golden file's surface 0 lies over the nodes at rest, not over the start.
      const found = carry(nodePositionsMm(lattice, count === 0 ? atRest(lattice) : state));
      compare(`vertices after ${count} steps`, found.vertices, surface[count].vertices_mm, tolerance, print);
      if (Object.hasOwn(surface[count], "normals"))
        compare(`normals after ${count} steps`, found.normals, surface[count].normals, tolerance, print);
    }
  }
}

function runSteps(bundle, count, printNodes, print) {
  let start = performance.now();
  const lattice = buildLattice(bundle);
  const carry = surfaceCarrier(bundle, lattice);
  checkSurfaceAtRest(bundle, lattice, carry);
  const buildS = seconds(start);
  const state = atRest(lattice);
  start = performance.now();
  for (let n = 0; n < count; n += 1) step(lattice, state, bundle.manifest.step_default_s, 10, [0, 0, -9.81]);
  const stepS = seconds(start);
  const nodes = nodePositionsMm(lattice, state);
  start = performance.now();
  const surface = carry(nodes);
  const size = `nodes ${nodes.length / 3}, springs ${lattice.first.length}, vertices ${surface.vertices.length / 3}`;
  print(`${size}; build ${buildS} s, ${count} steps ${stepS} s, surface ${seconds(start)} s`);
  if (printNodes) for (let n = 0; n < nodes.length; n += 3) print(nodes.slice(n, n + 3).join(" "));
}

// Returns the exit code.
export async function main(given, print = console.log, complain = console.error) {
  try {
    const options = given.filter((text) => text.startsWith("--"));
    const [folder, goal, ...more] = given.filter((text) => !text.startsWith("--"));
    if (goal === undefined || more.length > 0) fail("give a case and a golden file, or a case and a number of steps");
    const start = performance.now();
    const bundle = await openCase(folderReader(folder), [], { checkHashes: !options.includes("--no-hashes") });
    print(`opened in ${seconds(start)} s`);
    if (/^[0-9]{1,9}$/.test(goal)) runSteps(bundle, Number(goal), options.includes("--nodes"), print);
    else await runGolden(bundle, goal, print);
    return 0;
  } catch (error) {
    complain(
      error instanceof HeartcaseError ? error.message : "there is not enough memory, or the case cannot be read",
    );
    return 1;
  }
}
