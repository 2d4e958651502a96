// Undo and redo from keys: none is lost that comes before an answer, none is sent where nothing is to be taken back.

import assert from "node:assert/strict";
import test from "node:test";
import { Studio } from "../../../heartcase/studio/page/painting/studio.js";
import { Steps } from "../../../heartcase/studio/page/painting/tools/steps.js";

/** A page with some steps to take back, whose strokes and answers the test makes. */
function scene(undoCount = 2, redoCount = 0) {
  const studio = new Studio();
  studio.ready.value = true;
  const brush = { isBusy: false, isDown: false };
  const sent = [];
  const answers = [];
  const faults = [];
  const ask = (request) => {
    sent.push(request.do);
    return new Promise((resolve, reject) => answers.push({ resolve, reject }));
  };
  const steps = new Steps(studio, brush, ask, (error) => faults.push(error));
  steps.tell(undoCount, redoCount);
  const settle = () => new Promise((resolve) => setImmediate(resolve));
  return { studio, brush, sent, answers, faults, steps, settle };
}

test("redo pressed before undo was answered is sent after it", () => {
  const { steps, sent, studio } = scene(2, 0);
  steps.take("undo");
  steps.take("redo");
  steps.take("redo");
  assert.deepEqual(sent, ["undo", "redo"]);
  assert.deepEqual([studio.undoCount.value, studio.redoCount.value], [2, 0]);
});

test("the answer to what was asked before an undo does not hide it", async () => {
  const { steps, sent, studio, answers, settle } = scene(2, 0);
  steps.take("undo");
  steps.tell(3, 0);
  assert.deepEqual([studio.undoCount.value, studio.redoCount.value], [2, 1]);
  steps.take("redo");
  assert.deepEqual(sent, ["undo", "redo"]);
  steps.tell(2, 1);
  answers[0].resolve({});
  await settle();
  assert.deepEqual([studio.undoCount.value, studio.redoCount.value], [3, 0]);
  steps.tell(3, 0);
  answers[1].resolve({});
  await settle();
  assert.deepEqual([studio.undoCount.value, studio.redoCount.value], [3, 0]);
});

test("no more is taken back than there is", () => {
  const { steps, sent } = scene(1, 0);
  steps.take("undo");
  steps.take("undo");
  assert.deepEqual(sent, ["undo"]);
});

test("what is pressed while a stroke waits for its answer is done after it", async () => {
  const { steps, brush, sent, studio, settle } = scene(0, 0);
  studio.stroke.value = { points: [[0, 0, 0]], erases: false };
  brush.isBusy = true;
  steps.take("undo");
  await settle();
  assert.deepEqual(sent, []);
  steps.tell(1, 0);
  brush.isBusy = false;
  studio.stroke.value = null;
  await settle();
  assert.deepEqual(sent, ["undo"]);
});

test("while the pointer draws, or without a connection, nothing is taken back, then or later", async () => {
  const { steps, brush, sent, studio, settle } = scene();
  studio.stroke.value = { points: [[0, 0, 0]], erases: false };
  brush.isBusy = brush.isDown = true;
  steps.take("undo");
  brush.isBusy = brush.isDown = false;
  studio.stroke.value = null;
  await settle();
  studio.ready.value = false;
  steps.take("undo");
  assert.deepEqual(sent, []);
});

test("what waited for a stroke that was refused is dropped", async () => {
  const { steps, brush, sent, studio, settle } = scene();
  studio.stroke.value = { points: [[0, 0, 0]], erases: false };
  brush.isBusy = true;
  steps.take("undo");
  steps.drop();
  brush.isBusy = false;
  studio.stroke.value = null;
  await settle();
  assert.deepEqual(sent, []);
});

test("a refused step leaves the counts as they were, and is told", async () => {
  const { steps, answers, faults, studio, settle } = scene(2, 1);
  steps.take("undo");
  answers[0].reject(new Error("no"));
  await settle();
  assert.deepEqual([studio.undoCount.value, studio.redoCount.value], [2, 1]);
  assert.equal(faults.length, 1);
});
