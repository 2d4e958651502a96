import assert from "node:assert/strict";
import { test } from "node:test";

import { shortened } from "../../../heartcase/studio/page/start/lists.js";

test("a short path is shown whole", () => {
  assert.equal(shortened("work/hearts"), "work/hearts");
});

test("a long path keeps its last folders, whole", () => {
  const path = "work/studies of the year/twelve children/third child/second try";
  assert.equal(shortened(path), "…/twelve children/third child/second try");
  assert.ok(shortened(path).length <= 40);
});

test("a last folder with a long name is not cut", () => {
  const name = "n".repeat(60);
  assert.equal(shortened(`work/${name}`), `…/${name}`);
  assert.equal(shortened(name), name);
});
