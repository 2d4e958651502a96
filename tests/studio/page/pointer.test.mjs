// Fingers and a pen on the picture: one turns or uses what is in hand, two zoom and move, and nothing stays held.

import assert from "node:assert/strict";
import test from "node:test";
import { Camera } from "../../../heartcase/studio/page/operating/camera.js";
import { Pointer } from "../../../heartcase/studio/page/operating/pointer.js";

/** A surface that hears events, and what is asked on it. @param {{hasTool: boolean, answers?: Promise<any>[], twoFingersMove?: boolean}} given */
function begun({ hasTool, answers = [], twoFingersMove = false }) {
  const surface = new EventTarget();
  Object.assign(surface, { getBoundingClientRect: () => ({ left: 0, top: 0 }), setPointerCapture: () => {} });
  const camera = new Camera();
  Object.assign(camera, { width: 400, height: 400 });
  const asked = [];
  const pointer = new Pointer(surface, camera, {
    ask: (request) => {
      asked.push(request.do);
      return answers.shift() ?? Promise.resolve({ kind: "done", used: true });
    },
    answered: () => {}, failed: (error) => assert.fail(error), changed: () => {}, hasTool: () => hasTool, isReady: () => true, cursorMoved: () => {}, twoFingersMove,
  });
  const does = (type, pointerId, x, y, pointerType = "touch", more = {}) =>
    surface.dispatchEvent(Object.assign(new Event(type), { ...more, pointerId, pointerType, clientX: x, clientY: y, button: 0, shiftKey: false }));
  return { camera, asked, pointer, does };
}
const later = () => new Promise((resolve) => setTimeout(resolve, 5));

test("one finger turns, two turn and zoom, three move", () => {
  const { camera, asked, does } = begun({ hasTool: false });
  does("pointerdown", 1, 100, 100);
  does("pointermove", 1, 140, 100);
  assert.ok(camera.towards[0] < -0.2);
  const before = { distance: camera.distance, towards: [...camera.towards] };
  does("pointerdown", 2, 200, 100);
  does("pointermove", 2, 260, 100);
  assert.ok(Math.abs(camera.distance - before.distance / 2) < 1e-9);
  assert.notDeepEqual(camera.towards, before.towards);
  assert.deepEqual(camera.target, [0, 0, 0]);
  const turned = [...camera.towards];
  does("pointerdown", 3, 200, 200);
  does("pointermove", 3, 230, 200);
  assert.ok(Math.hypot(...camera.target) > 0);
  assert.deepEqual(camera.towards, turned);
  // the finger that is left does nothing until it is lifted
  does("pointerup", 3, 230, 200);
  does("pointerup", 1, 140, 100);
  does("pointermove", 2, 300, 180);
  assert.deepEqual(camera.towards, turned);
  does("pointerup", 2, 300, 180);
  does("pointerdown", 4, 100, 100);
  does("pointermove", 4, 140, 100);
  assert.notDeepEqual(camera.towards, turned);
  assert.deepEqual(asked, []);
});

test("where one finger turns always, two move and zoom", () => {
  const { camera, does } = begun({ hasTool: false, twoFingersMove: true });
  const { distance, towards } = camera;
  does("pointerdown", 1, 100, 100);
  does("pointerdown", 2, 200, 100);
  does("pointermove", 2, 300, 100);
  assert.ok(Math.abs(camera.distance - distance / 2) < 1e-9);
  assert.ok(Math.hypot(...camera.target) > 0);
  assert.deepEqual(camera.towards, towards);
});

test("a finger that moves alone uses what is in hand, and others do nothing until it is lifted", async () => {
  const { asked, does, camera } = begun({ hasTool: true });
  does("pointerdown", 1, 100, 100);
  does("pointermove", 1, 120, 100);
  await later();
  assert.deepEqual(asked, ["press", "drag"]);
  const { distance } = camera;
  does("pointerdown", 2, 200, 100);
  does("pointermove", 2, 280, 100);
  does("pointerup", 2, 280, 100);
  await later();
  assert.deepEqual(asked, ["press", "drag"]);
  assert.equal(camera.distance, distance);
  does("pointerup", 1, 120, 100);
  await later();
  assert.deepEqual(asked, ["press", "drag", "release"]);
});

test("two fingers that come down together use nothing", async () => {
  const { asked, does, camera } = begun({ hasTool: true });
  const { distance } = camera;
  does("pointerdown", 1, 100, 100);
  does("pointerdown", 2, 200, 100);
  does("pointermove", 2, 260, 100);
  await later();
  assert.deepEqual(asked, []);
  assert.ok(camera.distance < distance);
});

test("a hand that rests beside its pen does nothing", async () => {
  const { asked, does, camera } = begun({ hasTool: true });
  does("pointerdown", 1, 100, 100, "pen");
  await later();
  does("pointerdown", 2, 300, 300);
  does("pointermove", 2, 340, 340);
  does("pointermove", 1, 120, 100, "pen");
  await later();
  assert.deepEqual(asked, ["press", "drag"]);
  assert.equal(camera.distance, 100);
  does("pointerup", 1, 120, 100, "pen");
  await later();
  assert.deepEqual(asked, ["press", "drag", "release"]);
});

test("what is pressed again before the server has answered comes after it", async () => {
  const held = [];
  const answers = Array.from({ length: 8 }, () => new Promise((answer) => held.push(answer)));
  const { asked, pointer, does } = begun({ hasTool: true, answers });
  const answer = async () => (held.shift()({ kind: "done", used: true }), await later());
  // two clicks, and a drag, all before the first answer to each
  does("pointerdown", 1, 100, 100, "mouse");
  does("pointerup", 1, 100, 100, "mouse");
  does("pointerdown", 1, 150, 100, "mouse");
  does("pointerup", 1, 150, 100, "mouse");
  assert.deepEqual(asked, ["press"]);
  await answer();
  assert.deepEqual(asked, ["press", "release"]);
  does("pointermove", 1, 160, 100, "mouse");
  await answer();
  assert.deepEqual(asked, ["press", "release", "press"]);
  does("pointerdown", 1, 200, 100, "mouse");
  does("pointermove", 1, 220, 100, "mouse");
  await answer();
  await answer();
  assert.deepEqual(asked, ["press", "release", "press", "release", "press"]);
  await answer();
  assert.deepEqual(asked.slice(5), ["drag"]);
  assert.ok(pointer.isUsed);
  does("pointerup", 1, 220, 100, "mouse");
  await answer();
  assert.deepEqual(asked.slice(6), ["release"]);
  await answer();
  assert.ok(!pointer.isUsed);
});

test("what was pressed meanwhile is forgotten with all else", async () => {
  const held = [];
  const { asked, pointer, does } = begun({ hasTool: true, answers: [new Promise((answer) => held.push(answer))] });
  does("pointerdown", 1, 100, 100, "mouse");
  does("pointerup", 1, 100, 100, "mouse");
  does("pointerdown", 1, 150, 100, "mouse");
  pointer.forget();
  held[0]({ kind: "done", used: true });
  await later();
  does("pointerup", 1, 150, 100, "mouse");
  assert.deepEqual(asked, ["press"]);
});

test("the wheel zooms towards the pointer: what lies there stays there", () => {
  const { camera, does } = begun({ hasTool: false });
  const { right, up } = camera;
  const pointed = [0, 1, 2].map((i) => camera.target[i] + (300 - 200) * camera.mmPerPixel * right[i] + (200 - 120) * camera.mmPerPixel * up[i]);
  const near = (found, wanted) => found.forEach((one, i) => assert.ok(Math.abs(one - wanted[i]) < 1e-6, `${found} for ${wanted}`));
  near(camera.pixel(pointed), [300, 120]);
  const before = camera.distance;
  for (const deltaY of [-200, -200, 100]) {
    does("wheel", 0, 300, 120, "mouse", { deltaY, deltaMode: 0 });
    near(camera.pixel(pointed), [300, 120]);
  }
  assert.ok(camera.distance < 0.7 * before);
});
