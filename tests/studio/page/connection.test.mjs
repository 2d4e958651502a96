// The line to the server: a server that is silent.

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
  }
  send() {}
  close() {}
};
const { Connection } = await import("../../../heartcase/studio/page/shared/connection.js");

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
  connection.leave();
  assert.equal(connection.state.value, "ended");
});
