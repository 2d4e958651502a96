/** Playing a recording, or what a step of a tour does: which moment is shown when, how quickly, from where to where. */

/** @typedef {import("../shared/connection.js").Package} Package */
/** What is told of each part of a moment, of the moment that is shown then, and whether it plays. @typedef {{part: (part: Package, isShown: boolean) => void, shown: (at: number, header: Record<string, any>) => void, told: (isRunning: boolean) => void}} Shows */
/** @typedef {{now: () => number, picture: () => Promise<unknown>}} Clock */

/** Playing begins so long before the first act, s. */
const BEFORE_S = 0.5;

/** Parts of each moment: the last one is its frame. @param {Package[]} parts @returns {Package[][]} */
export function momentsOf(parts) {
  /** @type {Package[][]} */
  const moments = [[]];
  for (const part of parts) {
    moments.at(-1)?.push(part);
    if (part.header.kind === "frame") moments.push([]);
  }
  moments.pop();
  return moments;
}

/** The moment a little before something is done: an instrument, a cut, a patch or a stitch. @param {Package[][]} moments @param {number} framesPerSecond */
export function firstAct(moments, framesPerSecond) {
  const act = moments.findIndex((parts) => {
    const header = /** @type {Record<string, any>} */ (parts.at(-1)?.header ?? {});
    return header.cut_count > 0 || [header.instruments, header.patches, header.stitches].some((one) => one?.length > 0);
  });
  return act < 0 ? 0 : Math.max(0, act - Math.ceil(BEFORE_S * framesPerSecond));
}

export class Playing {
  /** What is played; null where nothing is. @type {object | null} */
  of = null;
  /** @type {Package[][]} */
  moments = [];
  at = -1;
  isRunning = false;
  speed = 1;
  #from = 0;
  #since = 0;
  #until = 0;
  #turn = 0;

  /** @param {number} framesPerSecond @param {Shows} shows @param {Clock} clock */
  constructor(framesPerSecond, shows, clock = { now: () => performance.now(), picture: () => new Promise(requestAnimationFrame) }) {
    this.framesPerSecond = framesPerSecond;
    this.shows = shows;
    this.clock = clock;
  }

  /** @param {object} of @param {Package[][]} moments */
  open(of, moments) {
    Object.assign(this, { of, moments, at: -1, isRunning: false });
    this.#until = moments.length - 1;
  }

  leave() {
    Object.assign(this, { of: null, moments: [], at: -1, isRunning: false });
  }

  /** Show a moment, and play on from there until another, or the end. @param {number} from @param {number} until */
  play(from, until = this.moments.length - 1) {
    this.#until = until;
    this.isRunning = true;
    this.#goOnFrom(from);
    this.show(from);
    void this.#run();
  }

  /** Show a moment, and stand there. @param {number} at */
  goTo(at) {
    if (this.of === null) return;
    this.isRunning = false;
    this.show(at);
    this.shows.told(false);
  }

  /** Stand, or play on; at the end from the start. */
  playOrPause() {
    if (this.of === null) return;
    if (!this.isRunning) {
      this.play(this.at >= this.moments.length - 1 ? 0 : this.at);
      return;
    }
    this.isRunning = false;
    this.shows.told(false);
  }

  /** @param {number} speed */
  setSpeed(speed) {
    this.speed = speed;
    if (this.isRunning) this.#goOnFrom(this.at);
  }

  /** @param {number} at */
  show(at) {
    // what a picture changes of the one before: those between are gone through, from the start where it lies behind
    if (at < this.at) this.at = -1;
    for (let n = this.at + 1; n <= at; n++) for (const part of this.moments[n]) this.shows.part(part, n === at);
    this.at = at;
    this.shows.shown(at, /** @type {Record<string, any>} */ (this.moments[at]?.at(-1)?.header ?? {}));
  }

  /** @param {number} at */
  #goOnFrom(at) {
    this.#from = at;
    this.#since = this.clock.now();
  }

  async #run() {
    const turn = ++this.#turn;
    this.shows.told(true);
    while (this.isRunning) {
      await this.clock.picture();
      // left, or begun anew, meanwhile
      if (!this.isRunning || this.#turn !== turn) return;
      const due = this.#from + Math.floor(((this.clock.now() - this.#since) / 1000) * this.framesPerSecond * this.speed);
      const at = Math.min(due, this.#until);
      if (at > this.at) this.show(at);
      if (at >= this.#until) this.isRunning = false;
    }
    this.shows.told(false);
  }
}
