// Labels that come bit by bit: the rest waits while a stroke goes on.

import assert from "node:assert/strict";
import test from "node:test";
import { Signal } from "../../../heartcase/studio/page/shared/signal.js";
import { Seen } from "../../../heartcase/studio/page/painting/pictures/seen.js";

test("pieces of the rest are asked for one after the other, when labels have not changed for a while", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let now = 1000;
  context.mock.method(performance, "now", () => now);
  const asked = [];
  let left = 3;
  const ask = (request) => {
    asked.push(request.do);
    left -= 1;
    return Promise.resolve({ rest: left > 0 });
  };
  const studio = { crosshair: new Signal([0, 0, 0]), planes: new Signal(null), ready: new Signal(true), spreads: new Signal(false) };
  const seen = new Seen({ all: [], waits: false }, studio, ask, (error) => assert.fail(error), (callback) => callback());
  const wait = async (ms) => {
    for (let n = 0; n < ms; n += 10) {
      now += 10;
      context.mock.timers.tick(10);
      for (let turn = 0; turn < 4; turn++) await Promise.resolve();
    }
  };
  // ten movements of a stroke
  for (let n = 0; n < 10; n++) {
    seen.tell(true, true);
    await wait(40);
    assert.deepEqual(asked, []);
  }
  // a first look at the surface goes first
  let yields = true;
  seen.yields = () => yields;
  await wait(200);
  assert.deepEqual(asked, []);
  yields = false;
  await wait(20);
  assert.equal(asked[0], "rest");
  await wait(100);
  assert.deepEqual(asked, ["rest", "rest", "rest"]);
});
