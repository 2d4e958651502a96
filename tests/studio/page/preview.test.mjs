// The preview of the surface: a first look is not the preview.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Signal } from "../../../heartcase/studio/page/shared/signal.js";
import { Preview } from "../../../heartcase/studio/page/shaping/preview.js";

test("until the fine look that follows the first one is there, it works", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const settled = () => new Promise((resolve) => setImmediate(resolve));
  /** @type {{coarse: boolean, answer: (answer: object) => void}[]} */
  const asked = [];
  const ask = ({ coarse }) => new Promise((answer) => asked.push({ coarse, answer }));
  const stroke = new Signal(null);
  const preview = new Preview({ studio: { stroke } }, ask, (error) => assert.fail(error));
  preview.isOn.value = true;
  context.mock.timers.tick(20);
  assert.deepEqual(asked.map(({ coarse }) => coarse), [true]);
  const told = [];
  preview.isBusy.listen((isBusy) => told.push(isBusy));
  asked[0].answer({ problems: [{ place: "ends[1]", message: "beside the vessel" }] });
  await settled();
  assert.equal(preview.isBusy.value, true);
  // not while a stroke is drawn
  stroke.value = { points: [], erases: false };
  context.mock.timers.tick(500);
  await settled();
  assert.deepEqual(asked.map(({ coarse }) => coarse), [true]);
  assert.equal(preview.isBusy.value, true);
  stroke.value = null;
  context.mock.timers.tick(500);
  await settled();
  assert.deepEqual(asked.map(({ coarse }) => coarse), [true, false]);
  asked[1].answer({ problems: [{ place: "ends[1]", message: "beside the vessel" }] });
  await settled();
  assert.deepEqual(told, [false]);
  assert.equal(preview.problems.value.length, 1);
});
