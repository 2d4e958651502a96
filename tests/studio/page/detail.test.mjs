// How coarsely is drawn, with a clock of the test's own.

import assert from "node:assert/strict";
import test from "node:test";
import { Detail } from "../../../heartcase/studio/page/operating/detail.js";

/** @param {import("node:test").TestContext} context @param {boolean} isSlow */
function made(context, isSlow) {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let now = 10000;
  context.mock.method(performance, "now", () => now);
  const told = { drawn: 0, asked: 0 };
  const detail = new Detail(() => (told.drawn += 1), isSlow);
  detail.wanted = () => (told.asked += 1);
  const wait = (/** @type {number} */ ms) => {
    now += ms;
    context.mock.timers.tick(ms);
  };
  /** So many pictures in motion of so long. @param {number} count @param {number} ms */
  const draw = (count, ms) => {
    for (let n = 0; n < count; n++) {
      detail.moved();
      detail.drew(ms, detail.step.level);
      wait(ms);
    }
  };
  return { detail, told, wait, draw };
}

test("a quick machine draws all at its finest, and asks for nothing", (context) => {
  const { detail, told, draw } = made(context, false);
  detail.begin();
  draw(50, 10);
  assert.deepEqual(detail.step, { level: 0, part: 1 });
  assert.deepEqual(told, { drawn: 0, asked: 0 });
});

test("a slow one draws more and more coarsely, and what stands still at its finest, once", (context) => {
  const { detail, told, draw, wait } = made(context, false);
  detail.begin();
  draw(5, 120);
  assert.equal(detail.step.level, 1);
  assert.equal(told.asked, 1);
  draw(30, 60);
  assert.deepEqual(detail.step, { level: 2, part: 0.5 });
  assert.equal(told.asked, 1);
  wait(230);
  assert.equal(told.drawn, 0);
  wait(20);
  assert.deepEqual([detail.step, told.drawn], [{ level: 0, part: 1 }, 1]);
  wait(5000);
  assert.equal(told.drawn, 1);
});

test("one slow picture among quick ones changes nothing, and quick ones make it finer again", (context) => {
  const { detail, draw } = made(context, false);
  draw(2, 12);
  draw(1, 400);
  draw(2, 12);
  assert.equal(detail.step.level, 0);
  draw(5, 40);
  assert.equal(detail.step.level, 1);
  draw(20, 12);
  assert.equal(detail.step.level, 1);
  draw(5, 3);
  detail.moved();
  assert.equal(detail.step.level, 0);
});

test("a machine without a graphics card begins coarsely; a level that does not come is not waited for", (context) => {
  const { detail, told, wait } = made(context, true);
  detail.begin();
  assert.equal(told.asked, 1);
  detail.moved();
  assert.deepEqual(detail.step, { level: 1, part: 0.7 });
  for (let n = 0; n < 5; n++) detail.drew(90, 0);
  assert.equal(detail.step.level, 1);
  wait(5001);
  for (let n = 0; n < 5; n++) detail.drew(90, 0);
  detail.moved();
  assert.equal(detail.step.level, 2);
});
