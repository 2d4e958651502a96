import assert from "node:assert/strict";
import { test } from "node:test";

import { firstAct, momentsOf, Playing } from "../../../heartcase/studio/page/offline/playing.js";

const frame = (header = {}) => ({ header: { kind: "frame", ...header } });
const topology = { header: { kind: "topology" } };

/** A recording of some moments at ten a second, and a clock that a test turns. */
function opened(count) {
  const seen = { shown: [], parts: [], told: [] };
  const waiting = [];
  let now = 0;
  const clock = { now: () => now, picture: () => new Promise((done) => waiting.push(done)) };
  const playing = new Playing(10, {
    part: (part, isShown) => seen.parts.push([part.header.n, isShown]),
    shown: (at) => seen.shown.push(at),
    told: (isRunning) => seen.told.push(isRunning),
  }, clock);
  playing.open({}, Array.from({ length: count }, (_, n) => [frame({ n })]));
  const pictureAt = async (seconds) => {
    now = 1000 * seconds;
    for (const done of waiting.splice(0)) done();
    await new Promise(setImmediate);
  };
  return { playing, seen, pictureAt };
}

test("a moment is its frame with what came before", () => {
  const parts = [topology, frame(), frame(), topology];
  assert.deepEqual(momentsOf(parts), [[topology, parts[1]], [parts[2]]]);
  assert.deepEqual(momentsOf([]), []);
});

test("playing begins half a second before something is done", () => {
  const idle = Array.from({ length: 30 }, () => [frame({ instruments: [], cut_count: 0, patches: [], stitches: [] })]);
  assert.equal(firstAct(idle, 10), 0);
  for (const act of [{ instruments: [{}] }, { cut_count: 1 }, { patches: [{}] }, { stitches: [{}] }]) {
    assert.equal(firstAct([...idle, [frame(act)]], 10), 25);
    assert.equal(firstAct([[frame(act)], ...idle], 10), 0);
  }
});

test("it goes as time goes, through every moment between, and stands at the end", async () => {
  const { playing, seen, pictureAt } = opened(6);
  playing.play(1);
  await pictureAt(0.05);
  await pictureAt(0.25);
  assert.deepEqual(seen.shown, [1, 3]);
  assert.deepEqual(seen.parts, [[0, false], [1, true], [2, false], [3, true]]);
  await pictureAt(7);
  assert.equal(playing.at, 5);
  assert.deepEqual(seen.told, [true, false]);
  playing.playOrPause();
  assert.equal(playing.at, 0);
});

test("a speed counts from where it was chosen", async () => {
  const { playing, pictureAt } = opened(100);
  playing.play(0);
  await pictureAt(1);
  assert.equal(playing.at, 10);
  playing.setSpeed(4);
  await pictureAt(2);
  assert.equal(playing.at, 50);
  playing.setSpeed(0.5);
  await pictureAt(3);
  assert.equal(playing.at, 55);
});

test("going back goes through what led there, and pausing and going on leaves one that plays", async () => {
  const { playing, seen, pictureAt } = opened(10);
  playing.play(5);
  playing.playOrPause();
  playing.playOrPause();
  await pictureAt(0.2);
  assert.deepEqual(seen.shown, [5, 5, 7]);
  seen.parts.length = 0;
  playing.goTo(1);
  await pictureAt(9);
  assert.equal(playing.at, 1);
  assert.deepEqual(seen.parts, [[0, false], [1, true]]);
});

test("part of a tour stands where it ends, and nothing plays after it was left", async () => {
  const { playing, seen, pictureAt } = opened(10);
  playing.play(2, 4);
  await pictureAt(5);
  assert.equal(playing.at, 4);
  playing.play(4, 9);
  playing.leave();
  await pictureAt(6);
  assert.deepEqual(seen.shown, [2, 4, 4]);
  playing.goTo(3);
  playing.playOrPause();
  assert.equal(playing.of, null);
  assert.deepEqual(seen.shown, [2, 4, 4]);
});
