/**
 * Mouse, touch, pen and keys on the picture: the tool in hand where it meets the heart, else turning, moving, zooming.
 *
 * The server says whether a tool has a use for a place. What the pointer does meanwhile waits, and of places that it went
 * through while an answer is under way the last one counts: no queue grows.
 */

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {(request: Record<string, unknown> & {do: string}) => Promise<Message>} Ask */

const ZOOM_PER_PIXEL = 0.0015;
/** A finger takes the tool when it stays so long alone, ms, or goes so far, pixels: a second one may be on its way. */
const ALONE_MS = 120;
const ALONE_PIXELS = 8;
/** Fingers that are nearer to each other roll nothing, pixels. */
const APART_LEAST = 30;
const KEY_TURN = 24;
const KEY_LEAD = 6;
const KEY_ZOOM = 1.15;

export class Pointer {
  /** @type {Map<number, {x: number, y: number}>} */
  #fingers = new Map();
  /** @type {"none" | "waiting" | "asking" | "tool" | "turn" | "move" | "pinch"} */
  #doing = "none";
  /** Ends the waiting of a finger that is alone so far. */
  #alone = 0;
  /** @type {{x: number, y: number}} */
  #last = { x: 0, y: 0 };
  /** Where the tool shall be led next. @type {{x: number, y: number} | null} */
  #next = null;
  #isAsking = false;
  #isReleased = false;
  /** Pressed again before the server was done with what was released: where, where to, and whether it is over. @type {{place: {x: number, y: number}, next: {x: number, y: number} | null, isReleased: boolean} | null} */
  #following = null;
  #hasPen = false;
  /** Place of the pointer that keys lead; null while they lead none. @type {{x: number, y: number} | null} */
  cursor = null;

  /**
   * @param {HTMLElement} surface
   * @param {Camera} camera
   * @param {{ask: Ask, answered: (answer: Message) => void, failed: (error: unknown) => void, changed: () => void,
   *   hasTool: () => boolean, isReady: () => boolean, cursorMoved: () => void, twoFingersMove?: boolean}} does
   */
  constructor(surface, camera, does) {
    this.surface = surface;
    this.camera = camera;
    this.does = does;
    surface.addEventListener("pointerdown", (event) => this.#down(event));
    surface.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of /** @type {const} */ (["pointerup", "pointercancel", "lostpointercapture"])) {
      surface.addEventListener(name, (event) => this.#up(event));
    }
    surface.addEventListener("contextmenu", (event) => event.preventDefault());
    surface.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    surface.addEventListener("blur", () => this.endKeys());
  }

  /** Whether a tool is in use. */
  get isUsed() {
    return this.#doing === "tool" || this.#doing === "asking" || this.cursor !== null;
  }

  /** Where the pointer is, for requests. */
  get look() {
    return this.camera.at(this.#last.x, this.#last.y);
  }

  /** The line is gone, or time went elsewhere: nothing is in use any more. */
  forget() {
    clearTimeout(this.#alone);
    this.#doing = "none";
    this.#next = null;
    this.#isReleased = false;
    this.#following = null;
    this.cursor = null;
    this.does.cursorMoved();
  }

  /** @param {MouseEvent} event */
  #place(event) {
    const box = this.surface.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  /** @param {PointerEvent} event */
  #down(event) {
    // the hand that holds a pen rests on the glass
    if (event.pointerType === "touch" && this.#hasPen) return;
    const place = this.#place(event);
    const isTouch = event.pointerType === "touch";
    // a hand that rests on the screen while an instrument is led does nothing
    if (isTouch && (this.#doing === "tool" || this.#doing === "asking")) return;
    this.endKeys();
    if (event.pointerType === "pen") this.#hasPen = true;
    if (!isTouch && (this.#doing === "pinch" || this.#doing === "waiting")) {
      // a pen goes before the hand that holds it
      this.#fingers.clear();
      this.forget();
    }
    this.surface.setPointerCapture(event.pointerId);
    this.#fingers.set(event.pointerId, place);
    if (isTouch && this.#fingers.size >= 2) {
      clearTimeout(this.#alone);
      this.#doing = "pinch";
      return;
    }
    const isFirst = event.button === 0;
    if (this.#isReleased && (this.#doing === "tool" || this.#doing === "asking") && isFirst && !event.shiftKey) {
      this.#following = { place, next: null, isReleased: false };
      return;
    }
    if (this.#doing !== "none") return;
    this.#last = place;
    if (event.button === 1 || (isFirst && event.shiftKey)) this.#doing = "move";
    else if (!isFirst || !this.does.hasTool() || !this.does.isReady()) this.#doing = "turn";
    else if (isTouch) {
      this.#doing = "waiting";
      this.#alone = Number(setTimeout(() => this.#begin(), ALONE_MS));
    } else void this.#press(place);
  }

  /** The finger stayed alone: it has the tool, where it came down. */
  #begin() {
    clearTimeout(this.#alone);
    if (this.#doing === "waiting") void this.#press(this.#last);
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const place = this.#place(event);
    if (!this.#fingers.has(event.pointerId)) {
      if (this.#doing === "none") this.#last = place;
      return;
    }
    if (this.#doing === "pinch") this.#pinch(event.pointerId, place);
    this.#fingers.set(event.pointerId, place);
    if (this.#following) {
      if (!this.#following.isReleased) this.#following.next = place;
      return;
    }
    if (this.#doing === "waiting" && Math.hypot(place.x - this.#last.x, place.y - this.#last.y) > ALONE_PIXELS) this.#begin();
    if (this.#doing === "turn") this.#turn(place);
    else if (this.#doing === "move") {
      this.camera.move(place.x - this.#last.x, place.y - this.#last.y);
      this.#last = place;
      this.does.changed();
    } else if (this.#doing === "tool" || this.#doing === "asking") this.#lead(place);
  }

  /** @param {PointerEvent} event */
  #up(event) {
    if (event.pointerType === "pen") this.#hasPen = false;
    if (!this.#fingers.delete(event.pointerId)) return;
    if (this.#following) {
      this.#following.isReleased = true;
      return;
    }
    if (this.#doing === "waiting") this.#begin();
    if (this.#doing === "tool" || this.#doing === "asking") this.#release();
    else if (this.#fingers.size === 0) this.#doing = "none";
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    event.preventDefault();
    if (this.isUsed) this.#deeper(event.deltaY < 0 ? 1 : -1);
    else {
      const pixels = event.deltaMode === 0 ? event.deltaY : 33 * event.deltaY;
      this.camera.zoom(Math.exp(-ZOOM_PER_PIXEL * pixels), this.#place(event));
      this.does.changed();
    }
  }

  /** @param {{x: number, y: number}} place */
  #turn(place) {
    this.camera.turn(place.x - this.#last.x, place.y - this.#last.y);
    this.#last = place;
    this.does.changed();
  }

  /** Two fingers turn, roll and zoom, or move and zoom where that is asked for; three move and zoom. @param {number} id @param {{x: number, y: number}} place */
  #pinch(id, place) {
    const others = [...this.#fingers].filter(([one]) => one !== id).map(([, one]) => one);
    const before = this.#fingers.get(id);
    if (others.length === 0 || before === undefined) return;
    const share = 1 / (others.length + 1);
    const [across, down] = [share * (place.x - before.x), share * (place.y - before.y)];
    const other = { x: others.reduce((sum, one) => sum + one.x, 0) / others.length, y: others.reduce((sum, one) => sum + one.y, 0) / others.length };
    const [apart, was] = [place, before].map((one) => Math.hypot(one.x - other.x, one.y - other.y));
    if (others.length > 1 || this.does.twoFingersMove) this.camera.move(across, down);
    else {
      this.camera.turn(across, down);
      const [now, then] = [place, before].map((one) => Math.atan2(one.y - other.y, one.x - other.x));
      if (apart > APART_LEAST && was > APART_LEAST) this.camera.roll(((now - then + 3 * Math.PI) % (2 * Math.PI)) - Math.PI);
    }
    if (apart > 1 && was > 1) this.camera.zoom(apart / was);
    this.does.changed();
  }

  /** @param {{x: number, y: number}} place */
  async #press(place) {
    this.#doing = "asking";
    this.#isReleased = false;
    this.#next = null;
    const answer = await this.#ask({ do: "press", pointer: this.camera.at(place.x, place.y) });
    if (/** @type {string} */ (this.#doing) !== "asking") return;
    if (answer?.used) {
      this.#doing = "tool";
      void this.#go();
      return;
    }
    // beside the heart: it turns
    this.#doing = this.#isReleased ? "none" : "turn";
    this.#isReleased = false;
    const next = this.#next;
    this.#next = null;
    // also by the way that the pointer went, or went and ended, while that was asked
    this.#last = place;
    if (next) this.#turn(next);
    this.#follow();
  }

  /** Do what was pressed meanwhile, once the server is done with what was before. */
  #follow() {
    const following = this.#following;
    if (following === null || this.#doing !== "none") return;
    this.#following = null;
    if (!this.does.hasTool() || !this.does.isReady()) return;
    this.#last = following.next ?? following.place;
    void this.#press(following.place);
    this.#next = following.next;
    this.#isReleased = following.isReleased;
  }

  /** @param {{x: number, y: number}} place */
  #lead(place) {
    this.#last = place;
    this.#next = place;
    void this.#go();
  }

  #release() {
    if (this.#doing !== "tool" && this.#doing !== "asking") return;
    this.#isReleased = true;
    void this.#go();
  }

  /** Ask for what is due, one thing after the other. */
  async #go() {
    if (this.#isAsking || this.#doing !== "tool") return;
    this.#isAsking = true;
    while (/** @type {string} */ (this.#doing) === "tool" && (this.#next || this.#isReleased)) {
      const place = this.#next ?? this.#last;
      const isEnd = this.#isReleased && this.#next === null;
      this.#next = null;
      if (isEnd) {
        this.#doing = "none";
        this.#isReleased = false;
      }
      await this.#ask({ do: isEnd ? "release" : "drag", pointer: this.camera.at(place.x, place.y) });
    }
    this.#isAsking = false;
    this.#follow();
  }

  /** @param {number} notches away from the eye */
  #deeper(notches) {
    void this.#ask({ do: "wheel", notches });
  }

  /** @param {Record<string, unknown> & {do: string}} request */
  async #ask(request) {
    try {
      const answer = await this.does.ask(request);
      this.does.answered(answer);
      return answer;
    } catch (error) {
      this.forget();
      this.does.failed(error);
      return null;
    }
  }

  /** Keys end what they lead. */
  endKeys() {
    if (this.cursor === null) return;
    this.cursor = null;
    this.does.cursorMoved();
    this.#release();
  }

  /**
   * A key on the picture: arrows turn, Enter uses the tool in the middle, arrows then lead it, and Enter ends.
   * @param {KeyboardEvent} event
   * @returns {boolean} whether it was of use
   */
  key(event) {
    const ways = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });
    const way = ways[event.key];
    if (way && this.cursor) {
      this.cursor = { x: this.cursor.x + KEY_LEAD * way[0], y: this.cursor.y + KEY_LEAD * way[1] };
      this.does.cursorMoved();
      this.#lead(this.cursor);
    } else if (way) {
      const [across, down] = [KEY_TURN * way[0], KEY_TURN * way[1]];
      if (event.shiftKey) this.camera.move(across, down);
      else this.camera.turn(across, down);
      this.does.changed();
    } else if (event.key === "Enter" && this.cursor) this.endKeys();
    else if (event.key === "Enter" && this.does.hasTool() && this.does.isReady() && this.#doing === "none") {
      this.cursor = { x: this.camera.width / 2, y: this.camera.height / 2 };
      this.#last = this.cursor;
      this.does.cursorMoved();
      void this.#press(this.cursor).then(() => {
        if (this.#doing === "turn") this.forget();
      });
    } else if (event.key === "+" || event.key === "=" || event.key === "-") {
      this.camera.zoom(event.key === "-" ? 1 / KEY_ZOOM : KEY_ZOOM);
      this.does.changed();
    } else if ((event.key === "PageUp" || event.key === "PageDown") && this.isUsed) this.#deeper(event.key === "PageUp" ? 1 : -1);
    else return false;
    return true;
  }
}
