// What the heart leaves on the graphics card, and whose normal map it shows.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Heart } from "../../../heartcase/studio/page/operating/heart.js";
import { ToolsInScene } from "../../../heartcase/studio/page/operating/tools_in_scene.js";

const FACES = 256;

/** A surface with one cut face, as a message: a topology, or a coarser level. @param {object} more of its header */
function message(more) {
  const parts = {
    rest_mm: Float32Array.from([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 1, 0, 0, 1, 1, 0, 1, 0.5, -1]),
    triangles: Uint32Array.from([0, 1, 2, 0, 2, 3, 4, 6, 5]),
    normal_nodes: Int32Array.from([0]), spring_first: Int32Array.from([0, 0]), spring_neighbours: new Int32Array(0), spring_offset: new Float32Array(0),
    structure: Uint16Array.from([3, 3, 3, 3, FACES, FACES, FACES]),
  };
  const arrays = {};
  const bytes = [];
  for (const [name, numbers] of Object.entries(parts)) {
    arrays[name] = { dtype: numbers.constructor.name.replace("Array", "").toLowerCase(), shape: [numbers.length], at: bytes.length };
    bytes.push(...new Uint8Array(numbers.buffer));
  }
  const header = { arrays, node_count: 1, topology: 1, cut_faces: FACES, cell_mm: 1, origin_mm: [0, 0, 0], direction: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], ...more };
  return { header, bytes: Uint8Array.from(bytes) };
}

test("of a surface that is replaced nothing stays, the lines of its cuts neither", () => {
  const heart = new Heart({ add: () => {}, remove: () => {} });
  heart.takeTopology(message({}));
  heart.takeCoarse(message({ level: 1 }));
  const meshes = [heart.mesh, heart.coarse[0].mesh];
  const [left, disposed] = [new Set(), new Set()];
  for (const mesh of meshes) {
    assert.equal(mesh.children.length, 1);
    for (const one of [mesh.geometry, mesh.children[0].geometry, mesh.children[0].material]) {
      left.add(one);
      one.addEventListener("dispose", () => disposed.add(one));
    }
  }
  heart.takeTopology(message({ topology: 2 }));
  assert.deepEqual(disposed, left);
});

test("a normal map is of the case that is shown, and goes with it", async () => {
  /** @type {((picture: any) => void)[]} */
  const decoded = [];
  const closed = [];
  const picture = (name) => ({ name, width: 1, height: 1, close: () => closed.push(name) });
  globalThis.createImageBitmap = () => new Promise((resolve) => decoded.push(resolve));
  const heart = new Heart({ add: () => {}, remove: () => {} });
  const { normalMap, hasMap } = heart.uniforms;
  heart.forgetNormalMap();
  const first = heart.takeNormalMap(new Uint8Array(1));
  decoded[0](picture("first"));
  await first;
  assert.equal(hasMap.value, true);
  let wasDisposed = false;
  normalMap.value.addEventListener("dispose", () => (wasDisposed = true));
  // decoded only when the next case is open, which has none
  const late = heart.takeNormalMap(new Uint8Array(1));
  heart.forgetNormalMap();
  assert.ok(wasDisposed);
  assert.deepEqual(closed, ["first"]);
  decoded[1](picture("late"));
  await late;
  assert.equal(hasMap.value, false);
  assert.deepEqual(closed, ["first", "late"]);
});

test("a stitch is seen also where its places lie together", () => {
  const added = [];
  const scene = { add: (one) => added.push(one) };
  const tools = new ToolsInScene(scene, scene);
  const shows = () => [tools.stitches, tools.knots].map((one) => one.visible);
  const places = [[1, 2, 3], [1, 2, 3]];
  assert.ok(tools.show({ device: null, instruments: [], patches: [], stitches: [{ places_mm: places }] }, {}));
  assert.deepEqual(shows(), [true, true]);
  assert.ok(tools.knots.isPoints && tools.knots.material.size > 1 && added.includes(tools.knots));
  assert.deepEqual([...tools.knots.geometry.attributes.position.array], places.flat());
  tools.show({ device: null, instruments: [], patches: [], stitches: [] }, {});
  assert.deepEqual(shows(), [false, false]);
});
