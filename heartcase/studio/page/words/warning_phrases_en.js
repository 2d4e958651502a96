/** Phrases within values of warnings that name entries of a recipe's file, in this page's words. */

/** @type {typeof import("./warning_phrases_de.js").phrases} */
export const phrases = {
  by: [
    [/^walls\.contact\[\d+\]$/, () => "you, of this place"],
    [/^edits\[(\d+)\]/, (_, number) => `edit ${number}`],
  ],
};
