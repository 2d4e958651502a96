/** Warnings in the page's words and language, from their kind and values; where there are none, as the server says it. */

import { language, positionText, say, structureName } from "../shared/words.js";
import { phrases as phrasesDe } from "../words/warning_phrases_de.js";
import { phrases as phrasesEn } from "../words/warning_phrases_en.js";
import { warnings as de } from "../words/warnings_de.js";
import { warnings as en } from "../words/warnings_en.js";

/** @typedef {Record<string, string>} Parts values of a warning by their names, as its English sentence has them */

/** By language; English ones stand beside those of the server. @type {Record<string, Record<string, string>>} */
const SENTENCES = { de, en };
/** Entries of a recipe's file as pages call them. @type {Record<string, Record<string, string>>} */
const ENTRIES = {
  de: { edits: "Änderung", ends: "Gefäßende", landmarks: "Landmarke", pins: "Fixpunkt", "walls.contact": "Ihre Angabe" },
  en: { edits: "edit", ends: "vessel end", landmarks: "landmark", pins: "pin", "walls.contact": "what you said of place" },
};
/** What values say beside names and numbers, by their names. @type {Record<string, typeof phrasesDe>} */
const PHRASES = { de: phrasesDe, en: phrasesEn };
/** What is to be changed in the panel Shape, and under which heading it stands. */
const MODEL_CHANGES = /make the cells smaller|ask for more triangles|machen sie die zellen kleiner|verlangen sie mehr dreiecke/gi;
/** What stands between names in a list, kept by a split; what is in quotes is somebody's own. */
const BETWEEN_NAMES = /('[^']*'|"[^"]*"|[,;] | und |Venen von |(?: auf | bei | \().*?(?=; |, |$))/;
const PLACE = /\((-?[\d.]+), (-?[\d.]+), (-?[\d.]+)\)/g;

/** @param {{text: string, code: string, parts: Parts}} warning */
export function warningWords({ text, code, parts }) {
  const template = SENTENCES[language.value]?.[code];
  if (template === undefined) return inPage(entriesNamed(text));
  const said = filled(template, parts);
  return inPage(capital(parts.about ? `${entriesNamed(parts.about)}: ${said}` : said));
}

/** Places as the foot of the page writes them, and where in the page something is changed. @param {string} text */
function inPage(text) {
  const placed = text.replace(PLACE, (_, ...mm) => positionText(/** @type {[number, number, number]} */ (mm.slice(0, 3).map(Number)), " "));
  return placed.replace(MODEL_CHANGES, (words, at) => (placed.startsWith(" (", at + words.length) ? words : `${words} (${say("shape")}, ${say("shape_model")})`));
}

/** A text that begins with an entry of a recipe's file, such as `edits[2] "VSD": ...`, with the page's name of it. @param {string} text */
export function entriesNamed(text) {
  const named = text.replace(/^(edits|ends|landmarks|pins|walls\.contact)\[(\d+)\]/i, (whole, entry, number) => {
    const name = ENTRIES[language.value]?.[entry.toLowerCase()];
    return name === undefined ? whole : `${name} ${number}`;
  });
  return named === text ? text : named.charAt(0).toUpperCase() + named.slice(1);
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
  if (isNumber) return language.value === "en" ? value : value.replace(/[.,]/g, (mark) => (mark === "." ? "," : "."));
  const phrases = PHRASES[language.value]?.[name] ?? [];
  const said = phrases.reduce((text, [pattern, word]) => text.replace(pattern, word), value);
  return said.split(BETWEEN_NAMES).map((part) => structureName(part)).join("");
}

/** @param {string} text */
function capital(text) {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}
