/** Steps a case's lattice on the browser's own graphics card (WebGPU): what a page without a server pulls and probes. */

import { CODE, GROUP, SETTING_COUNT } from "./kernels.js";
import { DIRECTIONS } from "./lattice.js";

/** @typedef {import("./lattice.js").Lattice} Lattice */
/** @typedef {readonly [number, number, number]} Vector */

/** Uniform buffers that are told apart by an offset lie this far from each other at least. */
const SLOT_BYTES = 256;
/** Steps that one row of commands holds at most: more would make the page wait for the card. */
const ROW_MAX = 128;
/** Most that a node moves along an axis in one step [cells]. */
const WAY_LIMIT = 0.5;

/** The case cannot be stepped here; `reason` says why. */
export class NoWebGpu extends Error {
  /** @param {"missing" | "too large" | "refused"} reason @param {string} message */
  constructor(reason, message) {
    super(message);
    this.reason = reason;
  }
}

export class SpringEngine {
  /** Nodes that hands hold. @type {Map<string, {nodes: number[], velocity: Vector}>} */
  #hands = new Map();
  /** @type {{centre: Vector, radius: number} | null} */
  #probe = null;
  /** @type {Vector} */
  #probeGoal = [0, 0, 0];

  /**
   * @param {Lattice} lattice
   * @param {GPUDevice} device
   */
  constructor(lattice, device) {
    this.lattice = lattice;
    this.device = device;
    const { facts } = lattice.arrays;
    /** Time step [units of time]. */
    this.step = facts.stepS / facts.timeS;
    const half = (facts.dampingPerS * facts.stepS) / 2;
    this.keep = (1 - half) / (1 + half);
    this.kick = this.step / (1 + half);
    const { STORAGE, COPY_DST, COPY_SRC, UNIFORM, MAP_READ } = GPUBufferUsage;
    /** @param {number} size @param {number} usage */
    const make = (size, usage) => device.createBuffer({ size: Math.max(size, 16), usage });
    /** @param {Float32Array<ArrayBuffer> | Uint32Array<ArrayBuffer>} data */
    const filled = (data) => {
      const buffer = make(data.byteLength, STORAGE | COPY_DST);
      device.queue.writeBuffer(buffer, 0, data);
      return buffer;
    };
    const count = lattice.nodeCount;
    this.displacement = make(16 * count, STORAGE | COPY_DST | COPY_SRC);
    this.velocity = make(16 * count, STORAGE | COPY_DST | COPY_SRC);
    this.settings = make(ROW_MAX * SLOT_BYTES, UNIFORM | COPY_DST);
    this.led = make(32 * count, STORAGE | COPY_DST);
    this.mapped = make(16 * count, COPY_DST | MAP_READ);
    const visibility = GPUShaderStage.COMPUTE;
    /** @type {GPUBufferBindingType[]} */
    const kinds = ["uniform", "storage", "storage", "storage", "read-only-storage", "read-only-storage", "read-only-storage", "storage", "read-only-storage"];
    const layout = device.createBindGroupLayout({
      entries: kinds.map((type, binding) => ({ binding, visibility, buffer: { type, hasDynamicOffset: binding === 0 } })),
    });
    const buffers = [
      this.settings, this.displacement, this.velocity, filled(lattice.restPlaces()), filled(lattice.springRows()),
      filled(lattice.cornerTable()), filled(Float32Array.from(lattice.arrays.guardScale)), make(128 * lattice.cellCount, STORAGE), this.led,
    ];
    this.buffers = [...buffers, this.mapped];
    this.group = device.createBindGroup({
      layout,
      entries: buffers.map((buffer, binding) => ({ binding, resource: binding === 0 ? { buffer, size: 4 * SETTING_COUNT } : { buffer } })),
    });
    const offsets = DIRECTIONS.map((one) => `vec3f(${one.join(", ")})`).join(", ");
    const module = device.createShaderModule({ code: CODE.replace("OFFSETS_HERE", offsets) });
    const pipelineLayout = device.createPipelineLayout({ bindGroupLayouts: [layout] });
    /** @param {string} entryPoint */
    const pipeline = (entryPoint) => device.createComputePipeline({ layout: pipelineLayout, compute: { module, entryPoint } });
    this.kernels = { push: pipeline("push_corners"), accelerate: pipeline("accelerate"), move: pipeline("move_on"), lead: pipeline("lead") };
  }

  /**
   * An engine on the browser's graphics card.
   * @param {Lattice} lattice
   * @throws {NoWebGpu}
   */
  static async create(lattice) {
    const adapter = await navigator.gpu?.requestAdapter();
    if (!adapter) throw new NoWebGpu("missing", "this browser has no WebGPU");
    const needed = Math.max(144 * lattice.nodeCount, 128 * lattice.cellCount);
    if (needed > adapter.limits.maxStorageBufferBindingSize) throw new NoWebGpu("too large", "the case is too large for this graphics card");
    const device = await adapter.requestDevice({ requiredLimits: { maxStorageBufferBindingSize: adapter.limits.maxStorageBufferBindingSize } });
    device.pushErrorScope("validation");
    const engine = new SpringEngine(lattice, device);
    const error = await device.popErrorScope();
    if (error) throw new NoWebGpu("refused", error.message);
    return engine;
  }

  /**
   * Hold some nodes, by a name.
   * @param {string} name
   * @param {number[]} nodes
   */
  hold(name, nodes) {
    this.release(name);
    this.#hands.set(name, { nodes, velocity: [0, 0, 0] });
    this.#write(nodes, 0, [0, 0, 0]);
  }

  /**
   * Move what a hand holds, from the next steps on.
   * @param {string} name
   * @param {Vector} way of the hand [cells] in `count` steps
   * @param {number} count
   */
  lead(name, way, count) {
    const hand = this.#hands.get(name);
    if (hand === undefined) return;
    const velocity = /** @type {[number, number, number]} */ (way.map((part) => part / (count * this.step)));
    if (velocity.every((part, axis) => part === hand.velocity[axis])) return;
    hand.velocity = velocity;
    this.#write(hand.nodes, 0, velocity);
  }

  /** Let go. @param {string} name */
  release(name) {
    const hand = this.#hands.get(name);
    if (hand === undefined) return;
    this.#hands.delete(name);
    this.#write(hand.nodes, null, hand.velocity);
  }

  /** What a hand holds. @param {string} name @returns {readonly number[]} */
  heldBy(name) {
    return this.#hands.get(name)?.nodes ?? [];
  }

  /**
   * Bring a ball, or take it away.
   * @param {{centre: Vector, radius: number} | null} probe [cells]
   */
  bring(probe) {
    this.#probe = probe;
    if (probe) this.#probeGoal = probe.centre;
  }

  /** Where the ball's centre is at the end of the next steps [cells]. @param {Vector} centre */
  moveProbe(centre) {
    this.#probeGoal = centre;
  }

  /** Take steps. @param {number} count */
  take(count) {
    const start = this.#probe?.centre ?? [0, 0, 0];
    const movement = this.#probe ? this.#probeGoal.map((goal, axis) => (goal - start[axis]) / count) : [0, 0, 0];
    for (let taken = 0; taken < count; taken += ROW_MAX) this.#takeRow(taken, Math.min(ROW_MAX, count - taken), start, movement);
    if (this.#probe) this.#probe.centre = this.#probeGoal;
  }

  /** Displacements [cells], 4 a node (the last is nothing). @returns {Promise<Float32Array<ArrayBuffer>>} */
  async displacements() {
    const encoder = this.device.createCommandEncoder();
    encoder.copyBufferToBuffer(this.displacement, 0, this.mapped, 0, this.mapped.size);
    this.device.queue.submit([encoder.finish()]);
    await this.mapped.mapAsync(GPUMapMode.READ);
    const found = new Float32Array(this.mapped.getMappedRange().slice(0));
    this.mapped.unmap();
    return found.subarray(0, 4 * this.lattice.nodeCount);
  }

  /** Everything as at the start. */
  reset() {
    for (const name of [...this.#hands.keys()]) this.release(name);
    this.#probe = null;
    const encoder = this.device.createCommandEncoder();
    encoder.clearBuffer(this.displacement);
    encoder.clearBuffer(this.velocity);
    this.device.queue.submit([encoder.finish()]);
  }

  dispose() {
    for (const buffer of this.buffers) buffer.destroy();
    this.device.destroy();
  }

  /**
   * @param {number} before steps of this call that were taken
   * @param {number} count
   * @param {readonly number[]} start
   * @param {readonly number[]} movement
   */
  #takeRow(before, count, start, movement) {
    const { lattice, device } = this;
    const { facts } = lattice.arrays;
    const bytes = new ArrayBuffer(count * SLOT_BYTES);
    for (let step = 0; step < count; step++) {
      const floats = new Float32Array(bytes, step * SLOT_BYTES, SETTING_COUNT);
      const centre = start.map((part, axis) => part + (before + step + 1) * movement[axis]);
      const radius = this.#probe?.radius ?? 0;
      floats.set([this.step, this.keep, this.kick, WAY_LIMIT / this.step, ...centre, radius, ...movement, 0, facts.shear, facts.cornerFloor]);
      new Uint32Array(bytes, step * SLOT_BYTES, SETTING_COUNT).set([lattice.nodeCount, lattice.cellCount], 14);
    }
    device.queue.writeBuffer(this.settings, 0, bytes);
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    const cells = Math.ceil(lattice.cellCount / GROUP);
    const nodes = Math.ceil(lattice.nodeCount / GROUP);
    for (let step = 0; step < count; step++) {
      pass.setBindGroup(0, this.group, [step * SLOT_BYTES]);
      for (const [kernel, groups] of /** @type {const} */ ([[this.kernels.push, cells], [this.kernels.accelerate, nodes], [this.kernels.move, nodes]])) {
        pass.setPipeline(kernel);
        pass.dispatchWorkgroups(groups);
      }
    }
    pass.end();
    device.queue.submit([encoder.finish()]);
  }

  /**
   * Set the inverse mass and the velocity of some nodes.
   * @param {readonly number[]} nodes
   * @param {number | null} inverseMass their own where null
   * @param {Vector} velocity [cells / unit of time]
   */
  #write(nodes, inverseMass, velocity) {
    if (nodes.length === 0) return;
    const { device, lattice } = this;
    const bytes = new ArrayBuffer(32 * Math.ceil(nodes.length / GROUP) * GROUP);
    const whole = new Uint32Array(bytes);
    const floats = new Float32Array(bytes);
    whole.fill(0xffffffff);
    nodes.forEach((node, at) => {
      whole[8 * at] = node;
      floats[8 * at + 1] = inverseMass ?? lattice.arrays.inverseMass[node];
      floats.set(velocity, 8 * at + 4);
    });
    device.queue.writeBuffer(this.led, 0, bytes, 0, Math.min(bytes.byteLength, this.led.size));
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setBindGroup(0, this.group, [0]);
    pass.setPipeline(this.kernels.lead);
    pass.dispatchWorkgroups(Math.ceil(nodes.length / GROUP));
    pass.end();
    device.queue.submit([encoder.finish()]);
  }
}
