/** What the server says, in the page's language where its kind is known; else as it came. */

import { messages as german, places as germanPlaces } from "../words/messages_de.js";
import { language } from "./words.js";

/** @typedef {{message: string, code?: string, values?: Record<string, string>}} Said */

/** By language; English is what the server says. @type {Record<string, {messages: Record<string, string>, places: Record<string, string>}>} */
const KNOWN = { de: { messages: german, places: germanPlaces } };

/** A message with its values put in: numbers with the language's marks. @param {Said} said */
export function saidOf({ message, code, values }) {
  const template = KNOWN[language.value]?.messages[code ?? ""];
  if (template === undefined) return message;
  return template.replace(/\{(\w+)(#?)\}/g, (_, name, isNumber) => {
    const value = String(values?.[name] ?? "");
    return isNumber ? value.replace(/[.,]/g, (mark) => (mark === "." ? "," : ".")) : name === "names" ? value.replace(/[a-z]+ \d+/g, placeOf) : value;
  });
}

/** What a message is about, or an instrument's name: "hand 1". @param {string} place */
export function placeOf(place) {
  const [, kind, number] = /^([a-z]+)( \d+)?$/.exec(place) ?? [];
  const known = KNOWN[language.value]?.places[kind ?? ""];
  return known === undefined ? place : `${known}${number ?? ""}`;
}
