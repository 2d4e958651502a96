/**
 * Labels that come bit by bit: the server knows which planes are shown and sends these first; the rest is asked for, one
 * piece after the other. A slice that is scrolled to is drawn when its labels are those of the last stroke.
 */

/** @typedef {import("./views.js").Views} Views */
/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {(request: Record<string, unknown> & {do: string}) => Promise<any>} Ask */

/** Pieces of the rest are asked for when no labels changed for so long: a stroke under way goes first [ms]. */
const PAUSE_MS = 120;
/** After what goes first is looked again whether it is done, so often [ms]. */
const AGAIN_MS = 10;

export class Seen {
  /** What the server was told last. */
  #told = "";
  #isAsked = false;
  #isLooking = false;
  #hasRest = false;
  #isFetching = false;
  #changedAt = -Infinity;
  /** Whether something goes before the rest. @type {() => boolean} */
  yields = () => false;

  /**
   * @param {Views} views
   * @param {Studio} studio
   * @param {Ask} ask
   * @param {(error: unknown) => void} onFault
   * @param {(callback: () => void) => void} [nextFrame]
   */
  constructor(views, studio, ask, onFault, nextFrame = (callback) => requestAnimationFrame(callback)) {
    this.views = views;
    this.studio = studio;
    this.ask = ask;
    this.onFault = onFault;
    this.nextFrame = nextFrame;
    for (const signal of [studio.crosshair, studio.planes, studio.ready]) {
      /** @type {import("../../shared/signal.js").Signal<any>} */ (signal).listen(() => this.#look());
    }
    studio.ready.listen((ready) => {
      if (!ready) this.#told = "";
    });
  }

  /** Whether labels off the planes may still come. */
  get hasRest() {
    return this.#hasRest;
  }

  /** The server said so. @param {boolean} hasRest @param {boolean} [isChange] whether labels may have changed just now */
  tell(hasRest, isChange = false) {
    this.#hasRest = hasRest;
    if (isChange) this.#changedAt = performance.now();
    if (hasRest) this.#fetch();
  }

  /** What is shown, as the server wants it. */
  get #planes() {
    const point_mm = this.studio.crosshair.value;
    return this.views.all.map(({ camera }) => ({ point_mm, normal: camera.frame.normal }));
  }

  #look() {
    if (!this.studio.ready.value) return;
    // what is drawn from here on would be of before
    if (this.#hasRest && JSON.stringify(this.#planes) !== this.#told) this.views.waits = true;
    if (this.#isAsked) return;
    this.#isAsked = true;
    this.nextFrame(() => {
      this.#isAsked = false;
      void this.#tellPlanes();
    });
  }

  async #tellPlanes() {
    if (this.#isLooking) return;
    this.#isLooking = true;
    try {
      while (this.studio.ready.value) {
        const planes = this.#planes;
        const text = JSON.stringify(planes);
        if (text === this.#told) break;
        await this.ask({ do: "look", planes });
        this.#told = text;
      }
    } catch (error) {
      this.onFault(error);
    } finally {
      this.#isLooking = false;
      this.views.waits = false;
    }
  }

  #fetch() {
    if (this.#isFetching) return;
    this.#isFetching = true;
    const take = () => setTimeout(() => void this.#take(), 0);
    // pictures first; most pieces of labels that spread change none
    if (this.studio.spreads.value) take();
    else this.nextFrame(take);
  }

  async #take() {
    const wait = Math.max(this.#changedAt + PAUSE_MS - performance.now(), this.yields() ? AGAIN_MS : 0);
    if (wait > 0) {
      setTimeout(() => void this.#take(), wait);
      return;
    }
    try {
      const { rest } = await this.ask({ do: "rest" });
      this.#isFetching = false;
      this.tell(rest === true);
    } catch (error) {
      this.#isFetching = false;
      this.onFault(error);
    }
  }
}
