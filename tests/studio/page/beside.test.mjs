// Two recordings side by side: time of both together, and what comes after the line was lost.

import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

const elements = new Map();
const made = () => ({ hidden: false, textContent: "", dataset: {}, addEventListener: () => {}, setAttribute: () => {}, replaceChildren: () => {} });
globalThis.document = {
  getElementById: (id) => elements.get(id) ?? elements.set(id, made()).get(id),
  createElement: made,
};
globalThis.location = { pathname: "/operate/x", href: "http://127.0.0.1/operate/x", protocol: "http:" };
globalThis.requestAnimationFrame = () => {};
/** The line of the pane beside. @type {any} */
let socket;
globalThis.WebSocket = class extends EventTarget {
  static OPEN = 1;
  readyState = 1;
  sent = [];
  constructor() {
    super();
    socket = this;
    queueMicrotask(() => this.dispatchEvent(new Event("open")));
  }
  send(text) {
    this.sent.push(JSON.parse(text));
  }
  close() {}
};
const { Beside } = await import("../../../heartcase/studio/page/figures/beside.js");

const later = (ms = 5) => new Promise((resolve) => setTimeout(resolve, ms));
const heart = { forgetNormalMap: () => {}, paintStretch: () => {}, paint: () => {}, takeFrame: () => true };
const picture = { heart, tools: { show: () => true }, camera: {}, redraw: () => {}, end: () => {} };

/** @type {any} */
let main;
/** @type {any[]} */
let asked;
/** Name, place and message of each. @type {[string, string, string][]} */
let told;
/** @type {any} */
let beside;

/** What the server says beside. @param {object} message */
async function said(message) {
  socket.dispatchEvent(new MessageEvent("message", { data: JSON.stringify(message) }));
  await later();
}
const opened = () => said({ kind: "opened", stretch_colours: [] });
/** @param {object} header */
async function frame(header) {
  const text = new TextEncoder().encode(JSON.stringify({ kind: "frame", encoding: "raw", arrays: {}, frame: 1, ...header }));
  const data = new Uint8Array(4 + text.length);
  new DataView(data.buffer).setUint32(0, text.length, true);
  data.set(text, 4);
  socket.dispatchEvent(new MessageEvent("message", { data: data.buffer }));
  await later();
}
const wanted = () => socket.sent.filter((one) => one.do !== "seen").map(({ id, ...request }) => request);
/** What Operate does with what a user asks for. */
function pressPause() {
  const request = beside.pauseOrGoOn();
  asked.push(request);
  beside.pass(request);
  return request;
}

beforeEach(() => {
  [main, asked, told] = [null, [], []];
  beside = new Beside({ drawn: [] }, {
    askMain: (request) => asked.push(request), painted: () => [[], new Set()], mainHeader: () => main, shown: () => {},
    told: ({ name, place, message }) => told.push([name, place, message]), failed: (error) => assert.fail(error),
  }, () => picture);
});

/** Both play, that in the main pane so far ahead that it waits. */
async function mainWaits() {
  beside.open("b.recording", "a.recording");
  await opened();
  await said({ kind: "done", id: socket.sent[0].id });
  main = { mode: "playing", time_s: 2, end_s: 9 };
  await frame({ mode: "playing", time_s: 1, end_s: 8 });
  assert.deepEqual(asked, [{ do: "pause", paused: true }]);
  main.mode = "paused";
}

test("while one pane waits for the other, pause pauses both, and both go on with what is known", async () => {
  await mainWaits();
  assert.equal(beside.mode, "playing");
  assert.deepEqual(pressPause(), { do: "pause", paused: true });
  assert.deepEqual(wanted().at(-1), { do: "pause", paused: true });
  // frames that were under way: nobody waits or goes on by itself any more
  const count = asked.length;
  main.mode = "playing";
  await frame({ mode: "playing", time_s: 1.5, end_s: 8 });
  main.mode = "paused";
  await frame({ mode: "paused", time_s: 2.5, end_s: 8 });
  assert.equal(asked.length, count);
  assert.equal(beside.mode, "paused");
  assert.deepEqual(pressPause(), { do: "play", speed: 1 });
  assert.deepEqual(wanted().at(-1), { do: "play", speed: 1 });
});

test("one pane alone goes on from where it stands, as do two that know nothing ahead", async () => {
  main = { mode: "paused", time_s: 1, end_s: 9 };
  assert.deepEqual(beside.pauseOrGoOn(), { do: "pause", paused: false });
  await mainWaits();
  Object.assign(main, { time_s: 9 });
  await frame({ mode: "paused", time_s: 8, end_s: 8 });
  pressPause();
  assert.deepEqual(beside.pauseOrGoOn(), { do: "pause", paused: false });
});

test("after the line was lost the recording is played again where another session is shown, and only there", async () => {
  await mainWaits();
  assert.deepEqual(wanted(), [{ do: "replay", name: "b.recording", speed: 1 }]);
  socket.dispatchEvent(new Event("close"));
  await later(400);
  await opened();
  await frame({ mode: "playing", time_s: 1.5, end_s: 8 });
  assert.deepEqual(wanted(), []);
  socket.dispatchEvent(new Event("close"));
  await later(400);
  await said({ kind: "message", text: "it was closed", place: "", message: "it was closed" });
  await opened();
  await frame({ mode: "running", time_s: 0.1, end_s: 0.1 });
  assert.deepEqual(wanted(), [{ do: "replay", name: "b.recording", speed: 1 }]);
  assert.deepEqual(told, [["b", "", "it was closed"]]);
});

test("what is told beside keeps what it is about, after the recording's name", async () => {
  await mainWaits();
  await said({ kind: "message", text: "hand 1: it slipped", place: "hand 1", message: "it slipped" });
  assert.deepEqual(told, [["b", "hand 1", "it slipped"]]);
});

test("a recording that is chosen while there is no line is played when there is one", async () => {
  await mainWaits();
  socket.dispatchEvent(new Event("close"));
  beside.open("c.recording", "a.recording");
  await later(400);
  await opened();
  assert.deepEqual(wanted(), [{ do: "replay", name: "c.recording", speed: 1 }]);
});
