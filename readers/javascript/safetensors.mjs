// JSON of bounded size, and the arrays of a safetensors file.

export class HeartcaseError extends Error {}

export function fail(message) {
  throw new HeartcaseError(message);
}

const MAX_HEADER_BYTES = 2 ** 20;
const MAX_DEPTH = 64;
const MAX_VALUES = 1_000_000;
const ITEM_BYTES = new Map([
  ["BOOL", 1],
  ["U8", 1],
  ["I8", 1],
  ["U16", 2],
  ["I16", 2],
  ["F16", 2],
  ["BF16", 2],
  ["U32", 4],
  ["I32", 4],
  ["F32", 4],
  ["U64", 8],
  ["I64", 8],
  ["F64", 8],
]);

export const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
export const isCount = (value) => Number.isSafeInteger(value) && value >= 0;

// UTF-8 bytes to a JSON value of bounded depth and number of values; every number is finite, no key stands twice.
export function parseJson(bytes, what) {
  let text, json;
  try {
    text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
    json = JSON.parse(text);
  } catch {
    fail(`${what} is not valid JSON in UTF-8`);
  }
  checkTokens(text, what);
  const open = [json];
  while (open.length > 0) {
    const value = open.pop();
    if (typeof value === "number" && !Number.isFinite(value)) fail(`${what} holds a number out of range`);
    if (typeof value === "object" && value !== null) for (const item of Object.values(value)) open.push(item);
  }
  return json;
}

// What JSON.parse lets pass: text already known to be JSON is walked once, character by character.
function checkTokens(text, what) {
  const keys = []; // one entry per open bracket: a Set of the keys so far, null for a list
  let values = 1;
  for (let at = 0; at < text.length; at += 1) {
    const character = text[at];
    if (character === "{" || character === "[") keys.push(character === "{" ? new Set() : null);
    if (character === "}" || character === "]") keys.pop();
    if (character === "{" || character === "[" || character === ",") values += 1;
    if (keys.length > MAX_DEPTH) fail(`${what} is nested too deep`);
    if (values > MAX_VALUES) fail(`${what} holds too many values`);
    if (character !== '"') continue;
    const start = at;
    for (at += 1; text[at] !== '"'; at += 1) if (text[at] === "\\") at += 1;
    const string = JSON.parse(text.slice(start, at + 1));
    if (/\p{Cs}/u.test(string)) fail(`${what} holds half a character`);
    let next = at + 1;
    while (/\s/.test(text[next] ?? "")) next += 1;
    if (text[next] !== ":") continue;
    if (keys.at(-1).has(string)) fail(`${what} holds the same key twice in one object`);
    keys.at(-1).add(string);
  }
}

// Arrays of a safetensors file: the header's length (8 bytes, little-endian), the header (JSON), the data
// (little-endian, C order), arrays one behind the other without gap or overlap. Returns name -> {dtype, shape, begin,
// values}; `begin` in bytes from the start of the file, `values` an Int32Array, Int16Array, Float32Array or Uint8Array
// of its own, null for other types.
export function readSafetensors(buffer, what) {
  if (buffer.byteLength < 8) fail(`${what} is too short for a safetensors file`);
  const headerBytes = new DataView(buffer).getBigUint64(0, true);
  if (headerBytes > BigInt(Math.min(MAX_HEADER_BYTES, buffer.byteLength - 8)))
    fail(`${what} has a header longer than allowed or than the file`);
  const dataStart = 8 + Number(headerBytes);
  const header = parseJson(new Uint8Array(buffer, 8, Number(headerBytes)), `the header of ${what}`);
  if (!isObject(header)) fail(`${what} has a header that is not an object`);
  const arrays = new Map();
  for (const [n, [name, entry]] of Object.entries(header).entries()) {
    if (name === "__metadata__") continue;
    arrays.set(name, readArrayEntry(entry, buffer, dataStart, `${what}: array ${n + 1} of the header`));
  }
  let end = dataStart;
  for (const array of [...arrays.values()].sort((a, b) => a.begin - b.begin || a.end - b.end)) {
    if (array.begin !== end) fail(`${what} has arrays that overlap or leave a gap`);
    end = array.end;
  }
  if (end !== buffer.byteLength) fail(`${what} has data that no array holds`);
  return arrays;
}

function readArrayEntry(entry, buffer, dataStart, where) {
  const { dtype, shape, data_offsets: offsets } = isObject(entry) ? entry : {};
  const itemBytes = ITEM_BYTES.get(dtype);
  if (itemBytes === undefined) fail(`${where} has a type that is not known`);
  if (!Array.isArray(shape) || shape.length > 8 || !shape.every(isCount)) fail(`${where} has a shape that is not one`);
  if (!Array.isArray(offsets) || offsets.length !== 2 || !offsets.every(isCount))
    fail(`${where} has data_offsets that are not two counts`);
  const [begin, end] = [dataStart + offsets[0], dataStart + offsets[1]];
  if (begin > end || end > buffer.byteLength) fail(`${where} lies outside its file`);
  const count = shape.reduce((product, axis) => product * axis, 1);
  if (count * itemBytes !== end - begin) fail(`${where} has data_offsets that do not fit its shape`);
  return { dtype, shape, begin, end, values: readValues(dtype, buffer, begin, count) };
}

// DataView states the byte order; a copy of the bytes is taken only where the host's own order is the file's.
function readValues(dtype, buffer, begin, count) {
  const hostIsLittle = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;
  if (dtype === "U8") return new Uint8Array(buffer.slice(begin, begin + count));
  const [type, bytes, get] =
    { I32: [Int32Array, 4, "getInt32"], I16: [Int16Array, 2, "getInt16"], F32: [Float32Array, 4, "getFloat32"] }[
      dtype
    ] ?? [];
  if (type === undefined) return null;
  if (hostIsLittle) return new type(buffer.slice(begin, begin + bytes * count));
  const view = new DataView(buffer, begin, bytes * count);
  return type.from({ length: count }, (_, n) => view[get](bytes * n, true));
}
