// The preview of the surface: a first look is not the preview.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Preview } from "../../../heartcase/studio/page/shaping/preview.js";

test("until the fine look that follows the first one is there, it works", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const settled = () => new Promise((resolve) => setImmediate(resolve));
  /** @type {{coarse: boolean, answer: (answer: object) => void}[]} */
  const asked = [];
  const ask = ({ coarse }) => new Promise((answer) => asked.push({ coarse, answer }));
  let waits = false;
  const preview = new Preview({}, ask, (error) => assert.fail(error), () => waits);
  preview.isOn.value = true;
  context.mock.timers.tick(20);
  assert.deepEqual(asked.map(({ coarse }) => coarse), [true]);
  const told = [];
  preview.isBusy.listen((isBusy) => told.push(isBusy));
  asked[0].answer({ problems: [{ place: "ends[1]", message: "beside the vessel" }] });
  await settled();
  assert.equal(preview.isBusy.value, true);
  // not while a stroke is drawn, or labels have still to come
  waits = true;
  context.mock.timers.tick(500);
  await settled();
  assert.deepEqual(asked.map(({ coarse }) => coarse), [true]);
  assert.equal(preview.isBusy.value, true);
  waits = false;
  context.mock.timers.tick(500);
  await settled();
  assert.deepEqual(asked.map(({ coarse }) => coarse), [true, false]);
  asked[1].answer({ problems: [{ place: "ends[1]", message: "beside the vessel" }] });
  await settled();
  assert.deepEqual(told, [false]);
  assert.equal(preview.problems.value.length, 1);
});
