/** What the server says, in the page's language where its kind is known; else as it came. */

import { messages as german, places as germanPlaces } from "../words/messages_de.js";
import { language } from "./words.js";

/** @typedef {{message: string, code?: string, values?: Record<string, string | Said>}} Said */

/** By language; English is what the server says. @type {Record<string, {messages: Record<string, string>, places: Record<string, string>}>} */
const KNOWN = { de: { messages: german, places: germanPlaces } };

/** @param {"messages" | "places"} table @param {string} key @returns {string | undefined} */
function known(table, key) {
  const words = KNOWN[language.value]?.[table] ?? {};
  return Object.hasOwn(words, key) ? words[key] : undefined;
}

/** A message with its values put in: numbers with the language's marks. @param {Said} said @returns {string} */
export function saidOf({ message, code, values }) {
  const template = known("messages", code ?? "");
  if (template === undefined) return message;
  return template.replace(/\{(\w+)(#?)\}/g, (_, name, isNumber) => {
    const value = values?.[name] ?? "";
    if (typeof value !== "string") return saidOf(value);
    return isNumber ? value.replace(/[.,]/g, (mark) => (mark === "." ? "," : ".")) : name === "names" ? value.split(", ").map(nameOf).join(", ") : value;
  });
}

/** What a message is about. @param {string} place */
export function placeOf(place) {
  const [, kind, number] = /^([a-z]+)((?: \d+)*)$/.exec(place) ?? [];
  const word = known("places", kind ?? "");
  return word === undefined ? place : `${word}${number ?? ""}`;
}

/** What an instrument, stitch, row or patch is called: "hand 1", or "row 1 3" for the third stitch of a row. A name without a number is one that a user gave. @param {string} name */
export function nameOf(name) {
  return / \d+$/.test(name) ? placeOf(name) : name;
}
