// Words, messages, keys and the sizes of the brush.

import assert from "node:assert/strict";
import test from "node:test";
import { deflateSync } from "node:zlib";
import { unpack, waitMs } from "../../../heartcase/studio/page/shared/connection.js";
import { Studio } from "../../../heartcase/studio/page/painting/studio.js";
import { LANGUAGES, language, say, structureName } from "../../../heartcase/studio/page/shared/words.js";
import { Measures } from "../../../heartcase/studio/page/painting/tools/measures.js";
import { HELP, keyOf } from "../../../heartcase/studio/page/painting/tools/shortcuts.js";

test("every language has every sentence, with the same values in it", () => {
  const values = (/** @type {string} */ text) => [...text.matchAll(/\{(\w+)\}/g)].map(([, name]) => name).sort();
  for (const words of Object.values(LANGUAGES)) {
    assert.deepEqual(Object.keys(words).sort(), Object.keys(LANGUAGES.en).sort());
    for (const [key, text] of Object.entries(words)) {
      assert.notEqual(text.trim(), "", key);
      assert.deepEqual(values(text), values(LANGUAGES.en[key]), key);
    }
  }
  for (const [, word] of HELP) assert.ok(word in LANGUAGES.en);
});

test("values are put in as text, in the language chosen", () => {
  language.value = "de";
  assert.equal(say("slice_of", { at: 3, count: "<b>{at}" }), "3 von <b>{at}");
  language.value = "en";
  assert.equal(say("slice_of", { at: 3, count: 9 }), "3 of 9");
});

/** @param {object} header @param {Uint8Array} payload */
function packed(header, payload) {
  const head = new TextEncoder().encode(JSON.stringify(header));
  const data = new Uint8Array(4 + head.length + payload.length);
  new DataView(data.buffer).setUint32(0, head.length, true);
  data.set(head, 4);
  data.set(payload, 4 + head.length);
  return data.buffer;
}

test("binary messages are taken apart, compressed or not", async () => {
  const voxels = Uint8Array.from({ length: 1000 }, (_, n) => n % 7);
  for (const [encoding, payload] of [["raw", voxels], ["deflate", deflateSync(voxels)]]) {
    const { header, bytes } = await unpack(packed({ kind: "labels", name: "ä", encoding }, payload));
    assert.equal(header.name, "ä");
    assert.deepEqual(bytes, voxels);
  }
});

test("runs are spread out", async () => {
  const ends = Uint8Array.from([3, 0, 0, 0, 4, 0, 0, 0, 44, 1, 0, 0, 45, 1, 0, 0]);
  const payload = Uint8Array.from([...ends, 7, 0, 255, 9]);
  const { bytes } = await unpack(packed({ kind: "labels", encoding: "runs" }, payload));
  const wanted = [...new Array(3).fill(7), 0, ...new Array(296).fill(255), 9];
  assert.deepEqual([...bytes], wanted);
  await assert.rejects(unpack(packed({ kind: "labels", encoding: "runs" }, payload.slice(0, 19))));
});

test("binary messages that are none are refused", async () => {
  const header = { kind: "labels", encoding: "deflate" };
  await assert.rejects(unpack(new ArrayBuffer(3)));
  await assert.rejects(unpack(packed(header, new Uint8Array(9)).slice(0, 12)));
  await assert.rejects(unpack(packed(header, Uint8Array.of(1, 2, 3, 4, 5, 6))));
  await assert.rejects(unpack(packed({ ...header, encoding: "other" }, new Uint8Array(4))));
});

test("tries to connect come less and less often, but never stop", () => {
  assert.deepEqual([0, 1, 2, 3, 4, 5, 50, 2000].map(waitMs), [300, 600, 1200, 2400, 4800, 8000, 8000, 8000]);
});

test("number keys: 0 is the background, 1 to 9 the others in order", () => {
  const labels = Array.from({ length: 12 }, (_, value) => ({ value, role: value === 4 ? "background" : "blood" }));
  assert.equal(labels.map((label) => keyOf(label, labels)).join(","), "1,2,3,4,0,5,6,7,8,9,,");
});

test("each step changes the brush, within its bounds", () => {
  const studio = new Studio();
  for (const direction of [1, -1]) {
    const bound = direction > 0 ? 30 : 0.3;
    for (let n = 0; n < 200 && studio.radiusMm.value !== bound; n++) {
      const before = studio.radiusMm.value;
      studio.resizeBrush(direction);
      assert.ok((studio.radiusMm.value - before) * direction >= 0.0999);
    }
    assert.equal(studio.radiusMm.value, bound);
    studio.resizeBrush(direction);
    assert.equal(studio.radiusMm.value, bound);
  }
});

test("the tool before comes back", () => {
  const studio = new Studio();
  studio.take("ruler");
  studio.swapTools();
  assert.equal(studio.tool.value, "brush");
  studio.swapTools();
  assert.equal(studio.tool.value, "ruler");
});

test("rulers need two points, angles three; an unfinished one can be dropped", () => {
  const measures = new Measures();
  measures.set("ruler", [0, 0, 0]);
  measures.follow([1, 0, 0]);
  measures.set("ruler", [3, 4, 0]);
  assert.deepEqual(measures.all, [{ kind: "ruler", points: [[0, 0, 0], [3, 4, 0]] }]);
  measures.set("angle", [0, 0, 0]);
  measures.set("angle", [1, 0, 0]);
  assert.equal(measures.all[1].points.length, 3);
  assert.ok(measures.drop());
  assert.equal(measures.drop(), false);
  for (const x of [0, 1, 2]) measures.set("angle", [x, x * x, 0]);
  assert.deepEqual(measures.all[1].points, [[0, 0, 0], [1, 1, 0], [2, 4, 0]]);
  measures.removeLast();
  measures.removeLast();
  measures.removeLast();
  assert.deepEqual(measures.all, []);
});

test("structures of the vocabulary, and walls grown around and between them, are called by the language's names; others stay", () => {
  language.value = "de";
  const german = {
    "morphologically left ventricle": "linker Ventrikel",
    "Aorta": "Aorta",
    "pulmonary artery wall": "Wand: Pulmonalarterie",
    "left atrium-right atrium septum (grown)": "Septum: linker Vorhof – rechter Vorhof (gewachsen)",
    "left atrium graft": "left atrium graft",
    "my wall": "my wall",
    "a-b septum (grown)": "a-b septum (grown)",
  };
  for (const [name, said] of Object.entries(german)) assert.equal(structureName(name), said);
  language.value = "en";
  for (const name of Object.keys(german)) assert.equal(structureName(name), name);
});
