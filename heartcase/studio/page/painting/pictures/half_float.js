/** 16 bit floats (IEEE 754 binary16), which a texture can hold and interpolate everywhere. */

/**
 * The nearest half float's bits of a whole number; those beyond 65504 become the largest one.
 * @param {number} value
 */
export function halfBits(value) {
  const sign = value < 0 ? 0x8000 : 0;
  let size = Math.abs(value);
  if (size === 0) return sign;
  if (size >= 65520) return sign | 0x7bff;
  let exponent = Math.floor(Math.log2(size));
  // ties to even, as the standard has it
  let mantissa = roundedToEven((size / 2 ** exponent - 1) * 1024);
  if (mantissa === 1024) {
    mantissa = 0;
    exponent += 1;
  }
  return sign | ((exponent + 15) << 10) | mantissa;
}

/** @param {number} value */
function roundedToEven(value) {
  const floor = Math.floor(value);
  const rest = value - floor;
  if (rest !== 0.5) return Math.round(value);
  return floor % 2 === 0 ? floor : floor + 1;
}

/** Whole numbers up to here are exact as half floats. */
export const EXACT_TO = 2048;

/**
 * Values as half floats, less `middle`.
 * @param {Int16Array} values
 * @param {number} middle a whole number
 * @returns {Uint16Array}
 */
export function halfFloats(values, middle) {
  const table = new Uint16Array(65536);
  for (let value = -32768; value < 32768; value++) table[value & 0xffff] = halfBits(value - middle);
  const halves = new Uint16Array(values.length);
  for (let n = 0; n < values.length; n++) halves[n] = table[values[n] & 0xffff];
  return halves;
}
