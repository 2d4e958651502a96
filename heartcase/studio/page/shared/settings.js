/**
 * What the browser keeps between visits: theme, language, sizes of tools, keys. Nothing about a patient or a recipe goes here.
 */

const PREFIX = "heartcase studio: ";
const KEPT = /** @type {const} */ (["theme", "language", "radius_mm", "opacity", "outline", "keys", "skip_pauses"]);

/** @typedef {typeof KEPT[number]} Setting */

/**
 * @param {Setting} name
 * @returns {string | null} what was kept; null where nothing was, or where the browser keeps nothing.
 */
export function kept(name) {
  try {
    return localStorage.getItem(PREFIX + name);
  } catch {
    return null;
  }
}

/**
 * @param {Setting} name
 * @param {number} low
 * @param {number} high
 * @param {number} otherwise
 */
export function keptNumber(name, low, high, otherwise) {
  const text = kept(name);
  const value = text === null ? NaN : Number(text);
  return Number.isFinite(value) && value >= low && value <= high ? value : otherwise;
}

/**
 * @param {Setting} name
 * @param {string | number} value
 */
export function keep(name, value) {
  if (!KEPT.includes(name)) throw new Error(`${name} is not kept`);
  try {
    localStorage.setItem(PREFIX + name, String(value));
  } catch {
    // A browser that stores nothing: the choice lasts as long as the page.
  }
}
