// The line to the server: a server that is silent, and a page that has ended.

import assert from "node:assert/strict";
import { test } from "node:test";

/** @type {any} */
let socket;
globalThis.WebSocket = class extends EventTarget {
  static OPEN = 1;
  readyState = 1;
  constructor() {
    super();
    socket = this;
    count += 1;
  }
  send() {}
  close() {
    this.readyState = 2;
  }
};
/** Lines that were begun so far. */
let count = 0;
const { Connection, Lost } = await import("../../../heartcase/studio/page/shared/connection.js");

test("a server is silent after two seconds without a word, and answers with the next", () => {
  /** @type {string[]} */
  const states = [];
  const connection = new Connection("ws://x", () => {}, () => {}, assert.fail);
  connection.state.listen((state) => states.push(state));
  connection.open();
  connection.look(performance.now());
  assert.deepEqual(states, []);
  socket.dispatchEvent(new Event("open"));
  const start = performance.now();
  for (let ms = 0; ms <= 1900; ms += 500) connection.look(start + ms);
  assert.deepEqual(states, ["open"]);
  connection.look(start + 2100);
  assert.deepEqual(states, ["open", "silent"]);
  connection.look(start + 2600);
  socket.dispatchEvent(new MessageEvent("message", { data: '{"kind": "alive"}' }));
  assert.deepEqual(states, ["open", "silent", "open"]);
  socket.dispatchEvent(new Event("close"));
  connection.look(start + 9000);
  assert.deepEqual(states.slice(3), ["lost"]);
  connection.end();
});

test("a page that slept waits for what came meanwhile", () => {
  const connection = new Connection("ws://x", () => {}, () => {}, assert.fail);
  connection.open();
  socket.dispatchEvent(new Event("open"));
  const start = performance.now();
  connection.look(start);
  connection.look(start + 60_000);
  assert.equal(connection.state.value, "open");
  for (const ms of [500, 1000, 1500, 2000]) connection.look(start + 60_000 + ms);
  assert.equal(connection.state.value, "open");
  connection.look(start + 62_500);
  assert.equal(connection.state.value, "silent");
  connection.end();
});

test("a page that has ended leaves the server, hears nothing more and tries no more", async () => {
  /** @type {any[]} */
  const heard = [];
  const connection = new Connection("ws://x", (message) => {
    heard.push(message.kind);
    if (message.kind === "failed") connection.end();
  }, () => {}, assert.fail);
  const says = (/** @type {object} */ message) => socket.dispatchEvent(new MessageEvent("message", { data: JSON.stringify(message) }));
  connection.open();
  socket.dispatchEvent(new Event("open"));
  const asked = connection.ask({ do: "lock" });
  assert.equal(connection.changing.value, 1);
  for (const kind of ["failed", "progress", "opened"]) says({ kind });
  says({ kind: "refused", id: 1, problems: [] });
  // not refused: why it ended is said already
  await assert.rejects(asked, Lost);
  assert.deepEqual(heard, ["failed"]);
  assert.equal(connection.changing.value, 0);
  assert.equal(socket.readyState, 2);
  await assert.rejects(connection.ask({ do: "lock" }), Lost);
  const begun = count;
  socket.dispatchEvent(new Event("close"));
  await new Promise((done) => setTimeout(done, 400));
  assert.equal(count, begun);
  assert.equal(connection.state.value, "ended");
});

test("a page that ends while there is no line, or before there is one, stays ended", async () => {
  const connection = new Connection("ws://x", () => {}, () => {}, assert.fail);
  connection.open();
  socket.dispatchEvent(new Event("close"));
  assert.equal(connection.state.value, "lost");
  connection.end();
  const begun = count;
  await new Promise((done) => setTimeout(done, 400));
  assert.equal(count, begun);
  const early = new Connection("ws://x", () => {}, () => {}, assert.fail);
  early.open();
  early.end();
  socket.dispatchEvent(new Event("open"));
  assert.deepEqual([connection.state.value, early.state.value], ["ended", "ended"]);
});
