// A place where a label is in doubt: it is right, or the other structure is painted there.

import assert from "node:assert/strict";
import { test } from "node:test";

class Node {
  hidden = false;
  textContent = "";
  acts = {};
  addEventListener(name, act) {
    this.acts[name] = act;
  }
  replaceChildren() {}
  append() {}
  click() {
    this.acts.click?.();
  }
}
const tab = new Node();
globalThis.document = { createElement: () => new Node(), getElementById: (id) => (id === "tab-structures" ? tab : null), activeElement: null };
const { Guide } = await import("../../../heartcase/studio/page/painting/panel/guide.js");
const { Studio } = await import("../../../heartcase/studio/page/painting/studio.js");
const { say } = await import("../../../heartcase/studio/page/shared/words.js");

const LABELS = [
  { value: 0, name: "background", role: "background", colour: "#000" },
  { value: 9, name: "left ventricle wall", role: "myocardium", colour: "#000" },
  { value: 10, name: "right ventricle wall", role: "myocardium", colour: "#000" },
];
const place = (rival) => ({ position_mm: [1, 2, 3], label: LABELS[1].name, rival, change_ml: 1, radius_mm: 2.4 });

function begun(places) {
  const studio = new Studio();
  studio.labels.value = LABELS;
  studio.ready.value = true;
  const seen = [];
  const views = { lookAt: (mm) => seen.push(mm), active: { surface: { focus: () => seen.push("focus") } } };
  const parts = { place: new Node(), right: new Node(), wrong: new Node(), checklist: new Node(), heading: new Node() };
  return { guide: new Guide(studio, views, async () => ({ places }), parts, assert.fail), studio, parts, seen };
}

test("no: the other structure is in hand, with a brush that fits, where the place is", async () => {
  const { guide, studio, parts, seen } = begun([place("right ventricle wall")]);
  studio.take("ruler");
  studio.hidden.value = new Set([10]);
  await guide.next();
  assert.equal(parts.right.hidden, false);
  assert.equal(parts.wrong.hidden, false);
  assert.ok(parts.wrong.textContent.startsWith(say("place_wrong", { label: "" }).slice(0, 6)));
  studio.crosshair.value = [7, 7, 7];
  parts.wrong.click();
  assert.equal(studio.picked.value, 10);
  assert.equal(studio.tool.value, "brush");
  assert.equal(studio.radiusMm.value, 2.3);
  assert.ok(!studio.hidden.value.has(10));
  assert.deepEqual(seen, [[1, 2, 3], [1, 2, 3], "focus"]);
});

test("where nothing is shown, or the other structure is not of the recipe, there is no such answer", async () => {
  const { guide, studio, parts } = begun([place("nothing of the recipe")]);
  guide.forget();
  assert.equal(parts.wrong.hidden, true);
  await guide.next();
  assert.equal(parts.right.hidden, false);
  assert.equal(parts.wrong.hidden, true);
  const before = studio.picked.value;
  guide.paint();
  assert.equal(studio.picked.value, before);
});
