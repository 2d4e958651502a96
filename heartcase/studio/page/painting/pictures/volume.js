/** The scan and its labels: kept as they came, and as textures of the graphics card. */

import { EXACT_TO, halfFloats } from "./half_float.js";

/** @typedef {import("../../shared/geometry.js").Vector} Vector */

/** Voxels along a side of the blocks that empty space is skipped by. */
const BLOCK = 8;

/** What is said to the user where a scan cannot be shown. */
export class TooLarge extends Error {}

export class Volume {
  /** @type {Int16Array<ArrayBuffer> | null} */
  #scan = null;
  /** @type {Uint8Array<ArrayBuffer> | null} */
  #labels = null;
  /** Value of the scan that its texture holds as 0. */
  #middle = 0;
  #scale = 1;
  #offset = 0;
  /** @type {WebGLTexture | null} */
  scanTexture = null;
  /** @type {WebGLTexture | null} */
  labelTexture = null;
  /** @type {WebGLTexture | null} */
  colourTexture = null;
  /** Which blocks of voxels hold a solid. @type {WebGLTexture | null} */
  blockTexture = null;
  /** The same, kept; and which of them have to be looked at anew. @type {Uint8Array<ArrayBuffer> | null} */
  #blocks = null;
  /** @type {Uint8Array<ArrayBuffer>} */
  #isStale = new Uint8Array(0);
  #hasStale = false;
  /** Two rows: of slices, and of solids. */
  #colours = new Uint8Array(2 * 256 * 4);
  /** 1 for the values of structures that are shown as solids. */
  #solid = new Uint8Array(256);

  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Vector} size
   */
  constructor(gl, size) {
    this.gl = gl;
    this.size = size;
    const most = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    if (Math.max(...size) > most) throw new TooLarge(String(most));
  }

  get voxelCount() {
    return this.size[0] * this.size[1] * this.size[2];
  }

  /** Whether scan and labels are there. */
  get isComplete() {
    return this.#scan !== null && this.#labels !== null;
  }

  /**
   * Take the scan; an intensity is scale * value + offset.
   * @param {Int16Array<ArrayBuffer>} values i fastest
   * @param {number} scale
   * @param {number} offset
   */
  setScan(values, scale, offset) {
    if (values.length !== this.voxelCount) throw new Error("the scan has not as many values as voxels");
    this.#scan = values;
    this.#scale = scale;
    this.#offset = offset;
    this.#uploadScan(values);
  }

  /** @param {Int16Array<ArrayBuffer>} values */
  #uploadScan(values) {
    const gl = this.gl;
    let [low, high] = [32767, -32768];
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    const middle = Math.round((low + high) / 2);
    const isExactAsHalf = high - middle <= EXACT_TO && middle - low <= EXACT_TO;
    gl.deleteTexture(this.scanTexture);
    this.scanTexture = this.#texture3d(gl.LINEAR);
    // 32 bits only where 16 would round, and only where the card interpolates them.
    if (!isExactAsHalf && gl.getExtension("OES_texture_float_linear")) {
      this.#middle = 0;
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.R32F, ...this.size, 0, gl.RED, gl.FLOAT, Float32Array.from(values));
    } else {
      this.#middle = middle;
      const halves = halfFloats(values, middle);
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.R16F, ...this.size, 0, gl.RED, gl.HALF_FLOAT, halves);
    }
  }

  /**
   * Take the labels of a box; the first must be the whole volume.
   * @param {Vector} low
   * @param {Vector} size
   * @param {Uint8Array<ArrayBuffer>} bytes i fastest
   */
  setLabels(low, size, bytes) {
    if (bytes.length !== size[0] * size[1] * size[2]) throw new Error("labels have not as many bytes as voxels");
    if (low.some((first, a) => first < 0 || size[a] < 1 || first + size[a] > this.size[a])) {
      throw new Error("labels lie outside the scan");
    }
    const gl = this.gl;
    if (bytes.length === this.voxelCount) {
      this.#labels = bytes;
      this.#uploadLabels(bytes);
      this.#markBlocks([0, 0, 0], this.size);
      return;
    }
    const labels = this.#labels;
    if (labels === null) throw new Error("a part of the labels came before the whole");
    const [ni, nj] = this.size;
    for (let k = 0; k < size[2]; k++) {
      for (let j = 0; j < size[1]; j++) {
        const from = (k * size[1] + j) * size[0];
        const to = ((low[2] + k) * nj + low[1] + j) * ni + low[0];
        labels.set(bytes.subarray(from, from + size[0]), to);
      }
    }
    gl.bindTexture(gl.TEXTURE_3D, this.labelTexture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texSubImage3D(gl.TEXTURE_3D, 0, ...low, ...size, gl.RED_INTEGER, gl.UNSIGNED_BYTE, bytes);
    this.#markBlocks(low, size);
  }

  /** Number of blocks along each axis. @returns {Vector} */
  get #blockCounts() {
    return /** @type {Vector} */ (this.size.map((n) => Math.ceil(n / BLOCK)));
  }

  /** Labels in a box of voxels changed: its blocks must be looked at before solids are drawn. @param {Vector} low @param {Vector} size */
  #markBlocks(low, size) {
    const [ni, nj, nk] = this.#blockCounts;
    if (this.#blocks === null) [this.#blocks, this.#isStale] = [new Uint8Array(ni * nj * nk), new Uint8Array(ni * nj * nk)];
    const first = low.map((n) => Math.floor(n / BLOCK));
    const end = low.map((n, a) => Math.ceil((n + size[a]) / BLOCK));
    for (let k = first[2]; k < end[2]; k++) {
      for (let j = first[1]; j < end[1]; j++) {
        const row = (k * nj + j) * ni;
        this.#isStale.fill(1, row + first[0], row + end[0]);
      }
    }
    this.#hasStale = true;
  }

  /** Look anew which blocks hold a solid, where that may have changed. */
  updateBlocks() {
    if (!this.#hasStale || this.#blocks === null) return;
    const { gl } = this;
    const counts = this.#blockCounts;
    const [ni, nj, nk] = counts;
    let n = 0;
    for (let k = 0; k < nk; k++) {
      for (let j = 0; j < nj; j++) {
        for (let i = 0; i < ni; i++, n++) if (this.#isStale[n]) this.#blocks[n] = this.#holdsSolid([i, j, k]);
      }
    }
    this.#isStale.fill(0);
    this.#hasStale = false;
    this.blockTexture ??= this.#texture3d(gl.NEAREST);
    gl.bindTexture(gl.TEXTURE_3D, this.blockTexture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8UI, ...counts, 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, this.#blocks);
  }

  /** @param {Vector} block @returns {0 | 1} */
  #holdsSolid(block) {
    const [ni, nj, nk] = this.size;
    const [labels, solid] = [/** @type {Uint8Array} */ (this.#labels), this.#solid];
    const [i0, j0, k0] = block.map((n) => n * BLOCK);
    const [i1, j1, k1] = [Math.min(i0 + BLOCK, ni), Math.min(j0 + BLOCK, nj), Math.min(k0 + BLOCK, nk)];
    for (let k = k0; k < k1; k++) {
      for (let j = j0; j < j1; j++) {
        const row = (k * nj + j) * ni;
        for (let n = row + i0; n < row + i1; n++) if (solid[labels[n]]) return 1;
      }
    }
    return 0;
  }

  /** @param {Uint8Array} bytes */
  #uploadLabels(bytes) {
    const gl = this.gl;
    gl.deleteTexture(this.labelTexture);
    this.labelTexture = this.#texture3d(gl.NEAREST);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8UI, ...this.size, 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, bytes);
  }

  /**
   * Colours of the labels; those that are not named here are not drawn, and the background is no solid.
   * @param {Iterable<{value: number, colour: string, role: string}>} shown
   */
  setColours(shown) {
    this.#colours.fill(0);
    this.#solid.fill(0);
    for (const { value, colour, role } of shown) {
      const rgb = parseInt(colour.slice(1), 16);
      const rgba = [(rgb >> 16) & 255, (rgb >> 8) & 255, rgb & 255, 255];
      this.#colours.set(rgba, 4 * value);
      if (role === "background") continue;
      this.#solid[value] = 1;
      this.#colours.set(rgba, 4 * (256 + value));
    }
    this.#uploadColours();
    if (this.#labels) this.#markBlocks([0, 0, 0], this.size);
  }

  /**
   * The first voxel of a solid that a line meets.
   * @param {Vector} from index where the line begins
   * @param {Vector} look index per mm along it
   * @param {number} mm how far it goes
   * @returns {Vector | null} index of the voxel; null where it meets none.
   */
  firstSolid(from, look, mm) {
    const step = 0.25 / Math.max(...look.map(Math.abs));
    for (let way = 0; way < mm; way += step) {
      const voxel = /** @type {Vector} */ (from.map((value, a) => Math.floor(value + way * look[a] + 0.5)));
      if (voxel.some((n, a) => n < 0 || n >= this.size[a])) continue;
      if (this.#solid[this.labelAt(voxel) ?? 0]) return voxel;
    }
    return null;
  }

  #uploadColours() {
    const gl = this.gl;
    if (this.colourTexture === null) this.colourTexture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.colourTexture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 2, 0, gl.RGBA, gl.UNSIGNED_BYTE, this.#colours);
  }

  /** @param {number} filter */
  #texture3d(filter) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_3D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MAG_FILTER, filter);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) {
      gl.texParameteri(gl.TEXTURE_3D, side, gl.CLAMP_TO_EDGE);
    }
    return texture;
  }

  /** Make the textures anew: the card lost them. */
  restore() {
    this.scanTexture = this.labelTexture = this.colourTexture = this.blockTexture = null;
    if (this.#scan) this.#uploadScan(this.#scan);
    if (this.#labels) this.#uploadLabels(this.#labels);
    if (this.#labels) this.#markBlocks([0, 0, 0], this.size);
    this.#uploadColours();
  }

  dispose() {
    for (const texture of [this.scanTexture, this.labelTexture, this.colourTexture, this.blockTexture]) this.gl.deleteTexture(texture);
  }

  /** An intensity as the texture holds it. @param {number} intensity */
  asStored(intensity) {
    return (intensity - this.#offset) / this.#scale - this.#middle;
  }

  /** @param {Vector} voxel */
  intensityAt([i, j, k]) {
    const value = this.#scan?.[(k * this.size[1] + j) * this.size[0] + i];
    return value === undefined ? null : this.#scale * value + this.#offset;
  }

  /** @param {Vector} voxel */
  labelAt([i, j, k]) {
    return this.#labels?.[(k * this.size[1] + j) * this.size[0] + i] ?? null;
  }
}
