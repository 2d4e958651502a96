/** Arrays of a binary message, by the table in its header. */

/** @typedef {import("../shared/connection.js").Package} Package */
/** @typedef {Int16Array | Int32Array | Uint8Array | Uint16Array | Uint32Array | Float32Array} Numbers */

const KINDS = {
  int16: Int16Array, int32: Int32Array, uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, float32: Float32Array,
};

/**
 * @param {Package} message
 * @returns {Record<string, any>} name -> array
 */
export function arraysOf({ header, bytes }) {
  /** @type {Record<string, Numbers>} */
  const found = {};
  for (const [name, { dtype, shape, at }] of Object.entries(/** @type {Record<string, any>} */ (header.arrays))) {
    const Kind = KINDS[/** @type {keyof typeof KINDS} */ (dtype)];
    if (Kind === undefined) throw new Error(`an array of unknown kind: ${dtype}`);
    const count = shape.reduce((/** @type {number} */ product, /** @type {number} */ one) => product * one, 1);
    found[name] = new Kind(bytes.buffer, bytes.byteOffset + at, count);
  }
  return found;
}
