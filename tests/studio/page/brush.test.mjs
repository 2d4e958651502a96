// Strokes as they are sent: at once, or one message a frame, never far ahead of the server, always closed.

import assert from "node:assert/strict";
import test from "node:test";
import { Lost, Refused } from "../../../heartcase/studio/page/shared/connection.js";
import { Studio } from "../../../heartcase/studio/page/painting/studio.js";
import { Brush } from "../../../heartcase/studio/page/painting/tools/brush.js";

/** A server whose answers and frames come when the test says so. */
function scene() {
  const studio = new Studio();
  studio.labels.value = [{ value: 3, name: "aorta", colour: "#ff0000", role: "vessel_lumen" }];
  studio.picked.value = 3;
  studio.radiusMm.value = 2;
  studio.ready.value = true;
  const sent = [];
  const answers = [];
  const frames = [];
  const refused = [];
  const ask = (request) => {
    sent.push(request);
    return new Promise((resolve, reject) => answers.push({ resolve, reject }));
  };
  const brush = new Brush(studio, ask, (problems) => refused.push(...problems), (callback) => frames.push(callback));
  const settle = () => new Promise((resolve) => setImmediate(resolve));
  return {
    studio, sent, refused, brush, settle, answers,
    frame: () => frames.splice(0).forEach((callback) => callback()),
    answer: async (count = 1) => {
      answers.splice(0, count).forEach(({ resolve }) => resolve({}));
      await settle();
    },
  };
}

test("a stroke: begun at once, its points of a frame together, ended after the last answer", async () => {
  const { brush, sent, frame, answer, studio } = scene();
  assert.ok(brush.begin([1.00049, 2, 3], false));
  assert.deepEqual(sent, [{ do: "paint", label: "aorta", radius_mm: 2, points_mm: [[1, 2, 3]] }]);
  brush.extend([[2, 2, 3], [3, 2, 3]]);
  brush.extend([[4, 2, 3]]);
  assert.equal(sent.length, 1);
  frame();
  assert.deepEqual(sent[1], { do: "extend", points_mm: [[2, 2, 3], [3, 2, 3], [4, 2, 3]] });
  assert.equal(studio.stroke.value.points.length, 4);
  brush.end();
  assert.equal(sent.length, 2);
  await answer(1);
  assert.equal(sent.length, 2);
  await answer(1);
  assert.deepEqual(sent[2], { do: "end" });
  assert.equal(studio.stroke.value, null);
  assert.equal(brush.isBusy, false);
});

test("a point is sent at once while nothing is under way, and what came meanwhile with the answer", async () => {
  const { brush, sent, answer } = scene();
  brush.begin([0, 0, 0], false);
  await answer();
  brush.extend([[2, 0, 0]]);
  assert.deepEqual(sent[1], { do: "extend", points_mm: [[2, 0, 0]] });
  brush.extend([[4, 0, 0]]);
  brush.extend([[6, 0, 0]]);
  assert.equal(sent.length, 2);
  await answer();
  assert.deepEqual(sent[2], { do: "extend", points_mm: [[4, 0, 0], [6, 0, 0]] });
});

test("where the server is slow points wait, and none is lost", async () => {
  const { brush, sent, frame, answer } = scene();
  brush.begin([0, 0, 0], false);
  for (let n = 1; n <= 50; n++) {
    brush.extend([[n, 0, 0]]);
    frame();
  }
  assert.equal(sent.length, 2);
  brush.end();
  while (sent.at(-1).do !== "end") await answer(1);
  const points = sent.flatMap((request) => request.points_mm ?? []);
  assert.deepEqual(points.map(([x]) => x), Array.from({ length: 51 }, (_, n) => n));
  assert.ok(sent.length < 8);
});

test("positions that add nothing are left out", () => {
  const { brush, sent, frame } = scene();
  brush.begin([0, 0, 0], false);
  brush.extend([[0.1, 0, 0], [0.19, 0, 0], [0.2, 0, 0]]);
  frame();
  assert.deepEqual(sent[1].points_mm, [[0.2, 0, 0]]);
});

test("erasing names no structure", () => {
  const { brush, sent, studio } = scene();
  studio.picked.value = null;
  assert.equal(brush.begin([0, 0, 0], false), false);
  assert.ok(brush.begin([0, 0, 0], true));
  assert.deepEqual(sent, [{ do: "paint", erase: true, radius_mm: 2, points_mm: [[0, 0, 0]] }]);
});

test("nothing is painted while there is no connection, nor a second stroke during the first", () => {
  const { brush, sent, studio } = scene();
  studio.ready.value = false;
  assert.equal(brush.begin([0, 0, 0], false), false);
  studio.ready.value = true;
  assert.ok(brush.begin([0, 0, 0], false));
  assert.equal(brush.begin([0, 0, 0], false), false);
  brush.end();
  assert.equal(sent.length, 1);
});

test("a refused stroke is over, is said, and is not ended: there is none", async () => {
  const { brush, sent, studio, answers, refused, settle, frame } = scene();
  brush.begin([0, 0, 0], false);
  answers.shift().reject(new Refused([{ place: "stroke", message: "lies outside" }]));
  await settle();
  brush.extend([[9, 0, 0]]);
  frame();
  brush.end();
  await settle();
  assert.deepEqual(sent.map((request) => request.do), ["paint"]);
  assert.deepEqual(refused, [{ place: "stroke", message: "lies outside" }]);
  assert.equal(studio.stroke.value, null);
  assert.ok(brush.begin([0, 0, 0], false));
});

test("a refused part leaves the stroke before it, which is ended", async () => {
  const { brush, sent, answers, settle, frame, answer } = scene();
  brush.begin([0, 0, 0], false);
  await answer(1);
  brush.extend([[9, 0, 0]]);
  frame();
  answers.shift().reject(new Refused([]));
  await settle();
  brush.end();
  assert.deepEqual(sent.map((request) => request.do), ["paint", "extend", "end"]);
});

test("a lost connection lets the stroke go", async () => {
  const { brush, sent, studio, answers, settle } = scene();
  brush.begin([0, 0, 0], false);
  answers.shift().reject(new Lost());
  brush.drop();
  await settle();
  assert.equal(brush.isBusy, false);
  assert.equal(studio.stroke.value, null);
  assert.ok(brush.begin([1, 1, 1], false));
  assert.deepEqual(sent.map((request) => request.do), ["paint", "paint"]);
});

test("a stroke that is drawn while the one before is worked out is not lost", async () => {
  const { brush, sent, studio, settle, frame, answer } = scene();
  brush.begin([0, 0, 0], false);
  brush.end();
  assert.ok(brush.begin([50, 0, 0], false));
  brush.extend([[59, 0, 0]]);
  frame();
  brush.end();
  assert.ok(brush.begin([90, 0, 0], true));
  brush.extend([[99, 0, 0]]);
  frame();
  assert.ok(brush.isBusy);
  assert.deepEqual(sent.map((request) => request.do), ["paint"]);
  await answer(1);
  await settle();
  // the second is whole when its turn comes; the third is still being drawn
  assert.deepEqual(sent.map((request) => request.do), ["paint", "end", "paint"]);
  await answer(sent.length);
  await settle();
  for (let n = 0; n < 6; n++) {
    await answer(1).catch(() => undefined);
    await settle();
  }
  brush.extend([[105, 0, 0]]);
  frame();
  brush.end();
  for (let n = 0; n < 6; n++) {
    await answer(1).catch(() => undefined);
    await settle();
  }
  const strokes = sent.filter((request) => request.do !== "end");
  assert.deepEqual(
    strokes.map(({ do: kind, points_mm: points }) => [kind, points.at(-1)[0]]),
    [["paint", 0], ["paint", 50], ["extend", 59], ["paint", 90], ["extend", 99], ["extend", 105]],
  );
  assert.equal(strokes[3].erase, true);
  assert.equal(sent.filter((request) => request.do === "end").length, 3);
  assert.equal(brush.isBusy, false);
  assert.equal(studio.stroke.value, null);
});
