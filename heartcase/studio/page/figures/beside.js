/** A second session on the case, in a pane of its own: a recording that is played beside another, seen from the same eye. */

import { Picture } from "../operating/picture.js";
import { arraysOf } from "../operating/messages.js";
import { Connection, Lost } from "../shared/connection.js";
import { saidOf } from "../shared/said.js";
import { figure, say } from "../shared/words.js";

/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {import("../shared/connection.js").Package} Package */
/** @typedef {{value: number, colour: string}} Painted */

/** So far, in simulated s, one may be ahead of the other before it waits. */
const AHEAD_S = 0.15;
/** Ends of one recording differ by rounding alone, s. */
const SAME_S = 1e-6;

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
/** What is written of a recording. @param {string} name */
const titleOf = (name) => name.replace(/\.recording$/, "");

export class Beside {
  /** @type {Picture | null} */
  picture = null;
  /** @type {Connection | null} */
  #connection = null;
  /** The frame that is shown. @type {Record<string, any> | null} */
  header = null;
  #name = "";
  #isReady = false;
  /** Whether the recording is still to be asked for. */
  #isDue = false;
  /** A session was opened that may be another than that of the frame which is shown. */
  #isDoubted = false;
  /** Which of both stands until the other has caught up. @type {"" | "main" | "beside"} */
  #waits = "";
  /** Both were told to stand: nobody waits, nobody goes on by itself. */
  #stands = false;
  /** How many times as quick as it was both are played. */
  speed = 1;

  /**
   * @param {Picture} main
   * @param {{askMain: (request: Record<string, unknown> & {do: string}) => void, painted: () => [readonly Painted[], Set<number>],
   *   mainHeader: () => Record<string, any> | null, shown: () => void,
   *   told: (said: import("../shared/connection.js").Problem) => void, failed: (error: unknown) => void}} does `shown` is told when time or mode here changed
   * @param {(canvas: HTMLCanvasElement) => Picture} makePicture
   */
  constructor(main, does, makePicture = (canvas) => new Picture(canvas)) {
    this.main = main;
    this.does = does;
    this.makePicture = makePicture;
    main.drawn.push(() => this.#follow());
    find("beside-close").addEventListener("click", () => this.close());
  }

  get isOpen() {
    return this.#connection !== null;
  }

  /** Play a recording here. @param {string} name @param {string} mainName what is played in the other pane */
  open(name, mainName) {
    this.#name = name;
    this.#waits = "";
    this.#stands = false;
    find("beside").hidden = false;
    find("theatre").dataset.beside = "true";
    find("main-title").textContent = titleOf(mainName);
    find("beside-title").textContent = titleOf(name);
    find("main-title").hidden = false;
    this.#isDue = true;
    if (this.#connection !== null) {
      this.#replay();
      return;
    }
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-hidden", "true");
    find("beside-scene").replaceChildren(canvas);
    this.picture = this.makePicture(canvas);
    const url = new URL(location.pathname.replace("/operate/", "/beside/"), location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    this.#connection = new Connection(url.href, (message) => this.#hear(message), (message) => this.#receive(message), this.does.failed);
    find("beside-time").textContent = say("operate_opening");
    this.#connection.state.listen((state) => {
      if (state !== "open") this.#isReady = false;
    });
    this.#connection.open();
  }

  close() {
    this.#connection?.end();
    this.#connection = null;
    this.#isReady = false;
    this.header = null;
    this.#isDoubted = false;
    this.#waits = "";
    this.does.shown();
    this.picture?.end();
    this.picture = null;
    find("beside-scene").replaceChildren();
    find("beside").hidden = true;
    find("main-title").hidden = true;
    delete find("theatre").dataset.beside;
  }

  /** What moves the time of the one moves that of the other. @param {Record<string, any> & {do: string}} request */
  pass(request) {
    const isOfTime = ["pause", "play", "back"].includes(request.do) || (request.do === "command" && request.command.kind === "go_to");
    if (!this.isOpen || !isOfTime) return;
    this.#waits = "";
    this.#stands = request.do !== "play";
    this.#ask(request);
  }

  /** Of both together: while one waits for the other, or has come to its end before it, they play. */
  get mode() {
    const main = this.does.mainHeader()?.mode ?? "";
    if (this.header === null || main !== "paused") return main;
    return this.#waits === "" ? this.header.mode : "playing";
  }

  /** What shall be asked where a user lets time stand or go on: of recordings that stand what is known ahead is kept. */
  pauseOrGoOn() {
    if (this.mode !== "paused") return { do: "pause", paused: true };
    const isKnownAhead = [this.header, this.does.mainHeader()].some((one) => one !== null && one.end_s > one.time_s);
    return this.isOpen && isKnownAhead ? { do: "play", speed: this.speed } : { do: "pause", paused: false };
  }

  /** One of the panes shows a moment: whoever is ahead while both play waits. */
  keepTogether() {
    const own = this.header;
    const main = this.does.mainHeader();
    if (own === null || main === null || !this.#isReady) return;
    const ahead = main.time_s - own.time_s;
    if (this.#waits === "main" && ahead <= 0) this.#go("main");
    else if (this.#waits === "beside" && ahead >= 0) this.#go("beside");
    else if (this.#waits === "" && !this.#stands && main.mode === "playing" && own.mode === "playing" && Math.abs(ahead) > AHEAD_S) {
      this.#waits = ahead > 0 ? "main" : "beside";
      this.#tell(this.#waits, { do: "pause", paused: true });
    }
    // who waits for one that has come to its end goes on
    const other = this.#waits === "main" ? own : this.#waits === "beside" ? main : null;
    if (other !== null && other.mode === "paused" && other.end_s <= other.time_s) this.#go(this.#waits);
  }

  repaint() {
    if (this.picture === null) return;
    this.picture.heart.paint(...this.does.painted());
    this.picture.redraw();
  }

  /** @param {"" | "main" | "beside"} which */
  #go(which) {
    this.#waits = "";
    this.#tell(which, { do: "play", speed: this.speed });
  }

  /** @param {"" | "main" | "beside"} which @param {Record<string, unknown> & {do: string}} request */
  #tell(which, request) {
    if (which === "main") this.does.askMain(request);
    else this.#ask(request);
  }

  /** @param {Record<string, unknown> & {do: string}} request @param {(answer: Message) => void} [done] */
  #ask(request, done) {
    if (!this.#isReady) return;
    this.#connection?.ask(request).then(done, (error) => {
      if (!(error instanceof Lost)) this.does.failed(error);
    });
  }

  /** Where there is no line it is due when there is one. */
  #replay() {
    const name = this.#name;
    this.#ask({ do: "replay", name, speed: this.speed }, ({ shown_s: seconds }) => {
      if (name === this.#name) this.#isDue = false;
      if (seconds !== undefined) this.does.told({ name: titleOf(name), place: "", message: say("recording_not_whole", { seconds: figure(seconds, 1) }) });
    });
  }

  /**
   * The first frame after a session was opened: another session than before knows another end, and plays no recording yet.
   * @param {Record<string, any>} header
   */
  #compare(header) {
    this.#isDoubted = false;
    if (this.header !== null && Math.abs(header.end_s - this.header.end_s) < SAME_S) return;
    this.#isDue = true;
    this.#waits = "";
    this.#replay();
  }

  /** @param {Message} message */
  #hear(message) {
    if (message.kind === "opened") {
      this.#isReady = true;
      const picture = /** @type {Picture} */ (this.picture);
      picture.heart.forgetNormalMap();
      picture.heart.paintStretch(message.stretch_colours);
      this.repaint();
      if (this.#isDue) this.#replay();
      else this.#isDoubted = true;
    } else if (message.kind === "message") {
      this.does.told({ .../** @type {any} */ (message), name: titleOf(this.#name) });
    } else if (message.kind === "failed") {
      find("beside-time").textContent = (message.problems ?? []).map(saidOf).join("; ");
    }
  }

  /** @param {Package} message */
  #receive(message) {
    const { picture } = this;
    const { header } = message;
    if (picture === null || header.kind === "coarse_topology") return;
    if (header.kind === "topology") {
      picture.heart.takeTopology(message);
      picture.redraw();
      return;
    }
    const arrays = arraysOf(message);
    if (header.kind === "normal_map") {
      picture.heart.takeNormalMap(arrays.png).then(() => picture.redraw(), this.does.failed);
      return;
    }
    const isNew = picture.heart.takeFrame(message, arrays);
    if (picture.tools.show(header, arrays) || isNew) picture.redraw();
    if (this.#isDoubted) this.#compare(header);
    this.header = header;
    this.keepTogether();
    this.does.shown();
    find("beside-time").textContent = say("operate_time_words", { time: figure(header.time_s, 2), end: figure(header.end_s, 2) });
    requestAnimationFrame(() => this.#connection?.tell({ do: "seen", frame: header.frame }));
  }

  /** Look from where the other pane looks from. */
  #follow() {
    const { picture, main } = this;
    if (picture === null) return;
    const { target, distance, size, right, up, towards } = main.camera;
    Object.assign(picture.camera, { target, distance, size, right, up, towards });
    picture.redraw();
  }
}
