// What may be said of a place where two outlines touch: which statement of the recipe is of it, and whether it fits what was built.

import assert from "node:assert/strict";
import { test } from "node:test";

class Node {
  children = [];
  textContent = "";
  hidden = false;
  append(...children) {
    this.children.push(...children);
  }
  addEventListener(_, act) {
    this.act = act;
  }
}
globalThis.document = { createElement: () => new Node() };
const { Contacts } = await import("../../../heartcase/studio/page/building/contacts.js");
const { wallLabel } = await import("../../../heartcase/studio/page/painting/panel/paint_here.js");
const { Signal } = await import("../../../heartcase/studio/page/shared/signal.js");
const { say } = await import("../../../heartcase/studio/page/shared/words.js");

const BETWEEN = ["left ventricle", "right ventricle"];
/** A statement about the two. */
const wall = (x, radius) => ({ between: BETWEEN, position_mm: [x, 0, 0], radius_mm: radius, is_open: false });
const place = (x, state) => ({ between: BETWEEN, thickness_mm: 1.5, area_mm2: 30, center_mm: [x, 0, 0], radius_mm: 6, state });

/** The page with what a recipe states. @param {object[]} lines */
function begun(lines) {
  const shape = new Signal(null);
  const removed = [];
  const contacts = new Contacts({ shape, remove: ({ number }) => removed.push(number), add: () => {} }, () => Promise.resolve({ url: "" }));
  const states = (now) => (shape.value = { lines: { "walls.contact": now, "walls.septum": [] } });
  states(lines);
  /** Words of a place's row, its buttons among them, without those that are always there. */
  const words = (one) => {
    const found = [];
    const gather = (node) => (node.children.length > 0 ? node.children.forEach(gather) : found.push(node.textContent));
    gather(contacts.grownRow(one, () => {}));
    return found.slice(found.indexOf(say("contact_fly")) + 1);
  };
  return { contacts, states, words, removed };
}
const BUTTONS = [say("contact_real"), say("contact_is_wall")];

test("a statement that does not reach over a place is told of once it was built, with what may be said", () => {
  // of A, at 0; the centre of B lies in it, and B reaches farther
  const { contacts, states, words } = begun([wall(0, 12)]);
  assert.deepEqual(words(place(10, "grown")), [`${say("contact_said_wall")} ${say("contact_noted")}`, say("contact_back")]);
  contacts.setCurrent(true);
  assert.deepEqual(words(place(0, "confirmed")), [say("contact_said_wall"), say("contact_back")]);
  assert.deepEqual(words(place(10, "grown")), [say("contact_unfit"), ...BUTTONS]);
  // said again: the next build notes it, also while it is not known yet that the case is older
  states([wall(0, 12), wall(10, 7)]);
  assert.deepEqual(words(place(10, "grown")), [`${say("contact_said_wall")} ${say("contact_noted")}`, say("contact_back")]);
  contacts.setCurrent(false);
  contacts.setCurrent(true);
  assert.deepEqual(words(place(10, "confirmed")), [say("contact_said_wall"), say("contact_back")]);
});

test("of several statements the nearest is of a place", () => {
  const { contacts, removed } = begun([wall(0, 12), wall(9, 7), { ...wall(10, 7), between: ["aorta", "right ventricle"] }]);
  const body = contacts.grownRow(place(10, "confirmed"), () => {}).children[1];
  body.children.at(-1).children.at(-1).act({ detail: 1 });
  assert.deepEqual(removed, [2]);
});

test("what a page is told before it knows the recipe counts as built", () => {
  const { contacts, words } = (() => {
    const shape = new Signal(null);
    const made = new Contacts({ shape }, () => Promise.resolve({ url: "" }));
    made.setCurrent(true);
    shape.value = { lines: { "walls.contact": [wall(0, 12)], "walls.septum": [] } };
    return { contacts: made, words: (one) => made.grownRow(one, () => {}) };
  })();
  let told = 0;
  contacts.onSaid = () => (told += 1);
  const texts = JSON.stringify(words(place(10, "grown")));
  assert.ok(texts.includes(say("contact_unfit")));
  contacts.setCurrent(true);
  assert.equal(told, 0);
  contacts.setCurrent(false);
  assert.equal(told, 1);
});

test("a wall against the outside: one button, then what was asked for", () => {
  const set = [];
  const shape = new Signal(null);
  const contacts = new Contacts({ shape, set: (path, value) => set.push([path, value]) }, () => Promise.resolve({ url: "" }));
  let told = 0;
  contacts.onSaid = () => (told += 1);
  const walls = (mm, has_table = false) => (shape.value = { lines: {}, walls: [{ label: "LV", term: null, wall_thickness_mm: mm, has_table }] });
  assert.deepEqual(contacts.wallActs("LV"), []);
  walls(0);
  const [button] = contacts.wallActs("LV");
  assert.equal(button.textContent, say("contact_outer_wall"));
  button.act({ detail: 1 });
  assert.deepEqual(set, [[["labels", "LV", "wall_thickness_mm"], 1.5]]);
  walls(1.5);
  assert.ok(contacts.wallActs("LV")[0].textContent.includes("1.5 mm"));
  assert.equal(told, 2);
  assert.deepEqual(contacts.wallActs("RV"), []);
  walls(0, true);
  assert.deepEqual(contacts.wallActs("LV"), []);
});

test("an opening that may be wall: painted there with the muscle of its ventricle", () => {
  const labels = [
    { value: 0, name: "background", role: "background" },
    { value: 1, name: "morphologically left ventricle", role: "blood" },
    { value: 9, name: "morphologically left ventricular myocardium", role: "myocardium" },
    { value: 10, name: "morphologically right ventricular myocardium", role: "myocardium" },
  ];
  assert.equal(wallLabel(labels, ["right atrium", "morphologically right ventricle"]), 10);
  assert.equal(wallLabel(labels, ["morphologically right ventricle", "morphologically left ventricle"]), 9);
  assert.equal(wallLabel(labels, ["left atrium", "right atrium"]), 0);
  assert.equal(wallLabel(labels.slice(0, 3), ["morphologically right ventricle", "pulmonary artery"]), 9);
  assert.equal(wallLabel(labels, ["left atrium"]), null);
  assert.equal(wallLabel(labels.slice(0, 3), ["cavity"]), 9);
  // a recipe that calls them otherwise
  const short = ["background", "LV", "LV myo", "RV myo"].map((name, at) => ({ ...labels[at], name }));
  const structures = short.map(({ name }, at) => ({ name, term: at > 0 ? labels[at].name : null }));
  structures.push({ name: "RV", term: "morphologically right ventricle" });
  assert.equal(wallLabel(short, ["LV", "RV"], structures), 9);
  assert.equal(wallLabel(short.slice(0, 3), ["LV", "RV"], structures), 9);
  assert.equal(wallLabel(short, ["RV"], structures), 10);
  const shape = new Signal({ lines: { "walls.contact": [], "walls.septum": [] }, walls: [{ label: "RV", term: null, wall_thickness_mm: 0, has_table: false }] });
  const painted = [];
  const contacts = new Contacts({ shape }, () => Promise.resolve({ url: "" }), (between) => (mm) => painted.push([between, mm]));
  const opening = { between: ["aorta", "right ventricle"], area_mm2: 30, center_mm: [1, 2, 3], reach_mm: 4 };
  const words = (verdict) => contacts.openingActs({ ...opening, verdict }).slice(1).map(({ textContent }) => textContent);
  assert.deepEqual(words("other ventricle"), [say("contact_real"), say("contact_paint")]);
  assert.deepEqual(words("unexpected"), [say("contact_real"), say("contact_grow"), say("contact_paint")]);
  contacts.openingActs({ ...opening, verdict: "other ventricle" }).at(-1).act({ detail: 1 });
  const [, outer] = contacts.wallActs("RV", () => [4, 5, 6]);
  outer.act({ detail: 1 });
  assert.deepEqual(painted, [[opening.between, [1, 2, 3]], [["RV"], [4, 5, 6]]]);
});
