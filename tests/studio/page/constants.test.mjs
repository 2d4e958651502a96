// What a label's elastic constants are after one of them was changed.

import assert from "node:assert/strict";
import { test } from "node:test";
import { constants } from "../../../heartcase/studio/page/shaping/panel.js";

const USUAL = { material: null, youngs_modulus_kpa: 30, density_kg_m3: 1060 };

test("a material is cleared also where nothing else is stated, and numbers stand in its place", () => {
  assert.deepEqual(constants({ material: "adult myocardium" }, USUAL, "material", null), USUAL);
  assert.deepEqual(constants({ youngs_modulus_kpa: 50 }, USUAL, "youngs_modulus_kpa", null), USUAL);
  assert.deepEqual(constants({ material: "x", youngs_modulus_kpa: 12 }, USUAL, "material", null), { youngs_modulus_kpa: 12 });
});

test("a material that is chosen states its numbers itself", () => {
  assert.deepEqual(constants({ youngs_modulus_kpa: 50 }, USUAL, "material", "x"), { material: "x" });
});
