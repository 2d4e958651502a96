// Half floats, decoded here by the standard's definition.

import assert from "node:assert/strict";
import test from "node:test";
import { EXACT_TO, halfBits, halfFloats } from "../../../heartcase/studio/page/painting/pictures/half_float.js";

/** @param {number} bits */
function decoded(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const mantissa = bits & 1023;
  return sign * (exponent === 0 ? (mantissa / 1024) * 2 ** -14 : (1 + mantissa / 1024) * 2 ** (exponent - 15));
}

test("whole numbers up to 2048 are exact", () => {
  for (let value = -EXACT_TO; value <= EXACT_TO; value++) assert.equal(decoded(halfBits(value)), value);
});

test("others are the nearest, ties to the even one", () => {
  assert.deepEqual([2049, 2051, 4098, 4102, 65504, 70000, -70000].map((v) => decoded(halfBits(v))), [2048, 2052, 4096, 4104, 65504, 65504, -65504]);
  for (let value = 2048; value < 65000; value += 37) {
    const step = 2 ** Math.floor(Math.log2(value) - 10);
    assert.ok(Math.abs(decoded(halfBits(value)) - value) <= step / 2);
  }
});

test("a scan is stored less its middle", () => {
  // 2071 has no half float of its own
  const halves = halfFloats(Int16Array.of(-1024, 0, 1000, 3071), 1000);
  assert.deepEqual([...halves].map(decoded), [-2024, -1000, 0, 2072]);
});
