/** Warnings in the page's language, from their kind and values; where there are no words for one, as the server says it. */

import { language } from "../shared/words.js";
import { warnings as de } from "../words/warnings_de.js";

/** @typedef {Record<string, string>} Parts values of a warning by their names, as its English sentence has them */

/** Languages beside that of the sentences themselves. @type {Record<string, Record<string, string>>} */
const SENTENCES = { de };

/** @param {{text: string, code: string, parts: Parts}} warning */
export function warningWords({ text, code, parts }) {
  const template = SENTENCES[language.value]?.[code];
  if (template === undefined) return text;
  const said = filled(template, parts);
  return capital(parts.about ? `${localised(parts.about)}: ${said}` : said);
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
  return whole.replaceAll("\u0001", "[[").replaceAll("\u0002", "]]").replaceAll("\u0003", "[").replaceAll("\u0004", "]").replace(/\{(\w+)#?\}/g, (_, name) => localised(values[name] ?? ""));
}

/** A value as this language writes it: decimal comma, and the few words between parts of a list. @param {string} value */
function localised(value) {
  if (/^-?[\d.,]+$/.test(value)) return value.replace(/[.,]/g, (mark) => (mark === "." ? "," : "."));
  return value.replace(/ and (\d+) more/g, " und $1 weitere").replaceAll(" and ", " und ")
    .replace(/ in (\d+) patches, the largest near \(/g, " an $1 Stellen, die größte bei (").replaceAll(" near (", " bei (")
    .replace(/\bover (?=\d)/g, "auf ").replace(/^the first at /, "die ersten bei ").replace(/^at (?=\()/, "bei ")
    .replace(/ mm thick\)/g, " mm dick)").replace(/ in pieces of up to /g, " in Stücken bis ").replace(/\bcells\b/g, "Zellen").replace(/\bcell\b/g, "Zelle")
    .replace(/(\d)\.(\d+)(?= ?(?:mm|ml|%)(?!\w))/g, "$1,$2");
}

/** @param {string} text */
function capital(text) {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}
