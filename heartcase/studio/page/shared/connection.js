/**
 * The line to the server: requests with their answers, messages in the order in which they were sent, and a line that
 * comes back by itself when it was lost.
 */

import { Signal } from "./signal.js";

/** @typedef {"connecting" | "open" | "silent" | "lost" | "stranger" | "ended"} State */
/** `name` is one that a user gave: it stands before the place, as it is. @typedef {{name?: string, place: string, message: string, code?: string, values?: Record<string, string>}} Problem */
/** @typedef {Record<string, any> & {kind: string}} Message */
/** @typedef {{header: Message, bytes: Uint8Array<ArrayBuffer>}} Package */

const FIRST_WAIT_MS = 300;
const LONGEST_WAIT_MS = 8000;
/** A server that is watched is silent where nothing came for so long; it gives a sign of life twice a second. */
const SILENT_MS = 2000;
const LOOK_MS = 500;
/** Requests that change nothing. */
const ASKING = new Set(["suggest", "propose", "find_ends", "planes", "preview", "picture", "confirm", "look", "rest"]);

/** The server did not carry a request out, and says why. */
export class Refused extends Error {
  /** @param {Problem[]} problems */
  constructor(problems) {
    super("refused");
    this.problems = problems;
  }
}

/** The line broke before an answer came. */
export class Lost extends Error {}

/**
 * Take a binary message apart.
 * @param {ArrayBuffer} data
 * @returns {Promise<Package>}
 */
export async function unpack(data) {
  if (data.byteLength < 4) throw new Error("a binary message is too short");
  const headerLength = new DataView(data).getUint32(0, true);
  if (4 + headerLength > data.byteLength) throw new Error("a binary message is shorter than its header");
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, headerLength)));
  const payload = new Uint8Array(data, 4 + headerLength);
  if (header.encoding === "raw") return { header, bytes: payload };
  if (header.encoding === "runs") return { header, bytes: fromRuns(payload) };
  if (header.encoding !== "deflate") throw new Error("a binary message has an unknown encoding");
  const stream = new Blob([payload]).stream().pipeThrough(new DecompressionStream("deflate"));
  return { header, bytes: new Uint8Array(await new Response(stream).arrayBuffer()) };
}

/**
 * Voxels from runs: where each ends (uint32, little-endian), then the value of each.
 * @param {Uint8Array<ArrayBuffer>} payload
 */
export function fromRuns(payload) {
  const count = payload.length / 5;
  if (!Number.isInteger(count)) throw new Error("runs are cut off");
  const ends = new DataView(payload.buffer, payload.byteOffset, 4 * count);
  const bytes = new Uint8Array(count > 0 ? ends.getUint32(4 * (count - 1), true) : 0);
  let at = 0;
  for (let n = 0; n < count; n++) {
    const end = ends.getUint32(4 * n, true);
    const value = payload[4 * count + n];
    // most runs are short, and filling them one by one is quicker
    if (end - at < 24) while (at < end) bytes[at++] = value;
    else bytes.fill(value, at, end);
    at = end;
  }
  return bytes;
}

/**
 * How long to wait before the next try.
 * @param {number} tries that failed so far
 */
export function waitMs(tries) {
  return Math.min(FIRST_WAIT_MS * 2 ** tries, LONGEST_WAIT_MS);
}

export class Connection {
  /** A stranger is who the server no longer knows: it was started anew, with another key. Silent is a server that does not answer. @type {Signal<State>} */
  state = new Signal(/** @type {State} */ ("connecting"));
  /** How long a server that is watched may say nothing before it is silent, ms. */
  silentMs = SILENT_MS;
  /** Requests that change the recipe and have no answer yet. @type {Signal<number>} */
  changing = new Signal(0);
  /** @type {WebSocket | null} */
  #socket = null;
  #nextId = 1;
  #tries = 0;
  #heardMs = 0;
  #lookedMs = -Infinity;
  /** @type {ReturnType<typeof setInterval> | undefined} */
  #watch;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #retry;
  /** @type {Promise<void>} */
  #queue = Promise.resolve();
  /** @type {Map<number, {changes: boolean, resolve: (answer: Message) => void, reject: (error: Error) => void}>} */
  #requests = new Map();

  /**
   * @param {string} url
   * @param {(message: Message) => void} onMessage
   * @param {(message: Package) => void} onPackage
   * @param {(error: unknown) => void} onFault
   */
  constructor(url, onMessage, onPackage, onFault) {
    this.url = url;
    this.onMessage = onMessage;
    this.onPackage = onPackage;
    this.onFault = onFault;
  }

  open() {
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    /** Each socket has a queue of its own: what an old one sent late is not applied. */
    this.#queue = Promise.resolve();
    socket.addEventListener("open", () => {
      if (socket !== this.#socket) return;
      this.#tries = 0;
      this.#heardMs = performance.now();
      this.state.value = "open";
    });
    socket.addEventListener("message", (event) => {
      if (socket === this.#socket) this.#hears();
      const unpacked = typeof event.data === "string" ? null : unpack(event.data);
      // its fault is told when its turn comes
      unpacked?.catch(() => undefined);
      this.#queue = this.#queue.then(() => this.#take(socket, event.data, unpacked)).catch(this.onFault);
    });
    socket.addEventListener("close", () => this.#closed(socket));
  }

  /** Tell from now on where the server is silent: one that is opening something may be so for long. */
  watch() {
    this.#watch ??= setInterval(() => this.look(performance.now()), LOOK_MS);
  }

  /** Look whether the server is silent. @param {number} now ms */
  look(now) {
    // a page that slept, or was busy, has what came meanwhile still to take
    if (now - this.#lookedMs > 3 * LOOK_MS) this.#heardMs = Math.max(this.#heardMs, now);
    this.#lookedMs = now;
    if (this.state.value === "open" && now - this.#heardMs > this.silentMs) this.state.value = "silent";
  }

  #hears() {
    this.#heardMs = performance.now();
    if (this.state.value === "silent") this.state.value = "open";
  }

  /** Nothing more is wanted of the server, or it said that it cannot go on: it is left, and what it still sends is not taken. */
  end() {
    clearInterval(this.#watch);
    clearTimeout(this.#retry);
    this.state.value = "ended";
    this.#socket?.close();
    this.#detach();
  }

  /** There is no line any more, and no answer to what was asked. */
  #detach() {
    this.#socket = null;
    for (const { reject } of this.#requests.values()) reject(new Lost());
    this.#requests.clear();
    this.#count();
  }

  /**
   * Ask the server to do something.
   * @param {Record<string, unknown> & {do: string}} request
   * @returns {Promise<Message>} its answer; rejected with `Refused` or `Lost`.
   */
  ask(request) {
    const socket = this.#socket;
    if (socket === null || socket.readyState !== WebSocket.OPEN) return Promise.reject(new Lost());
    const id = this.#nextId++;
    return new Promise((resolve, reject) => {
      this.#requests.set(id, { changes: !ASKING.has(request.do), resolve, reject });
      this.#count();
      socket.send(JSON.stringify({ id, ...request }));
    });
  }

  /**
   * Tell the server something that has no answer. Where there is no line it is left out.
   * @param {Record<string, unknown> & {do: string}} request
   */
  tell(request) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(request));
  }

  #count() {
    this.changing.value = [...this.#requests.values()].filter(({ changes }) => changes).length;
  }

  /**
   * @param {WebSocket} socket
   * @param {string | ArrayBuffer} data
   * @param {Promise<Package> | null} unpacked
   */
  async #take(socket, data, unpacked) {
    const message = unpacked ? await unpacked : JSON.parse(/** @type {string} */ (data));
    if (socket !== this.#socket) return;
    if (unpacked) {
      this.onPackage(message);
      return;
    }
    this.onMessage(message);
    const request = this.#requests.get(message.id);
    if (request === undefined) return;
    this.#requests.delete(message.id);
    this.#count();
    if (message.kind === "refused") request.reject(new Refused(message.problems ?? []));
    else request.resolve(message);
  }

  /** @param {WebSocket} socket */
  #closed(socket) {
    if (socket !== this.#socket) return;
    this.#detach();
    if (this.state.value !== "stranger") this.state.value = "lost";
    if (this.#tries > 0) this.#askWhetherKnown();
    // A stranger goes on trying too: another tab may be given the key.
    this.#retry = setTimeout(() => this.open(), waitMs(this.#tries++));
  }

  /** A socket does not say why it was refused; the page itself does. */
  async #askWhetherKnown() {
    try {
      const { status } = await fetch("/", { method: "HEAD", cache: "no-store" });
      if (status === 403 && this.state.value === "lost") this.state.value = "stranger";
    } catch {
      // There is no server.
    }
  }
}
