/** Hands of the page itself: what a pointer does to a heart that steps in the browser. They answer as a server would. */

import { add, dot } from "../operating/camera.js";

/** @typedef {import("../operating/camera.js").Vector} Vector */
/** @typedef {import("../operating/camera.js").Look} Look */
/** @typedef {import("../webgpu/engine.js").SpringEngine} SpringEngine */
/** @typedef {import("../webgpu/lattice.js").Lattice} Lattice */
/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {{origin_mm: Vector, direction: number[][], cell_mm: number}} Place */
/** @typedef {{name: string, kind: string, center_mm: Vector, force_n: Vector, axes_mm: number[][] | null}} Shown */

export const SIZES_MM = { g: 6, p: 5 };
const NOTCH_MM = 1;
const SIZE_STEP = 1.15;
/** Way in a step above which a hand follows the pointer more slowly [cells]. */
const QUICKEST = 0.02;

/** Millimetres to cells and back. */
export class Frame {
  /** @param {Place} place */
  constructor(place) {
    this.place = place;
  }

  /** @param {Vector} mm @returns {Vector} */
  toCells(mm) {
    const { origin_mm: origin, direction, cell_mm: cell } = this.place;
    const from = add(mm, origin, -1);
    return /** @type {Vector} */ ([0, 1, 2].map((axis) => dot(from, /** @type {Vector} */ (direction.map((row) => row[axis]))) / cell + 0.5));
  }

  /** @param {readonly number[]} vector [cells] @returns {Vector} */
  turned(vector) {
    const { direction, cell_mm: cell } = this.place;
    return /** @type {Vector} */ (direction.map((row) => cell * (row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])));
  }
}

export class LocalHands {
  tool = "";
  sizes = { ...SIZES_MM };
  /** Where what is in use is, and where it shall be, LPS mm. @type {{kind: "grab" | "probe", at: Vector, goal: Vector} | null} */
  #held = null;
  /** Where the drag began. @type {{look: Look, goal: Vector} | null} */
  #began = null;

  /**
   * @param {SpringEngine} engine
   * @param {Frame} frame
   * @param {(look: Look) => Vector | null} pick
   * @param {() => Float32Array} displacement of all nodes as they are shown [cells], four numbers each
   */
  constructor(engine, frame, pick, displacement) {
    this.engine = engine;
    this.frame = frame;
    this.pick = pick;
    this.displacement = displacement;
  }

  get isUsed() {
    return this.#held !== null;
  }

  /** @param {Record<string, any> & {do: string}} request @returns {Promise<Message>} */
  async ask(request) {
    let used = true;
    if (request.do === "press") used = this.#press(request.pointer);
    else if (request.do === "drag") this.#drag(request.pointer);
    else if (request.do === "release") this.letGo();
    else if (request.do === "wheel" && this.#held && this.#began) {
      const away = /** @type {Vector} */ (this.#began.look.axes[2].map((part) => -NOTCH_MM * request.notches * part));
      this.#began.goal = add(this.#began.goal, away);
      this.#held.goal = add(this.#held.goal, away);
    } else used = false;
    return { kind: "done", used, tool: this.tool, size: null, line_mm: [] };
  }

  /** @param {number} steps */
  resize(steps) {
    if (this.tool === "g" || this.tool === "p") {
      this.sizes[this.tool] = Math.min(Math.max(this.sizes[this.tool] * SIZE_STEP ** steps, 1), 30);
    }
  }

  letGo() {
    if (this.#held?.kind === "grab") this.engine.release("hand");
    else if (this.#held) this.engine.bring(null);
    this.#held = this.#began = null;
  }

  /** @param {Look} look */
  #press(look) {
    const hit = this.pick(look);
    if (hit === null || (this.tool !== "g" && this.tool !== "p")) return false;
    const cell = this.frame.place.cell_mm;
    const size = this.sizes[this.tool];
    if (this.tool === "g") {
      const nodes = this.engine.lattice.inReach(this.displacement(), this.frame.toCells(hit), size / cell);
      if (nodes.length === 0) return false;
      this.engine.hold("hand", nodes);
      this.#held = { kind: "grab", at: hit, goal: hit };
    } else {
      // it touches what is pointed at, from the side of the eye
      const centre = add(hit, look.direction, -size);
      this.engine.bring({ centre: this.frame.toCells(centre), radius: size / cell });
      this.#held = { kind: "probe", at: centre, goal: centre };
    }
    this.#began = { look: { ...look, start_mm: hit }, goal: this.#held.goal };
    return true;
  }

  /** @param {Look} look */
  #drag(look) {
    if (this.#held === null || this.#began === null) return;
    // in the plane through where it began that faces the eye
    const towards = look.axes[2];
    const depth = dot(add(this.#began.look.start_mm, look.start_mm, -1), towards) / dot(look.direction, towards);
    const place = add(look.start_mm, look.direction, depth);
    this.#held.goal = add(this.#began.goal, add(place, this.#began.look.start_mm, -1));
  }

  /** Lead what is held on its way, over the next steps. @param {number} steps */
  lead(steps) {
    const held = this.#held;
    if (held === null) return;
    const cell = this.frame.place.cell_mm;
    const way = add(held.goal, held.at, -1);
    const most = QUICKEST * steps * cell;
    const size = Math.hypot(...way);
    const at = size > most ? add(held.at, way, most / size) : held.goal;
    const cells = /** @type {Vector} */ ([0, 1, 2].map((axis) => this.frame.toCells(at)[axis] - this.frame.toCells(held.at)[axis]));
    if (held.kind === "grab") this.engine.lead("hand", cells, steps);
    else this.engine.moveProbe(this.frame.toCells(at));
    held.at = at;
  }

  /** What is to be seen of what is held. @returns {Shown[]} */
  shown() {
    const held = this.#held;
    if (held === null) return [];
    if (held.kind === "probe") {
      const size = this.sizes.p;
      return [{ name: "probe", kind: "probe", center_mm: held.at, force_n: [0, 0, 0], axes_mm: [[size, 0, 0], [0, size, 0], [0, 0, size], [0, 0, 0]] }];
    }
    const force = this.engine.lattice.forceOn(this.displacement(), this.engine.heldBy("hand"));
    const newtons = this.engine.lattice.arrays.facts.forceN;
    const inMm = this.frame.turned(force);
    const scale = newtons / this.frame.place.cell_mm;
    return [{ name: "hand", kind: "grab", center_mm: held.at, force_n: /** @type {Vector} */ (inMm.map((part) => scale * part)), axes_mm: null }];
  }
}
