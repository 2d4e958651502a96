import assert from "node:assert/strict";
import { test } from "node:test";

import { tensionMissed } from "../../../heartcase/studio/page/operating/tied.js";

const drawn = (name, force, asked) => ({ name, force_n: force, drawn_n: asked, tied: false });
const tied = (name, force) => ({ name, force_n: force, drawn_n: null, tied: true });

test("a tension that was not reached is told with the one that was asked for", () => {
  assert.deepEqual(tensionMissed([drawn("a", 0.2, 1), drawn("b", 0.3, 1)], [tied("a", 0.1), tied("b", 0.4)]), { force: 0.4, asked: 1 });
});

test("one that was nearly reached, or was tied before, or is held by its length, is not", () => {
  assert.equal(tensionMissed([drawn("a", 0.95, 1)], [tied("a", 0.9)]), null);
  assert.equal(tensionMissed([tied("a", 0.1)], [tied("a", 0.1)]), null);
  assert.equal(tensionMissed([drawn("a", 0.1, null)], [tied("a", 0.1)]), null);
});
