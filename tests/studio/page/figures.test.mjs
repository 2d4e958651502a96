// Figures of an incision: which are shown, and which mean nothing.

import assert from "node:assert/strict";
import test from "node:test";
import { KINDS, rows, trusted } from "../../../heartcase/studio/page/figures/live_figures.js";
import { language } from "../../../heartcase/studio/page/shared/words.js";

const none = Object.fromEntries(KINDS.OF_INCISION.map(([name]) => [name, null]));

test("the largest stretch and stress are left out while cells are inside out", () => {
  language.value = "en";
  const found = { ...none, gap_mm: 12.8, stretch: 4.18, stress_high_kpa: 10.9, stress_kpa: 549.9 };
  const names = (/** @type {number} */ count) => rows([trusted(found, count)], KINDS.OF_INCISION).map(([name]) => name);
  assert.deepEqual(names(0), ["Gap between the lips", "Largest stretch", "Stress, 99% below", "Largest stress"]);
  assert.deepEqual(names(8), ["Gap between the lips", "Stress, 99% below"]);
});

test("side by side it is left out of the one alone that has such cells", () => {
  const found = { ...none, stress_kpa: 20 };
  const [[, cells]] = rows([trusted(found, 0), trusted(found, 3)], KINDS.OF_INCISION);
  assert.deepEqual(cells, ["20.0 kPa", "–"]);
});
