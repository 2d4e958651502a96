/**
 * Strokes: sent at once while the server has nothing else to do, else gathered and sent once a frame, and never more
 * ahead of the server than it keeps up with. What they change comes back as labels; the page paints none by itself.
 */

import { Lost, Refused } from "../../shared/connection.js";
import { distance } from "../../shared/geometry.js";

/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {(request: Record<string, unknown> & {do: string}) => Promise<unknown>} Ask */

/** Messages of a stroke that may be under way at once: points wait here meanwhile, and go together. */
const AHEAD = 2;
/** Positions in one message. */
const MOST_POINTS = 500;
/** Positions nearer to the last one than this share of the radius add nothing. */
const APART = 0.1;

export class Brush {
  /** Positions that were not sent yet. @type {Vector[]} */
  #waiting = [];
  /** @type {Vector | null} */
  #last = null;
  /** Requests without an answer. */
  #sent = 0;
  #isDown = false;
  #isEnding = false;
  /** The server knows of the stroke. */
  #isBegun = false;
  #isFailed = false;
  #isAsked = false;
  /**
   * Strokes that were drawn while the one before was not answered yet: none is lost, and they are painted in their order.
   * @type {{request: Record<string, unknown> & {do: string}, points: Vector[], erases: boolean, isDown: boolean}[]}
   */
  #next = [];

  /**
   * @param {Studio} studio
   * @param {Ask} ask
   * @param {(problems: readonly import("../../shared/connection.js").Problem[]) => void} onRefused
   * @param {(callback: () => void) => void} [nextFrame]
   */
  constructor(studio, ask, onRefused, nextFrame = (callback) => requestAnimationFrame(callback)) {
    this.studio = studio;
    this.ask = ask;
    this.onRefused = onRefused;
    this.nextFrame = nextFrame;
  }

  get isDown() {
    return this.#isDown || this.#drawn !== null;
  }

  /** The stroke that is being drawn and waits for the one before. */
  get #drawn() {
    const last = this.#next.at(-1);
    return last?.isDown ? last : null;
  }

  /** Whether a stroke has still to be sent or answered: others wait for it. */
  get isBusy() {
    return this.#isDown || this.#isEnding || this.#next.length > 0;
  }

  /**
   * Begin a stroke.
   * @param {Vector} mm
   * @param {boolean} erases
   * @returns {boolean} whether it has begun; not without a connection, or a structure to paint.
   */
  begin(mm, erases) {
    const { studio } = this;
    const label = studio.pickedLabel;
    if (this.isDown || !studio.ready.value || (!erases && label === null)) return false;
    const request = {
      do: "paint",
      ...(erases ? { erase: true } : { label: label?.name }),
      radius_mm: studio.radiusMm.value,
      points_mm: [rounded(mm)],
    };
    this.#last = mm;
    this.#next.push({ request, points: [mm], erases, isDown: true });
    studio.stroke.value = { points: [mm], erases };
    if (!this.#isEnding) this.#startNext();
    return true;
  }

  /** The stroke that waited longest is painted. */
  #startNext() {
    const next = this.#next.shift();
    if (next === undefined) return;
    this.#isDown = next.isDown;
    this.#isEnding = !next.isDown;
    this.#isBegun = this.#isFailed = false;
    this.#waiting = next.points.slice(1);
    this.studio.stroke.value = { points: next.points, erases: next.erases };
    this.#send(next.request);
  }

  /** The pointer went on. @param {readonly Vector[]} positions */
  extend(positions) {
    const waits = this.#drawn;
    if (waits === null && (!this.#isDown || this.#isFailed)) return;
    const { studio } = this;
    const fresh = [];
    for (const mm of positions) {
      if (this.#last && distance(mm, this.#last) < APART * studio.radiusMm.value) continue;
      this.#last = mm;
      fresh.push(mm);
    }
    if (fresh.length === 0) return;
    (waits?.points ?? this.#waiting).push(...fresh);
    const stroke = studio.stroke.value;
    if (stroke) studio.stroke.value = { ...stroke, points: [...stroke.points, ...fresh] };
    if (waits !== null || this.#isAsked) return;
    if (this.#sent === 0) {
      this.#flush();
      return;
    }
    this.#isAsked = true;
    this.nextFrame(() => {
      this.#isAsked = false;
      this.#flush();
    });
  }

  /** The pointer was lifted. */
  end() {
    const waits = this.#drawn;
    if (waits !== null) {
      waits.isDown = false;
      return;
    }
    if (!this.#isDown) return;
    this.#isDown = false;
    this.#isEnding = true;
    this.#flush();
  }

  /** The connection was lost: the stroke is let go, and those that waited for it. */
  drop() {
    this.#next = [];
    this.#isDown = this.#isEnding = this.#isBegun = false;
    this.#waiting = [];
    this.#sent = 0;
    this.studio.stroke.value = null;
  }

  #flush() {
    while (!this.#isFailed && this.#waiting.length > 0 && this.#sent < AHEAD) {
      this.#send({ do: "extend", points_mm: this.#waiting.splice(0, MOST_POINTS).map(rounded) });
    }
    if (!this.#isEnding || this.#sent > 0) return;
    if (this.#isBegun) this.ask({ do: "end" }).catch((error) => this.#fail(error));
    this.#isEnding = false;
    this.studio.stroke.value = null;
    this.#startNext();
  }

  /** @param {Record<string, unknown> & {do: string}} request */
  #send(request) {
    this.#sent += 1;
    this.ask(request)
      .then(() => (this.#isBegun = true))
      .catch((error) => this.#fail(error))
      .finally(() => {
        this.#sent = Math.max(this.#sent - 1, 0);
        this.#flush();
      });
  }

  /** @param {unknown} error */
  #fail(error) {
    // What was sent before the first refusal came is refused too, and says no more.
    if (this.#isFailed && error instanceof Refused) return;
    this.#isFailed = true;
    this.#waiting = [];
    if (error instanceof Lost) return;
    this.studio.stroke.value = null;
    if (!(error instanceof Refused)) throw error;
    this.onRefused(error.problems);
  }
}

/** A thousandth of a mm is enough. @param {Vector} mm */
function rounded(mm) {
  return mm.map((value) => Math.round(value * 1000) / 1000);
}
