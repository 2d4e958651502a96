/** What the file holds of a case: binary messages as the server would send them, compressed, as text in the page. */

import { unpack } from "../shared/connection.js";

/** @typedef {import("../shared/connection.js").Package} Package */
/** A recording: which parts of the file it is, in order. */
/** @typedef {{name: string, parts: number[]}} Recording */
/** A tour, which of the parts show what it does, and how many of their moments are over at the end of each step. */
/** @typedef {import("../touring/tour_panel.js").Tour & {parts: number[], ends: number[]}} ToldTour */
/** `case` are the surface, the springs and the vessels; `landmarks` how these follow the tissue. */
/** @typedef {{facts: Record<string, any>, parts: Package[], case: number[], landmarks: Package, normalMap: Package | null, recordings: Recording[], tours: ToldTour[]}} CaseData */

/** A file that should lie beside the page does not. */
export class NoCase extends Error {}

/**
 * The case's text: in the page itself, or in a script beside it, which is all that a browser loads from a folder.
 * @returns {Promise<string>}
 */
export async function caseText() {
  const own = document.getElementById("case-data");
  if (own !== null) return own.textContent?.trim() ?? "";
  const script = document.createElement("script");
  script.src = document.body.dataset.case ?? "";
  await new Promise((resolve, reject) => {
    script.addEventListener("load", resolve);
    script.addEventListener("error", () => reject(new NoCase()));
    document.head.append(script);
  });
  script.remove();
  const text = /** @type {any} */ (globalThis).heartcaseData;
  if (typeof text !== "string") throw new NoCase();
  delete (/** @type {any} */ (globalThis).heartcaseData);
  return text;
}

/** @param {string} text base64 */
function bytesOf(text) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let n = 0; n < letters.length; n++) bytes[n] = letters.charCodeAt(n);
  return bytes;
}

/**
 * Take the data apart: a table of contents (length in 4 bytes, JSON), and the messages one after the other.
 * @param {string} text base64 of zlib's format
 * @returns {Promise<CaseData>}
 */
export async function readCase(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const data = await new Response(stream).arrayBuffer();
  const size = new DataView(data).getUint32(0, true);
  const { facts, lengths, recordings, tours, case: first, landmarks, normal_map: normalMap } = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
  let at = 4 + size;
  /** @type {Package[]} */
  const parts = [];
  for (const length of lengths) {
    // a copy, so that its arrays begin where their kind must
    parts.push(await unpack(data.slice(at, at + length)));
    at += length;
  }
  return { facts, parts, case: first, landmarks: parts[landmarks], normalMap: normalMap === null ? null : parts[normalMap], recordings, tours };
}
