/**
 * How coarsely is drawn while something moves: as finely as this machine draws quickly enough. What stands still is drawn as
 * finely as there is. Pictures are timed; where none was yet, a machine without a graphics card counts as slow.
 */

/** Level of detail of the surface, and part of the picture's width. @typedef {{level: number, part: number}} Step */

/** A picture in motion should take no longer than this: 30 a second, with time left for what else the page does [ms]. */
const LONGEST_MS = 22;
/** Pictures that take no longer than this could be finer [ms]. */
const SHORT_MS = 5;
/** So many pictures, and the median of their times, decide. */
const LOOKED_AT = 5;
/** Where a machine without a graphics card begins. */
const SLOW_STEP = 2;
/** Nothing moves any more when nothing did for so long [ms]. */
const REST_MS = 300;
/** A level that is not there after so long does not come [ms]. */
const PATIENCE_MS = 5000;
/** From finest to coarsest. @type {readonly Step[]} */
const STEPS = [
  { level: 0, part: 1 }, { level: 1, part: 1 }, { level: 1, part: 0.7 }, { level: 2, part: 0.7 }, { level: 2, part: 0.5 },
];

export class Detail {
  /** Called once when a coarser level is wanted for the first time. @type {() => void} */
  wanted = () => {};
  #step = 0;
  #movedAt = -Infinity;
  #askedAt = -Infinity;
  /** @type {ReturnType<typeof setTimeout> | null} */
  #resting = null;
  /** @type {number[]} */
  #times = [];

  /** @param {() => void} redraw @param {boolean} isSlow whether there is no graphics card */
  constructor(redraw, isSlow) {
    this.redraw = redraw;
    this.#step = isSlow ? SLOW_STEP : 0;
  }

  get isMoving() {
    return performance.now() - this.#movedAt < REST_MS;
  }

  /** How to draw now, where that level is there. */
  get step() {
    return STEPS[this.isMoving ? this.#step : 0];
  }

  /** The heart or the eye has moved. */
  moved() {
    this.#movedAt = performance.now();
    if (this.#step === 0 || this.#resting !== null) return;
    const rest = () => {
      const left = this.#movedAt + REST_MS - performance.now();
      if (left > 0) {
        this.#resting = setTimeout(rest, left + 1);
        return;
      }
      this.#resting = null;
      this.redraw();
    };
    this.#resting = setTimeout(rest, REST_MS + 1);
  }

  /** A picture in motion is done. @param {number} ms time from its beginning @param {number} level that it showed */
  drew(ms, level) {
    // a level that was asked for may not be there yet
    if (level !== STEPS[this.#step].level && performance.now() - this.#askedAt < PATIENCE_MS) return;
    this.#times.push(ms);
    if (this.#times.length < LOOKED_AT) return;
    const median = this.#times.sort((a, b) => a - b)[LOOKED_AT >> 1];
    this.#times = [];
    if (median > LONGEST_MS) {
      this.#step = Math.min(this.#step + 1, STEPS.length - 1);
      if (this.#askedAt === -Infinity) this.#ask();
    } else if (median < SHORT_MS) this.#step = Math.max(this.#step - 1, 0);
  }

  /** Begin with a server that knows nothing of this page. */
  begin() {
    if (this.#step > 0 || this.#askedAt > -Infinity) this.#ask();
  }

  #ask() {
    this.#askedAt = performance.now();
    this.wanted();
  }
}
