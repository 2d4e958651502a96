/** Warnings in the page's language, from their kind and values; where there are no words for one, as the server says it. */

import { language } from "../shared/words.js";
import { phrases as phrasesDe } from "../words/warning_phrases_de.js";
import { warnings as de } from "../words/warnings_de.js";

/** @typedef {Record<string, string>} Parts values of a warning by their names, as its English sentence has them */

/** Languages beside that of the sentences themselves. @type {Record<string, Record<string, string>>} */
const SENTENCES = { de };
/** What values say beside names and numbers, by their names. @type {Record<string, typeof phrasesDe>} */
const PHRASES = { de: phrasesDe };

/** @param {{text: string, code: string, parts: Parts}} warning */
export function warningWords({ text, code, parts }) {
  const template = SENTENCES[language.value]?.[code];
  if (template === undefined) return text;
  const said = filled(template, parts);
  return capital(parts.about ? `${parts.about}: ${said}` : said);
}

/** Whether a warning is said in the page's language. @param {{code: string}} warning */
export function isWorded({ code }) {
  return language.value === "en" || SENTENCES[language.value]?.[code] !== undefined;
}

/**
 * A template with its values: `{name}`, `[what is said where its values are there]`, `<one|several>` by the value `count`.
 * @param {string} template
 * @param {Parts} values
 */
export function filled(template, values) {
  const whole = template.replaceAll("\\[", "\u0003").replaceAll("\\]", "\u0004").replaceAll("[[", "\u0001").replaceAll("]]", "\u0002")
    .replace(/\[([^[\]]*)\]/g, (_, part) => ([.../\{(\w+)#?\}/g[Symbol.matchAll](part)].every(([, name]) => name in values) ? part : ""))
    .replace(/<([^<>|]*)\|([^<>|]*)>/g, (_, one, several) => (values.count === "1" ? one : several));
  return whole.replaceAll("\u0001", "[[").replaceAll("\u0002", "]]").replaceAll("\u0003", "[").replaceAll("\u0004", "]").replace(/\{(\w+)(#?)\}/g, (_, name, isNumber) => localised(name, values[name] ?? "", isNumber !== ""));
}

/** A value as this language writes it: numbers with its marks, its phrases where there are some, and names as they are. @param {string} name @param {string} value @param {boolean} isNumber */
function localised(name, value, isNumber) {
  if (isNumber) return value.replace(/[.,]/g, (mark) => (mark === "." ? "," : "."));
  const phrases = PHRASES[language.value]?.[name] ?? [];
  return phrases.reduce((text, [pattern, said]) => text.replace(pattern, said), value);
}

/** @param {string} text */
function capital(text) {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}
