import assert from "node:assert/strict";
import { test } from "node:test";

import { tensionMissed } from "../../../heartcase/studio/page/operating/tied.js";

const drawn = (name, force, asked) => ({ name, force_n: force, drawn_n: asked, tied: false });
const tied = (name, force) => ({ name, force_n: force, drawn_n: null, tied: true });

test("a tension that was not reached is told with the one that was asked for", () => {
  assert.deepEqual(tensionMissed([drawn("a", 0.2, 1)], [tied("a", 0.1)]), { name: "a", force: 0.2, asked: 1 });
  assert.deepEqual(tensionMissed([drawn("a", 0.2, 1)], [tied("a", 0.4)]), { name: "a", force: 0.4, asked: 1 });
});

test("each stitch is judged by itself, and the one that is furthest from its tension is told", () => {
  // one that reached its tension hides no other
  assert.deepEqual(tensionMissed([drawn("a", 1, 1), drawn("b", 0.1, 1)], [tied("a", 1), tied("b", 0.1)]), { name: "b", force: 0.1, asked: 1 });
  assert.deepEqual(tensionMissed([drawn("a", 0.5, 0.5), drawn("b", 0.5, 2)], [tied("a", 0.5), tied("b", 0.5)]), { name: "b", force: 0.5, asked: 2 });
  // a weaker pull on a stitch that was asked for less may be nearer to it
  const both = [drawn("a", 0.2, 0.25), drawn("b", 0.5, 1), drawn("c", 0.6, 1)];
  assert.deepEqual(tensionMissed(both, [tied("a", 0.2), tied("b", 0.5), tied("c", 0.6)]), { name: "b", force: 0.5, asked: 1 });
});

test("one that was nearly reached, or was tied before, or is held by its length, is not", () => {
  assert.equal(tensionMissed([drawn("a", 0.95, 1)], [tied("a", 0.9)]), null);
  assert.equal(tensionMissed([tied("a", 0.1)], [tied("a", 0.1)]), null);
  assert.equal(tensionMissed([drawn("a", 0.1, null)], [tied("a", 0.1)]), null);
});
