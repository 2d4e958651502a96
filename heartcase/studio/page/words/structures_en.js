/** What structures are called in English: as in every recipe. */

/** @type {Record<string, string>} */
export const structures = {};
/** A wall that was grown around a structure, and one between two that nobody saw. */
export const wallOf = (/** @type {string} */ name) => `${name} wall`;
export const septumOf = (/** @type {string} */ one, /** @type {string} */ other) => `${one}-${other} septum (grown)`;
